"""What a look at the pictures said: does a robot dance as the performer beside it?

Nothing computes that. A verdict is of the run that the picture was drawn of, with
`--sheets`, and holds as long as that run's rms error does.
"""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.robots.trial import Outcome

NOT_LOOKED_AT = "not looked at"
_SAME = 0.003  # [m] that the error may differ by


@dataclass(frozen=True)
class Verdict:
    """A look at a picture.

    Attributes:
        error: rms error of the run that was looked at [m].
        said: "yes", or what is wrong.
    """

    error: float
    said: str = "yes"


VERDICTS: dict[str, Verdict] = {}


def verdict(name: str, outcome: Outcome) -> str:
    """What was said of a robot's run; NOT_LOOKED_AT if nothing was, or of another."""
    found = VERDICTS.get(name)
    if found is None or outcome.error is None:
        return NOT_LOOKED_AT
    return found.said if abs(found.error - outcome.error) < _SAME else NOT_LOOKED_AT
