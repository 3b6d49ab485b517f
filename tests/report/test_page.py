"""The page is one well-formed file without external resources, and escapes text."""

import re
from html.parser import HTMLParser

import numpy as np

from motorprior.report.page import Picture, Section, Table, page, picture
from motorprior.report.plots import learning_curves

VOID = {"meta", "img", "br"}


class Reader(HTMLParser):
    """Collects addresses, ids and words of a page, and checks that tags are balanced."""

    def __init__(self, html: str):
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.words = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data


def page_of_two_sections(complete: bool = True) -> str:
    drawing = picture(learning_curves({"rollout": [(np.arange(3), np.arange(3.0))]}), "A policy.")
    table = Table(
        ("trained on", "speed [m/s]"), (("rollout", "0.45"), ("tuned_pd", "–")), "Speeds."
    )
    sections = (
        Section("What & why", ("Because <b> is text.", "Two <script>."), (drawing,), (table,)),
        Section("A film", (), (Picture("Walks.", b"GIF89a", "gif"),)),
    )
    settings = {"seed": 0, "speed": 0.75, "taps": [0, 1]}

    return page("A <title>", sections, settings, 'motorprior transfer --out "x"', complete)


def test_tags_are_balanced_and_nothing_is_loaded():
    html = page_of_two_sections(complete=False)
    reader = Reader(html)

    assert reader.open == []
    assert len(set(reader.ids)) == len(reader.ids)
    assert all(address.startswith(("#", "data:image/")) for address in reader.addresses)

    links = {address[1:] for address in reader.addresses if address[0] == "#"}

    assert links <= set(reader.ids)
    assert not re.search(r"https?://|@import|<script|<link|<iframe", html)


def test_text_is_escaped():
    html = page_of_two_sections()

    assert "<title>A &lt;title&gt;</title>" in html

    words = Reader(html).words

    assert "Two <script>." in words
    assert 'motorprior transfer --out "x"' in words


def test_tables_and_settings_show_names_and_numbers():
    words = Reader(page_of_two_sections()).words

    assert all(text in words for text in ("tuned PD", "0.45", "–", "speed", "0.75", "0, 1"))
    assert "not complete" not in words
    assert "not complete" in Reader(page_of_two_sections(complete=False)).words


def test_a_page_that_was_made_from_python_names_no_command():
    assert "makes the page again" not in page("title", [], {}, "")
    assert "makes the page again" in page("title", [], {}, "motorprior report runs/walk")
