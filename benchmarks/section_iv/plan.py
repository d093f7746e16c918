"""What Section IV simulates: motions, experiments, levels, variants, damping factors.

A plan is a list of simulations, each a whole scenario with a name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from benchmarks.sweep.cases import clip_label
from crar_drake.errors import CrarError
from crar_drake.law.parameters import (
    LEVELS,
    LookaheadParameters,
    PaperParameters,
    Parameters,
)
from crar_drake.motion.catalogue import load_clip
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.simulation.scenario import Scenario

# The paper's four kinds of motion, in its order, and which they are here.
MOTION_SETS = {
    "builtin": ("dance", "exercise", "reaching", "boxing"),
    "cmu": ("cmu:05_02", "cmu:13_29", "cmu:14_07", "cmu:13_17"),
}
EXPERIMENT_1, EXPERIMENT_2 = "wrists", "upper-body"
assert set(EXPERIMENTS) == {EXPERIMENT_1, EXPERIMENT_2}

# Degrees of redundancy in Experiment 1: n = 11 joints for m = 6 rows.
REDUNDANCY = 5

PAPER = PaperParameters()
RAW = replace(PAPER, constraints="none")

# The columns of Figs. 4 to 7: the paper's two levels, and what this project adds.
SERIES = {
    "velocity": replace(PAPER, level="velocity"),
    "acceleration": PAPER,
    "lookahead": LookaheadParameters(),
}

# The improvements that the paper names, of the acceleration level in Experiment 1.
VARIANTS = {
    "inertia": replace(PAPER, metric="inertia"),
    "less-damping": replace(PAPER, damping=0.05),
}

# Of the sweep over lambda [m]; the paper's is 0.1.
DAMPING_FACTORS = (0.4, 0.2, 0.1, 0.05, 0.03, 0.02)

LABELS = {
    "raw": "raw motion",
    "velocity": "velocity level",
    "acceleration": "acceleration level",
    "lookahead": "lookahead",
    "inertia": "inertia in W",
    "less-damping": "λ = 0.05 m",
}


@dataclass(frozen=True)
class Simulation:
    """One simulation of the plan.

    Attributes:
        motion: name of the motion.
        experiment: EXPERIMENT_1 or EXPERIMENT_2.
        series: what is varied: a key of LABELS, or "damping-..." of the sweep.
        scenario: all of it, as YAML text.
        duration: that it will simulate [s].
        keep_log: whether figures need its samples.
    """

    motion: str
    experiment: str
    series: str
    scenario: str
    duration: float
    keep_log: bool = False

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{clip_label(self.motion)}_{self.experiment}_{self.series}"


@dataclass(frozen=True)
class Plan:
    """All simulations of one reproduction.

    Attributes:
        motions: in the order of the paper; the first is the dance.
        simulations: what is to be run.
        damping: names of the simulations of the sweep on the dance, by level,
            constraints and lambda [m].
        duration: that the motions are cut to [s]; None for whole motions.
    """

    motions: tuple[str, ...]
    simulations: tuple[Simulation, ...]
    damping: dict[tuple[str, str, float], str]
    duration: float | None

    @property
    def damping_factors(self) -> tuple[float, ...]:
        """Of the sweep [m], in its order."""
        return tuple(dict.fromkeys(value for _, _, value in self.damping))

    @property
    def dance(self) -> str:
        """The motion of Figs. 2 and 3."""
        return self.motions[0]


def make_plan(
    motions: Sequence[str] = MOTION_SETS["builtin"],
    *,
    duration: float | None = None,
    damping_factors: Sequence[float] = DAMPING_FACTORS,
) -> Plan:
    """Plans a reproduction.

    Args:
        motions: names of motions; the first takes the part of the dance.
        duration: cuts every motion [s]; by default they are whole.
        damping_factors: of the sweep [m].

    Raises:
        CrarError: there is no motion, or one cannot be loaded, or two would have
            the same files.
    """
    if not motions:
        raise CrarError("give at least one motion; the first is the dance")
    labels = [clip_label(motion) for motion in motions]
    for label in labels:
        if labels.count(label) > 1:
            raise CrarError(f"two of the motions are called {label}")
    # A motion that is not there is reported before anything is simulated.
    durations = {motion: load_clip(motion).duration for motion in motions}
    if duration is not None:
        durations = {motion: min(duration, d) for motion, d in durations.items()}

    def simulation(
        motion: str, experiment: str, series: str, gains: Parameters, **keep: bool
    ) -> Simulation:
        scenario = Scenario(
            motion=motion,
            experiment=experiment,
            controller=gains,
            duration=None if duration is None else durations[motion],
            log_period=gains.period,  # every step is judged
        )
        scenario.validate()
        return Simulation(
            motion, experiment, series, scenario.to_yaml(), durations[motion], **keep
        )

    dance = motions[0]
    plan = [
        simulation(dance, experiment, "raw", RAW, keep_log=True)
        for experiment in (EXPERIMENT_1, EXPERIMENT_2)
    ]
    for motion in motions:
        plan += [
            simulation(motion, experiment, name, gains, keep_log=motion == dance)
            for experiment in (EXPERIMENT_1, EXPERIMENT_2)
            for name, gains in SERIES.items()
        ]
        plan += [
            simulation(motion, EXPERIMENT_1, name, gains)
            for name, gains in VARIANTS.items()
        ]
    # Points of the sweep that were planned already are not run twice.
    known = {s.scenario: s for s in plan}
    damping = {}
    for constraints in ("paper", "none"):
        for level in LEVELS:
            for value in damping_factors:
                gains = replace(
                    PAPER, level=level, constraints=constraints, damping=value
                )
                series = f"damping-{level}-{constraints}-{value:g}"
                point = simulation(dance, EXPERIMENT_1, series, gains)
                point = known.setdefault(point.scenario, point)
                damping[level, constraints, value] = point.name
    return Plan(tuple(motions), tuple(known.values()), damping, duration)
