"""The site builds without a broken link, reference or picture, and needs no other host."""

import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path

import pytest

import assemble
import motorprior as mp
from assemble import with_math
from reference import SECTIONS, api_pages

ROOT = Path(__file__).resolve().parents[1]


CONFIG = (ROOT / "zensical.toml").read_text("utf-8")


def build(project: Path, config: str = CONFIG) -> subprocess.CompletedProcess:
    """Build the site of a folder with pages in build/pages, as `make docs` does."""
    config = config.replace('paths = ["src"]', f'paths = ["{(ROOT / "src").as_posix()}"]')
    (project / "zensical.toml").write_text(config, "utf-8")
    words = [Path(sys.executable).parent / "zensical", "build", "--strict"]
    return subprocess.run(words, cwd=project, capture_output=True, text=True)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    assemble.assemble(folder / "build" / "pages", outputs=False)
    done = build(folder)
    report = done.stdout + done.stderr

    assert done.returncode == 0, report
    # a docstring whose sections cannot be read
    assert re.findall(r".*Failed to get '.*", report) == []

    return folder


class Tags(HTMLParser):
    """The tags of a page, with their attributes."""

    def __init__(self, page: Path):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def html_pages(project: Path) -> list[Path]:
    return sorted((project / "build" / "site").rglob("*.html"))


def test_all_pages_are_in_the_navigation(project: Path):
    navigation = str(tomllib.loads(CONFIG)["project"]["nav"])
    pages = project / "build" / "pages"
    for page in pages.rglob("*.md"):
        name = page.relative_to(pages).as_posix()
        # sources of examples are reached from the pages that name them
        assert name.startswith("files/") or f"'{name}'" in navigation


def test_pictures_exist_and_have_a_text_for_those_who_do_not_see_them(project: Path):
    num_pictures = 0
    for page in html_pages(project):
        for tag, attributes in Tags(page).tags:
            if tag == "img":
                num_pictures += 1
                source = str(attributes["src"])

                assert attributes.get("alt"), (page, source)
                assert (page.parent / source).is_file(), (page, source)

    assert num_pictures >= 6


def test_a_numbered_list_continues_after_a_command(project: Path):
    text = (ROOT / "docs" / "hardware.md").read_text("utf-8")
    page = (project / "build" / "site" / "hardware.html").read_text("utf-8")

    assert page.count("<ol") == len(re.findall(r"^1\. ", text, re.MULTILINE)) > 0


def test_a_page_loads_nothing_from_another_host(project: Path):
    for page in html_pages(project):
        for tag, attributes in Tags(page).tags:
            loaded = attributes.get("src")
            if tag == "link" and attributes.get("rel") in {"stylesheet", "icon", "preconnect"}:
                loaded = attributes["href"]

            assert not re.match(r"(https?:)?//", loaded or ""), (page, tag, loaded)

    for style in (project / "build" / "site").rglob("*.css"):
        assert not re.search(r"url\(\s*[\"']?https?:|@import", style.read_text("utf-8")), style


def test_every_public_name_is_in_the_reference(project: Path):
    pages = "".join(page.read_text("utf-8") for page in html_pages(project) if "api" in page.parts)
    for name in set(mp.__all__) - {"__version__"}:
        assert re.search(rf"\bmp\.{name}\s", pages), name

    assert len(api_pages()) == len(set(SECTIONS.values()))


def test_formulas_are_drawn_without_a_script(project: Path):
    page = (project / "build" / "site" / "motor.html").read_text("utf-8")

    assert page.count("<math") > 20
    assert "$`" not in page
    assert "math/tex" not in page
    assert "<math" in with_math("$`a^2`$")


def test_a_paragraph_may_start_with_a_formula(tmp_path: Path):
    pages = tmp_path / "build" / "pages"
    pages.mkdir(parents=True)
    text = with_math("# Title\n\n$`K_t`$ is a torque constant,\n$`R`$ a resistance.\n")
    (pages / "index.md").write_text(text, "utf-8")
    config = re.sub(r"^nav = \[.*?^\]$", "", CONFIG, flags=re.MULTILINE | re.DOTALL)

    assert build(tmp_path, config).returncode == 0

    page = (tmp_path / "build" / "site" / "index.html").read_text("utf-8")
    paragraph = re.search(r"<p>(?:(?!</p>).)*is a torque constant.*?</p>", page, re.DOTALL)

    assert paragraph is not None
    assert paragraph[0].count("<math") == 2


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[words](missing.md)", "page does not exist"),
        ("[words](index.md#missing)", "anchor does not exist"),
        ("[words][motorprior.missing]", "unresolved"),
        ("::: motorprior.missing", "motorprior.missing"),
    ],
)
def test_a_broken_link_or_reference_fails_the_build(text: str, problem: str, tmp_path: Path):
    pages = tmp_path / "build" / "pages"
    pages.mkdir(parents=True)
    (pages / "index.md").write_text(f"# Title\n\n{text}\n", "utf-8")
    # all settings but the navigation, whose pages are not here
    config = re.sub(r"^nav = \[.*?^\]$", "", CONFIG, flags=re.MULTILINE | re.DOTALL)
    done = build(tmp_path, config)

    assert done.returncode != 0
    assert problem in re.sub(r"\x1b\[[0-9;]*m", "", done.stdout + done.stderr)
