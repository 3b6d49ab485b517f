"""A motor card: a folder with the prior, and a README with YAML front matter."""

from motorprior.exports.cards import write_card
from motorprior.exports.exporter import Exporter

EXPORTER = Exporter("card", (), lambda request: write_card(request.sample.prior, request.out))
