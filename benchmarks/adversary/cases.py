"""Cases, and what came of them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from benchmarks.adversary.attacks import ATTACKS
from benchmarks.adversary.judge import Counts
from benchmarks.adversary.policies import POLICIES
from benchmarks.adversary.random_robots import KINDS
from benchmarks.adversary.robots import ROBOTS

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
class Tally(Counts):
    """What came of episodes; see `Counts` for the other figures.

    Attributes:
        steps, episodes: that were run; refused: whose gains the law refused;
            diverged: ended before time by numbers that are not finite or too large.
        violated: episodes with a violation of distance or position limit.
        admitted: steps admitted as wished, corrected, scaled; all 0 if the law does
            not tell.
        overloaded: steps in which a torque is beyond a motor's limit.
        unheld: steps after which the law itself does not vouch for the invariant.
        by_law, by_plant: of a "torque" case, violated episodes that the exact plant
            violates too, and others; slip: the largest |acceleration - commanded| of
            the others [rad/s^2].
    """

    steps: int = 0
    episodes: int = 0
    refused: int = 0
    diverged: int = 0
    violated: int = 0
    admitted: list[int] = field(default_factory=lambda: [0, 0, 0])
    overloaded: int = 0
    unheld: int = 0
    by_law: int = 0
    by_plant: int = 0
    slip: float = 0.0


@dataclass(kw_only=True)
class Result(Tally):
    """What came of a case.

    Attributes:
        case: it.
        worst: the worst violated episode, to be replayed; None without one.
        error: why the case could not be run; "" if it could.
    """

    case: Case
    worst: dict | None = None
    error: str = ""

    @property
    def failed(self) -> bool:
        """Whether anything was violated, speed limits included."""
        bad = self.violated or self.too_fast or self.diverged or self.overloaded
        return bool(bad)


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
