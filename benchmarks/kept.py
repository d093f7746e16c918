"""Results of long benchmarks, kept by seed: what is stopped goes on where it was.

Each seed has a file `out/NAME/seed-N.json`. What is measured in it, and by which
version, is known by its keys, so that seeds that were run one after the other, or on
other days, add up to one table.
"""

import argparse
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.page import ROOT, version_line
from crar_drake.errors import CrarError
from crar_drake.files import write_whole


def seed_number(text: str) -> int:
    """Converts a seed of dice: a whole number that is not negative."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a whole number from 0 on, as seeds are"
        )
    return int(text)


def add_seeds(parser: argparse.ArgumentParser, name: str) -> None:
    """Adds the option --seeds to a benchmark's."""
    parser.add_argument(
        "--seeds", type=seed_number, nargs="+", default=[1], metavar="SEED",
        help=f"of all dice; each is kept in out/{name}, and gone on with (default: 1)",
    )  # fmt: skip


# Of what was imported, whatever becomes of the checkout meanwhile.
_version = cache(version_line)


class Kept:
    """What is kept of a seed.

    Attributes:
        results: key to what was measured, plain values.
    """

    def __init__(self, name: str, seed: int, folder: Path = ROOT / "out") -> None:
        """Reads what is there.

        Raises:
            CrarError: the file is none of results.
        """
        self._version = _version()
        self._path = folder / name / f"seed-{seed}.json"
        self._versions: list[str] = []
        self.results: dict[str, Any] = {}
        if not self._path.is_file():
            return
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
            self._versions, self.results = found["versions"], found["results"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CrarError(
                f"{self._path}: no results of a seed ({error}); delete it"
            ) from error

    def keep(self, results: dict[str, Any]) -> None:
        """Adds results, by this version."""
        self.results |= results
        if self._version not in self._versions:
            self._versions.append(self._version)
        write_whole(
            self._path,
            json.dumps({"versions": self._versions, "results": self.results}),
        )

    @property
    def versions(self) -> list[str]:
        return list(self._versions)


def measured_by(kept: Sequence[Kept]) -> str:
    """A sentence of the versions that measured seeds, "" where it is this one."""
    versions = sorted({version for each in kept for version in each.versions})
    return "" if versions == [_version()] else f"Measured by {'; '.join(versions)}."
