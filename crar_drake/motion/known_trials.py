"""Trials of the CMU database whose checksums are known."""

import csv
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class KnownTrial:
    """Facts about a trial, against which a download is checked.

    Attributes:
        frames: number of samples.
        amc_sha256: of the motion file, in hexadecimal.
        asf_sha256: of the subject's skeleton file, in hexadecimal.
    """

    frames: int
    amc_sha256: str
    asf_sha256: str


@functools.cache
def known_trials() -> Mapping[str, KnownTrial]:
    """Returns the trials whose checksums are known, by number."""
    with open(Path(__file__).with_name("known_trials.csv"), encoding="utf-8") as file:
        return {
            row["trial"]: KnownTrial(
                int(row["frames"]), row["amc_sha256"], row["asf_sha256"]
            )
            for row in csv.DictReader(file)
        }
