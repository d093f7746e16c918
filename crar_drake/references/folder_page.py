"""The page of a folder that was worked on: a table of its motions, the worst first.

One file of HTML without anything from elsewhere; a click on a heading sorts by it.
"""

from __future__ import annotations

import html
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from crar_drake.errors import printable
from crar_drake.files import whole_file
from crar_drake.references.certificate_files import certificate_path

_STYLE = """
body { font: 14px/1.4 system-ui, sans-serif; margin: 1.5em; color: #222; }
table { border-collapse: collapse; }
th, td { padding: 2px 9px; text-align: right; border-bottom: 1px solid #ddd; }
th { position: sticky; top: 0; background: #eef1f5; cursor: pointer; font-weight: 600;
  vertical-align: bottom; max-width: 6.5em; }
th:hover { background: #dde3ec; }
th.by::after { content: " \\2193"; } th.by.up::after { content: " \\2191"; }
.t { text-align: left; } td.t:nth-child(2) { white-space: nowrap; }
.note { min-width: 20em; max-width: 45em; color: #555; }
.bad { color: #a5102a; font-weight: 600; }
tr:hover td { background: #f6f8fa; }
a { color: #1f5c99; text-decoration: none; } a:hover { text-decoration: underline; }
"""

# Cells sort by their numbers, those without by their text; what is no number is last.
_SCRIPT = """
const body = document.querySelector("tbody");
document.querySelectorAll("th").forEach((head, i) => head.onclick = () => {
  const up = head.classList.contains("by") && !head.classList.contains("up");
  document.querySelectorAll("th").forEach(h => h.classList.remove("by", "up"));
  head.classList.add("by"); if (up) head.classList.add("up");
  const number = !head.classList.contains("t");
  const key = row => number ? parseFloat(row.cells[i].textContent)
                            : row.cells[i].textContent;
  const order = (a, b) => number ? b - a : b.localeCompare(a);
  const rows = [...body.rows].map(row => [key(row), row]);
  const none = rows.filter(r => number && isNaN(r[0]));
  const some = rows.filter(r => !(number && isNaN(r[0])))
    .sort((a, b) => up ? order(b[0], a[0]) : order(a[0], b[0]));
  body.append(...some.concat(none).map(r => r[1]));
});
"""


_STATES = ("failed", "violated", "ok")  # the worst first


@dataclass(frozen=True)
class Figure:
    """A column of numbers."""

    heading: str  # with the unit
    # from a row of the table to the number; it may be NaN
    value: Callable[[Any], float]
    digits: int = 0  # behind the point
    bad: bool = False  # whether every number but 0 is something bad


@dataclass(frozen=True)
class PageRow:
    """A motion, or a file that failed."""

    source: Path  # the file that was read
    written: Path  # and where what was made of it is
    clip: Any  # what the table has of it; None of a file that failed
    note: str  # why it failed, or what is to be known besides

    @property
    def state(self) -> str:
        """One of `_STATES`."""
        if self.clip is None:
            return "failed"
        return "violated" if self.clip.violated else "ok"


def write_folder_page(
    path: Path,
    title: str,
    about: str,
    figures: Sequence[Figure],
    rows: Iterable[PageRow],
) -> None:
    """Writes the page, whole or not at all: failed files first, then what violates
    something, and of these first what has most of the first figure.

    Args:
        path: of the .html file.
        title: of the page.
        about: a sentence below it.
        figures: columns.
        rows: in any order.

    Raises:
        WriteError: it cannot be written.
    """
    rows = sorted(rows, key=lambda row: _rank(row, figures[0]))
    counts = Counter(row.state for row in rows)
    said = ", ".join(f"{counts[state]} {state}" for state in _STATES)
    heads = "".join(
        f"<th{kind}>{html.escape(text)}</th>"
        for text, kind in (
            ("state", ' class="t"'),
            ("motion", ' class="t"'),
            *((figure.heading, "") for figure in figures),
            ("note", ' class="t"'),
        )
    )
    lines = "\n".join(_line(row, figures, path.parent) for row in rows)
    text = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>\n<body>"
        f"<h1>{html.escape(title)}</h1><p>{said}. {html.escape(about)}</p>\n<table>"
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{lines}\n</tbody></table>\n"
        f"<script>{_SCRIPT}</script></body></html>\n"
    )
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _rank(row: PageRow, first: Figure) -> tuple[int, float]:
    worst = math.nan if row.clip is None else first.value(row.clip)
    return _STATES.index(row.state), -worst if math.isfinite(worst) else math.inf


def _line(row: PageRow, figures: Sequence[Figure], folder: Path) -> str:
    bad = "" if row.state == "ok" else " bad"
    cells = [f'<td class="t{bad}">{row.state}</td>']
    links = [(row.source, row.source.name)]
    if row.clip is not None:
        written = os.path.relpath(row.written, folder)
        name = f"{written} {row.clip.clip}" if row.clip.clip else written
        certificate = certificate_path(row.written)
        links = [(row.written, name), (row.source, "source")]
        links += [(certificate, "certificate")]
    linked = " · ".join(_link(file, text, folder) for file, text in links)
    cells.append(f'<td class="t">{linked}</td>')
    for figure in figures:
        value = math.nan if row.clip is None else figure.value(row.clip)
        kind = ' class="bad"' if figure.bad and value > 0.0 else ""
        shown = "" if math.isnan(value) else f"{value:.{figure.digits}f}"
        cells.append(f"<td{kind}>{shown}</td>")
    cells.append(f'<td class="t note">{html.escape(printable(row.note))}</td>')
    return f"<tr>{''.join(cells)}</tr>"


def _link(file: Path, text: str, folder: Path) -> str:
    where = quote(os.fsencode(os.path.relpath(file, folder)))
    return f'<a href="{where}">{html.escape(printable(text))}</a>'
