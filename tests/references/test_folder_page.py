"""The page of a folder: the worst first, sorted by a click, its links lead to files."""

from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from crar_drake.references.certificate_files import certificate_path
from crar_drake.references.folder_page import Figure, PageRow, write_folder_page
from docs.headless_browser import HeadlessBrowser, find_browser


@dataclass
class Clip:
    clip: str
    angle: float
    left: int

    @property
    def violated(self) -> bool:
        return self.left > 0


FIGURES = (
    Figure("angle [deg]", lambda c: c.angle, 1),
    Figure("left", lambda c: c.left, bad=True),
)
AWKWARD = "a <b>&c #1%.csv"


class Table(HTMLParser):
    """The cells of each row, and where its links lead."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.inside = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.inside = True
        if tag == "a":
            self.links.append(given["href"])
        if tag in ("img", "link", "script") and attributes:
            self.loaded.append(tag)

    def handle_data(self, data):
        if self.inside:
            self.rows[-1][-1] += data

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.inside = False


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    source, out = folder / "in", folder / "out"
    rows = []
    for name, clip, note in (
        ("calm.csv", Clip("", 1.0, 0), ""),
        ("deep/more.csv", Clip("one", 12.0, 0), "x"),
        ("bad.csv", None, "bad.csv: line 3: 'a' is <no> number"),
        (AWKWARD, Clip("", 3.0, 2), ""),
        ("none.csv", Clip("", float("nan"), 0), ""),
    ):
        places = [place / name for place in (source, out)]
        for place in places:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text("")
            certificate_path(place).write_text("")
        rows.append(PageRow(*places, clip, note))
    path = out / "cleaned.html"
    write_folder_page(path, "A <title>", "About it.", FIGURES, rows)
    return path


def test_the_worst_comes_first(page):
    head, *rows = Table(page).rows
    assert head == ["state", "motion", "angle [deg]", "left", "note"]
    cells = [(row[0], row[1].split(" · ")[0], row[2], row[3]) for row in rows]
    assert cells == [
        ("failed", "bad.csv", "", ""),
        ("violated", AWKWARD, "3.0", "2"),
        ("ok", "deep/more.csv one", "12.0", "0"),
        ("ok", "calm.csv", "1.0", "0"),
        ("ok", "none.csv", "", "0"),
    ]
    assert rows[0][-1] == "bad.csv: line 3: 'a' is <no> number"
    assert "1 failed, 1 violated, 3 ok. About it." in page.read_text()


def test_its_links_lead_to_files_and_nothing_is_loaded(page):
    table = Table(page)
    assert len(table.links) == 4 * 3 + 1 and not table.loaded
    for link in table.links:
        assert (page.parent / unquote(link)).is_file(), link
    assert "http" not in page.read_text()


@pytest.mark.skipif(find_browser() is None, reason="needs Chromium")
def test_a_click_sorts(page):
    with HeadlessBrowser(900, 600) as browser:
        browser.send("Page.navigate", url=page.as_uri())
        browser.wait_for("document.querySelector('tbody') !== null")
        browser.wait_for("document.readyState === 'complete'")

        def column(k, click):
            browser.evaluate(f"document.querySelectorAll('th')[{click}].click()")
            return browser.evaluate(
                "[...document.querySelectorAll('tbody tr')].map("
                f"row => row.cells[{k}].textContent).join(' ')"
            )

        assert column(2, 2) == "12.0 3.0 1.0  "  # what is no number is last
        assert column(2, 2) == "1.0 3.0 12.0  "
        assert column(3, 3) == "2 0 0 0 "
        assert column(0, 0) == "violated ok ok ok failed"
        assert column(0, 0) == "failed ok ok ok violated"
        assert not browser.complaints and not browser.requests
