"""A motor card: a folder with the prior, a README with YAML front matter, and a picture of its behaviour."""

from __future__ import annotations

from pathlib import Path

from motorprior.exports.cards import write_card
from motorprior.exports.exporter import Exporter, Request


def write(request: Request) -> list[Path]:
    """prior.safetensors and README.md."""
    return write_card(request.sample.prior, request.out)


EXPORTER = Exporter("card", "motor card", (), write, drops_terms=False)
