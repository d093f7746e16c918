"""The pages of docs/measurements: text by hand, tables by the benchmarks.

A page has blocks, each between a line with the name of a *part* and an end:

    <!-- defaults -->
    <!-- end -->

What stands in a block is written from the part's results, which are kept in
`data/PAGE.json` beside the page. A benchmark that is run with `--page` keeps what it
measured there and renders the page. Without running anything,

    python -m benchmarks.page [PAGE ...]

renders pages (by default all of docs/measurements) from the results that are there.
"""

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from crar_drake import __version__
from crar_drake.commands.output import exit_code
from crar_drake.errors import CrarError
from crar_drake.files import write_whole

ROOT = Path(__file__).resolve().parents[1]  # of the checkout
PAGES = ROOT / "docs" / "measurements"
_BLOCK = re.compile(r"(?s)(<!-- ([\w ,.-]+) -->\n)(.*?)(<!-- end -->\n)")
_WIDTH = 88
# Where a path in a command lies on every machine.
_FOLDERS = ("CRAR_MOCAP_PATH", "CRAR_ROBOT_MOTIONS")


@dataclass(frozen=True)
class Table:
    """A table of a page; every cell is text.

    Attributes:
        columns: the header.
        rows: as long as the header each.
        title: a heading above the table; "" for none.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""

    def markdown(self) -> str:
        heading = f"### {self.title}\n\n" if self.title else ""
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        return heading + "".join("| " + " | ".join(line) + " |\n" for line in lines)


@dataclass(frozen=True)
class Part:
    """The results of one run of a benchmark.

    Attributes:
        command: that measured them; several have a line each.
        machine: that they were measured on.
        law: the version of the law, and the watched pairs, that they are of.
        tables: the figures.
        found: sentences in Markdown that the benchmark made of them.
    """

    command: str
    machine: str
    law: str
    tables: Sequence[Table]
    found: str = ""

    def markdown(self) -> str:
        """What stands in the part's block; the results say more."""
        texts = [textwrap.indent(_brief(self.command), "    ")]
        if self.found:
            texts.append(_wrapped(self.found))
        machine, law = _without_versions(self.machine, self.law)
        about = " ".join(f"{text}." for text in (machine, law) if text)
        texts += [_wrapped(about), *(table.markdown() for table in self.tables)]
        return "\n\n".join(text.strip("\n") for text in texts if text) + "\n"


class Benchmark:
    """The command line of a benchmark, and its part of a page.

    Attributes:
        parser: to add options to.
    """

    def __init__(self, module: str, doc: str, page: str) -> None:
        """
        Args:
            module: the benchmark's, as `python -m` takes it.
            doc: its docstring; the first line describes it.
            page: the name of its page.
        """
        self._module, self._page = module, page
        self.parser = argparse.ArgumentParser(
            prog=f"python -m {module}", description=doc.strip().splitlines()[0]
        )
        self.parser.add_argument(
            "--page",
            type=Path,
            metavar="FILE",
            help=f"keep the results, and render this page: {_shown_page(page)}",
        )

    def parse(
        self,
        argv: Sequence[str] | None,
        part: Callable[[argparse.Namespace], str],
    ) -> argparse.Namespace:
        """The options.

        Args:
            argv: by default those of the process.
            part: of the page, for the options.

        Raises:
            CrarError: as `check_part`.
        """
        arguments = self.parser.parse_args(argv)
        self._given = list(sys.argv[1:] if argv is None else argv)
        self._path, self._part = arguments.page, part(arguments)
        if self._path is not None:
            check_part(self._path, self._part)  # before minutes of measuring
        return arguments

    def report(
        self, tables: Sequence[Table], found: str = "", versions: str = ""
    ) -> None:
        """Prints what was measured; with --page it becomes a part of the page.

        Args:
            tables: the figures.
            found: as `Part` has it.
            versions: of what else the figures are of.

        Raises:
            CrarError: as `write_part`.
        """
        command = command_line(self._module, self._given, self._page)
        machine = machine_line() + (f"; {versions}" if versions else "")
        result = Part(command, machine, version_line(), tables, found)
        print(*(t.markdown() for t in tables), found and f"{found}\n", sep="\n")
        if self._path is not None:
            write_part(self._path, self._part, result)
            print(self._path)


def run(main: Callable[[], int | None]) -> None:
    """Runs a command, and ends with its `exit_code`."""
    sys.exit(exit_code(main))


def command_line(module: str, given: Sequence[str], page: str) -> str:
    """A command that writes a page, without what is of this machine alone.

    Args:
        module: as `python -m` takes it.
        given: its options.
        page: the name of the page.
    """
    rest = iter(given)
    words = [_shown(word) for word in rest if not _is_page(word, rest)]
    return " ".join([f"python -m {module}", *words, f"--page {_shown_page(page)}"])


def describe_machine() -> dict:
    """What measured durations depend on: the processor, the versions."""
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "threads": os.environ.get("OMP_NUM_THREADS", "not set"),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "drake": version("drake"),
    }


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def machine_line() -> str:
    """`describe_machine` in a line."""
    m = describe_machine()
    load = "" if m["load"] is None else f", load average {m['load']:.1f}"
    return (
        f"{m['cpu']}, {m['cores']} cores{load}, {m['system']}; threads of BLAS "
        f"{m['threads']}; Python {m['python']}, NumPy {m['numpy']}, Drake {m['drake']}"
    )


def version_line() -> str:
    """The version of this project, with the commit where there is one.

    It is `-dirty` where a file that git tracks was changed and not committed, but for
    pages of measurements, which runs write.
    """

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
        return done.stdout.strip()

    try:
        commit = git("describe", "--always")
        changed = git(
            "diff", "HEAD", "--name-only", "--", ".", f":!{PAGES.relative_to(ROOT)}"
        )
    except OSError:
        commit = changed = ""
    dirty = "-dirty" if changed else ""
    return f"crar_drake {__version__}{f', commit {commit}{dirty}' if commit else ''}"


def results_of(page: Path) -> Path:
    """Where a page's results are kept."""
    return page.parent / "data" / f"{page.stem}.json"


def read_parts(page: Path) -> dict[str, Part]:
    """The results of a page, by part; nothing where none are kept.

    Raises:
        CrarError: the file of results is none.
    """
    path = results_of(page)
    if not path.is_file():
        return {}
    try:
        parts = json.loads(path.read_text(encoding="utf-8"))
        return {
            name: Part(**{**part, "tables": [Table(**t) for t in part["tables"]]})
            for name, part in parts.items()
        }
    except (ValueError, KeyError, TypeError) as error:
        raise CrarError(f"{path}: not the results of a page: {error}") from error


def write_part(page: Path, name: str, part: Part) -> None:
    """Keeps the results of a part, and writes its block of the page.

    Raises:
        CrarError: as `check_part`.
    """
    check_part(page, name)
    parts = read_parts(page) | {name: part}
    text = _filled(_read(page), {name: part})
    results_of(page).parent.mkdir(parents=True, exist_ok=True)
    write_whole(
        results_of(page),
        _one_line_a_row({name: asdict(part) for name, part in parts.items()}),
    )
    write_whole(page, text)


def check_part(page: Path, name: str) -> None:
    """Raises CrarError if a page cannot be read, or has not one block of that name."""
    if [match[2] for match in _BLOCK.finditer(_read(page))].count(name) != 1:
        raise CrarError(
            f"{page}: needs the line <!-- {name} --> once, and <!-- end --> after it"
        )


def render(page: Path) -> str:
    """The page, each of its blocks as the part's results say.

    Raises:
        CrarError: the page or its results cannot be read, or a part has no results.
    """
    text, known = _read(page), read_parts(page)
    for match in _BLOCK.finditer(text):
        if match[2] not in known:
            raise CrarError(f"{results_of(page)}: has no results of {match[2]!r}")
    return _filled(text, known)


def _filled(text: str, parts: dict[str, Part]) -> str:
    """A page's text with the blocks of these parts; others as they are."""

    def block(match: re.Match) -> str:
        begin, name, _, end = match.groups()
        if name not in parts:
            return match[0]
        return f"{begin}\n{parts[name].markdown()}\n{end}"

    return _BLOCK.sub(block, text)


def main(argv: Sequence[str] | None = None) -> None:
    """Renders pages from their results."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.page", description="Renders pages of measurements."
    )
    parser.add_argument("pages", nargs="*", type=Path, help="(default: all)")
    for page in parser.parse_args(argv).pages or sorted(PAGES.glob("*.md")):
        text = render(page)
        write_whole(page, text)


def _read(page: Path) -> str:
    try:
        return page.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CrarError(f"{page}: not a page of text: {error}") from error


def _one_line_a_row(parts: dict) -> str:
    """JSON in which each row of a table has a line."""
    text = json.dumps(parts, indent=1, ensure_ascii=False)
    text = re.sub(r'\[\n {5,6}(?=")', "[", text)
    text = re.sub(r'\n {5,6}(?=")', " ", text)
    return re.sub(r"\n {4,5}(?=\])", "", text) + "\n"


def _brief(command: str) -> str:
    """A command without its page, and with recordings in the shell's braces."""

    def braced(found: re.Match) -> str:
        return f"cmu:{{{','.join(found[0].replace('cmu:', '').split(' '))}}}"

    return re.sub(r"cmu:\w+(?: cmu:\w+)+", braced, re.sub(r" --page \S+", "", command))


def _without_versions(machine: str, law: str) -> tuple[str, str]:
    """A `machine_line` and a `version_line`; their versions stay in the results."""
    same = ("threads of BLAS ", "Python ")
    shown = [said for said in machine.split("; ") if not said.startswith(same)]
    return "; ".join(shown), re.sub(r"^crar_drake \S+, c(?=ommit)", "C", law)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, _WIDTH, break_on_hyphens=False, break_long_words=False)


def _shown_page(name: str) -> str:
    return f"docs/measurements/{name}.md"


def _is_page(word: str, rest) -> bool:
    """Whether a word is the option --page; its value is taken off the rest."""
    if word == "--page":
        next(rest)
    return word.partition("=")[0] == "--page"


def _shown(word: str) -> str:
    """A word of a command as it may stand in a page."""
    for variable in _FOLDERS:
        folder = os.environ.get(variable)
        if folder and Path(word).is_relative_to(folder):
            below = Path(word).relative_to(folder)
            return f"${variable}" + ("" if below == Path() else f"/{below}")
    return shlex.quote(Path(word).name if os.path.isabs(word) else word)


if __name__ == "__main__":
    run(main)
