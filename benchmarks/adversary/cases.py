"""Cases, and what came of them, kept so that a stopped run goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import crar_drake
from benchmarks.adversary.attacks import ATTACKS
from benchmarks.adversary.policies import POLICIES
from benchmarks.adversary.random_robots import KINDS
from benchmarks.adversary.robots import ROBOTS
from crar_drake.files import write_whole

PLANTS = ("exact", "torque", "filter")
EXACT_ONLY = ("posture", "switched")
PERIODS = (0.001, 0.005, 0.01, 0.02)  # [s]


@dataclass(frozen=True)
class Case:
    """One attack on one robot at one control period.

    Attributes:
        robot, attack: names.
        period: control period [s].
        plant: "exact", whose next state is the law's `position_command`; "torque",
            the simulated robot in the whole diagram; or "filter", whose next state is
            the command of a filter of joint commands, attacked by policies.
        constraints: of the law.
        steps: control steps, at least.
        seed: of all dice.
        paper: whether the lookahead's nominal is the paper's law, instead of a plan.
        motors: the share of the motors' limits that a filter may use; 0 for no limits.
    """

    robot: str
    attack: str
    period: float
    plant: str = "exact"
    constraints: str = "lookahead"
    steps: int = 5000
    seed: int = 0
    paper: bool = False
    motors: float = 0.0


@dataclass
class Result:
    """What came of a case.

    Attributes:
        case: it.
        law: digest of what was attacked, and by what; see `law_digest`.
        steps, episodes: that were run; refused: whose gains the law refused;
            diverged: ended before time by numbers that are not finite or too large.
        violated: episodes with a violation of distance or position limit.
        states, penetrating, below, beyond_limit, too_fast, ahead, paths, blocked: sums
            over all episodes, see `Verdict`.
        clearance, pair, path_clearance, path_pair, excess, joint, overspeed: worst.
        admitted: steps admitted as wished, corrected, scaled; all 0 if the law does
            not tell.
        overloaded: steps in which a torque is beyond a motor's limit.
        unheld: steps after which the law itself does not vouch for the invariant.
        by_law, by_plant: of a "torque" case, violated episodes that the exact plant
            violates too, and others; slip: the largest |acceleration - commanded| of
            the others [rad/s^2].
        wall: [s].
        worst: the worst violated episode, to be replayed; None without one.
        error: why the case could not be run; "" if it could.
    """

    case: Case
    law: str = ""
    steps: int = 0
    episodes: int = 0
    refused: int = 0
    diverged: int = 0
    violated: int = 0
    states: int = 0
    penetrating: int = 0
    below: int = 0
    beyond_limit: int = 0
    too_fast: int = 0
    ahead: int = 0
    paths: int = 0
    blocked: int = 0
    clearance: float = float("inf")
    pair: str = ""
    path_clearance: float = float("inf")
    path_pair: str = ""
    excess: float = 0.0
    joint: str = ""
    overspeed: float = 0.0
    admitted: list[int] = field(default_factory=lambda: [0, 0, 0])
    overloaded: int = 0
    unheld: int = 0
    by_law: int = 0
    by_plant: int = 0
    slip: float = 0.0
    wall: float = 0.0
    worst: dict | None = None
    error: str = ""

    @property
    def unsafe(self) -> bool:
        """Whether anything was violated, speed limits included."""
        bad = self.violated or self.too_fast or self.diverged or self.overloaded
        return bool(bad)


def law_digest() -> str:
    """Twelve digits that change with the source of the controller or of the attacks."""
    package, here = Path(crar_drake.__file__).parent, Path(__file__).parent
    folders = [package / part for part in ("law", "robot")]
    digest = hashlib.sha256()
    for folder in [*folders, here]:
        for path in sorted(folder.rglob("*.py")):
            if path != here / "report.py":
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def make_cases(
    robots: Sequence[str] = ROBOTS,
    attacks: Sequence[str] | None = None,
    periods: Sequence[float] = PERIODS,
    plants: Sequence[str] = ("exact",),
    **settings,
) -> list[Case]:
    """Every combination that there is.

    Only robots with prescribed joints have moving obstacles, and the whole diagram
    has no source of nominal postures, keeps its law, and simulates robots of files.

    Args:
        robots, attacks, periods, plants: by name; attacks by default all of the plant,
            and of those named the ones that it has.
        settings: of all cases.
    """
    return [
        Case(robot, attack, period, plant, **settings)
        for plant in plants
        for robot in robots
        for period in periods
        for attack in attacks_on(plant)
        if attacks is None or attack in attacks
        if not (attack == "moving" and robot in ("obstacle_arm", "shelf_arm"))
        and not (plant == "torque" and (attack in EXACT_ONLY or robot in KINDS))
    ]


def attacks_on(plant: str) -> tuple[str, ...]:
    """The names of the attacks on one of PLANTS."""
    return tuple(POLICIES if plant == "filter" else ATTACKS)


def read_results(path: Path, law: str) -> dict[Case, Result]:
    """Results of earlier runs against the same law, by case; without failed ones."""
    if not path.is_file():
        return {}
    try:
        kept = json.loads(path.read_text())
        found = [Result(Case(**each.pop("case")), **each) for each in kept["results"]]
    except (ValueError, KeyError, TypeError):  # of another version
        return {}
    return {r.case: r for r in found if r.law == law and not r.error}


def write_results(path: Path, results: Iterable[Result]) -> None:
    """Writes them all, so that a stopped run goes on."""
    kept = {"results": [asdict(result) for result in results]}
    write_whole(path, json.dumps(kept, indent=1))
