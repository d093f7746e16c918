"""What a look at the pictures said: does a robot dance as the performer beside it?

Nothing computes that. A verdict is of the run that the picture was drawn of, with
`--sheets`, and holds as long as that run's rms error does.
"""

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


VERDICTS = {
    "G1": Verdict(0.0180),
    "TALOS": Verdict(0.0671),
    "TALOS, reduced": Verdict(0.0720),
    "Romeo": Verdict(0.0651, "partly: the arm rises half as far"),
    "iCub of 2016": Verdict(0.0438),
    "simple humanoid": Verdict(0.0913, "its model has no shapes to look at"),
    "human": Verdict(0.0084),
    "Alex": Verdict(0.0402),
    "Centauro": Verdict(0.2289, "partly: the arms do, the trunk is 0.2 m ahead"),
    "Baxter": Verdict(0.1977, "the arm does not rise: its joints are too slow"),
    "PR2": Verdict(
        0.4019, "its arms begin folded, and its base is where they would hang"
    ),
    "PR2, robosuite": Verdict(
        0.2071, "partly: the arm rises, both hang wide around its base"
    ),
    "TIAGo, two arms": Verdict(
        0.1299, "the arm does not rise: its joints are too slow"
    ),
    "TIAGo Pro": Verdict(0.1653, "the arm does not rise: its joints are too slow"),
    "iCub 2.5": Verdict(0.0348),
    "iCub 2.7": Verdict(0.0349),
    "iCub Genova 4": Verdict(0.0349),
    "G1, MJCF": Verdict(0.0190),
    "JVRC-1": Verdict(0.0377),
    "Booster T1": Verdict(0.0348),
    "Booster T1, MJCF": Verdict(
        0.0361, "partly: the arms do, it crouches with its knees apart"
    ),
    "H1": Verdict(0.0275),
    "H1, robosuite": Verdict(0.0291),
    "Gene01": Verdict(0.0510),
    "Vega 1": Verdict(0.1003, "partly: the arm rises late and half as far"),
    "Vega 1u": Verdict(0.1027, "partly: the arm rises late and half as far"),
    "Vega 1p, hands": Verdict(0.1005, "partly: the arm rises late and half as far"),
    "ARMAR-4": Verdict(0.0960, "partly: the arm rises late and half as far"),
    "ARMAR-6": Verdict(0.213, "the arm rises late and half as far"),
    "Orcabot": Verdict(0.0643),
    "Orcabot, MJCF": Verdict(0.0465),
    "GR-1": Verdict(0.0345),
    "GR-2": Verdict(0.0452),
    "GR-3": Verdict(0.0249),
    "Qinglong": Verdict(0.0860, "partly: the arm rises late and half as far"),
    "OpenArm": Verdict(0.0443),
    "ALOHA": Verdict(0.5272, "two arms that face each other on a table are no body"),
    "YuMi": Verdict(0.1432, "partly: the hands do, the elbows stand out"),
}


def verdict(name: str, outcome: Outcome) -> str:
    """What was said of a robot's run; NOT_LOOKED_AT if nothing was, or of another."""
    found = VERDICTS.get(name)
    if found is None or outcome.error is None:
        return NOT_LOOKED_AT
    return found.said if abs(found.error - outcome.error) < _SAME else NOT_LOOKED_AT
