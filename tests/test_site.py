"""The documentation site builds without a warning, and its links lead somewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urljoin, urlsplit

import pytest

import crar_drake

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
for needed in ("sphinx", "myst_nb", "furo"):
    pytest.importorskip(needed, reason="needs the extra: pip install .[docs]")

sys.path[:0] = [str(DOCS), str(DOCS / "site")]
from docstrings import as_markdown, field_comments  # noqa: E402
from headless_browser import HeadlessBrowser, find_browser  # noqa: E402
from room_reference import rooms  # noqa: E402

PACKAGE = ROOT / "crar_drake"
FRONT = "docs/site/index.html"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, with the notebooks as they are: another test executes these. Without
    the objects in lists of contents, which Sphinx copies a hundred times, and links to
    by itself."""
    out = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [
            *(sys.executable, "-m", "sphinx", "-q", "-W", "-n", "--keep-going"),
            *("-D", "nb_execution_mode=off", "-D", "toc_object_entries=0"),
            *("-c", DOCS / "site"),
            *("-d", out / "doctrees", ROOT, out / "html"),
        ],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert built.returncode == 0, built.stderr
    return out / "html"


class Page(HTMLParser):
    """What a page links to, what it loads, and what can be linked to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.ids: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list) -> None:
        given = dict(attributes)
        self.ids |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.add(given["href"])
        elif tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload"):
            self.loaded.add(given["href"])
        elif given.get("src"):
            self.loaded.add(given["src"])
        elif tag == "meta" and given.get("http-equiv") == "refresh":
            self.links.add(given["content"].partition("url=")[2])


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Page]:
    return {
        path.relative_to(site).as_posix(): Page(path) for path in site.rglob("*.html")
    }


@pytest.mark.slow
def test_every_link_leads_to_a_page_and_a_place_in_it(site, pages):
    seen = 0
    for name, page in pages.items():
        for link in page.links | page.loaded:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or not link.strip("#"):
                continue
            target = urlsplit(urljoin(f"/{name}", link)).path.lstrip("/")
            assert (site / unquote(target)).is_file(), f"{name}: {link}"
            if parts.fragment and target.endswith(".html"):
                anchor = unquote(parts.fragment)
                assert anchor in pages[unquote(target)].ids, f"{name}: {link}"
                seen += 1
    assert seen > 1000 and len(pages) > 50


@pytest.mark.slow
def test_nothing_is_loaded_from_a_network(site, pages):
    for name, page in pages.items():
        for address in page.loaded:
            assert not re.match(r"(\w+:)?//", address), f"{name}: {address}"
    for style in site.rglob("*.css"):
        assert "url(http" not in style.read_text("utf-8"), style


@pytest.mark.slow
def test_every_page_of_the_repository_is_in_the_site(pages):
    documents = [
        ROOT / "README.md",
        *DOCS.glob("*.md"),
        *ROOT.glob("models/**/README.md"),
        *ROOT.glob("diagrams/*.md"),
        *ROOT.glob("examples/*.ipynb"),
    ]
    reachable = {
        urljoin(f"/{FRONT}", link).partition("#")[0] for link in pages[FRONT].links
    }
    for document in documents:
        page = document.relative_to(ROOT).with_suffix(".html").as_posix()
        assert f"/{page}" in reachable


@pytest.mark.slow
def test_the_reference_has_all_public_names_and_all_rooms(pages):
    reference = pages["docs/site/reference.html"].ids
    assert {f"crar_drake.{name}" for name in crar_drake.__all__} <= reference
    assert "crar_drake.ControlLaw.step" in reference
    assert len(rooms()) > 10
    for room in rooms():
        ids = pages[f"docs/site/rooms/{room}.html"].ids
        for path in (PACKAGE / room).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts).removesuffix(".__init__")
            assert f"module-{name}" in ids, name
        # Each public name stands in one place only.
        assert not {f"crar_drake.{key}" for key in crar_drake.__all__} & ids
    ids = pages["docs/site/rooms/control.html"].ids
    assert "crar_drake.control.records.Memory" in ids
    assert "crar_drake.control.law.ControlLaw" not in ids


@pytest.mark.slow
def test_a_linked_source_file_is_shown(site, pages):
    shown = "source/crar_drake/results/log.py.html"
    assert f"../../{shown}" in pages["docs/guides/start.html"].links
    text = re.sub(r"<[^>]+>", "", (site / shown).read_text("utf-8"))
    assert "class SimulationLog" in text
    listed = pages["source/examples.html"].links
    assert "examples/build_and_simulate.py.html" in listed
    assert "../examples/first_dance.html" in listed


@pytest.mark.slow
def test_a_docstring_is_rendered(site):
    page = (site / "docs/site/reference.html").read_text("utf-8")
    start = page.index('id="crar_drake.CrarController"')
    text = re.sub(r"<[^>]+>", "", page[start : start + 30000])
    assert "Input ports" in text and "estimated_state – (nq + nv,)" in text
    assert "alpha_c = alpha + Gv (q_dot_c - q_dot)     " in text  # as it stands
    assert 'href="#crar_drake.TaskLayout"' in page
    # The comments behind the fields of a class without a list of them.
    page = (site / "docs/site/rooms/equations.html").read_text("utf-8")
    assert re.search("farthest that a.s axis can be from the joint", page)


@pytest.mark.slow
@pytest.mark.skipif(find_browser() is None, reason="needs Chromium")
def test_the_site_works_in_a_browser_from_disk(site):
    with HeadlessBrowser(1200, 900) as browser:

        def open_page(name: str) -> None:
            browser.send("Page.navigate", url="about:blank")
            browser.send("Page.navigate", url=site.as_uri() + f"/{name}")
            browser.wait_for("location.protocol === 'file:'")
            browser.wait_for("document.readyState === 'complete'")

        open_page("index.html")
        browser.wait_for("location.pathname.endsWith('docs/site/index.html')")
        open_page("search.html?q=admission")
        browser.wait_for("document.querySelectorAll('#search-results li').length > 2")
        browser.resize(390, 844)
        for name in (
            FRONT,
            "README.html",
            "docs/guides/concepts.html",
            "docs/measurements/README.html",
        ):
            open_page(name)
            browser.settle()
            wide = browser.evaluate("document.documentElement.scrollWidth")
            assert wide <= 390, f"{name} is wider than a phone"
        assert browser.complaints == [] and browser.requests == []


# --- docstrings -------------------------------------------------------------------


def test_headed_lists_become_field_lists():
    text = as_markdown(
        "What it does:\n\n    x = 1\n\nArgs:\n    q, v: (nq,) a state;\n"
        "        goes on: here.\n    h: period [s].\n\nReturns:\n    One: or two.\n"
    )
    assert text.startswith("What it does:\n\n    x = 1\n\n")  # a formula, no list
    assert (
        ":Arguments:\n    - **q, v** – (nq,) a state;\n      goes on: here.\n"
        "    - **h** – period [s].\n" in text
    )
    assert ":Returns:\n    One: or two.\n" in text


def test_pages_that_docstrings_name_are_links():
    page = "docs/terms.md"
    assert as_markdown(f"see `{page}`") == f"see [`{page}`](/{page})"
    assert as_markdown(f"[it]({page})") == f"[it](/{page})"


def test_comments_behind_fields_are_told():
    source = '''class A:
    """A."""

    q: int  # (n,) [m]
    w: int
    # the last
    # of them
    v: int = 0

    # of none

    u: int = 0
'''
    said = "Attributes:\n    q: (n,) [m]\n    v: the last\n        of them"
    assert field_comments(source) == said
    assert field_comments("class A:\n    q: int\n") == ""
