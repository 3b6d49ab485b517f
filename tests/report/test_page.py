"""The page stands alone, is well-formed, says what it was told and nothing more."""

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from motorprior.report.page import (
    Picture,
    Report,
    Section,
    Table,
    picture,
    render,
    write_report,
)
from motorprior.report.plots_motor import closed_loop

VOID = {"meta", "img", "br", "hr", "link", "input", "rect", "path"}


class Reader(HTMLParser):
    """Collects what the tests ask about, and checks that every tag is closed by its own."""

    def __init__(self, page: str):
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.words = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "srcset")]
        self.ids += [found["id"] or ""] if "id" in found else []
        self.images += [found] if tag == "img" else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag, f"</{tag}> closes another tag"

    def handle_data(self, data):
        self.words += data


def drawing() -> Picture:
    time = np.linspace(0, 1, 400)
    return picture(closed_loop(time, time, time, {"rollout": time + 0.01}, "motor"), "A motor.", "two panels")


def report(**changes) -> Report:
    table = Table(("trained on", "speed [m/s]"), (("rollout", 0.45), ("tuned_pd", None)), "Speeds.")
    sections = (
        Section("What & why", "Because <b> is text.", ("One.", "Two <script>."), (drawing(),), (table,)),
        Section("What why", "Same anchor.", (), (Picture("Walks.", "a robot", b"GIF89a", "gif"),)),
    )
    settings = {"seed": 0, "search": {"step_size": 0.05}, "taps": [0, 1]}
    values = {"title": "A <title>", "subtitle": "Sub", "sections": sections, "settings": settings}
    return Report(**{**values, "command": 'motorprior transfer --out "x"', **changes})


def test_every_tag_is_closed_and_ids_are_unique():
    reader = Reader(render(report(pending=("robot",), highlights=(("1 m/s", "speed"),))))
    assert reader.open == []
    assert len(set(reader.ids)) == len(reader.ids)


def test_nothing_is_loaded_from_elsewhere():
    page = render(report())
    reader = Reader(page)
    assert all(address.startswith(("#", "data:image/")) for address in reader.addresses)
    assert not re.search(r"https?://|@import|<script|<link|<iframe", page)
    assert all(found.startswith("#") for found in re.findall(r"url\(([^)]*)\)", page))
    assert {address[1:] for address in reader.addresses if address[0] == "#"} <= set(reader.ids)


def test_text_is_escaped():
    page = render(report(pending=("<robot>",)))
    assert "<title>A &lt;title&gt;</title>" in page
    assert "<script" not in page
    words = Reader(page).words
    assert "Two <script>." in words and "<robot>" in words and 'motorprior transfer --out "x"' in words


def test_the_same_report_gives_the_same_bytes():
    assert render(report()) == render(report())
    assert drawing().data == drawing().data


def test_a_partial_report_says_what_is_missing():
    assert "Still to come: transfer, robot." in Reader(render(report(pending=("transfer", "robot")))).words
    assert "Still to come" not in render(report())


def test_the_page_is_written(tmp_path: Path):
    write_report(tmp_path / "new" / "report.html", report())
    assert (tmp_path / "new" / "report.html").read_text("utf-8") == render(report())
