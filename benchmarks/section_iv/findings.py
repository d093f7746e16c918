"""The paper's findings, each tested on the data of a reproduction.

A finding holds if its criterion does for every motion; the criteria are fixed here,
before any data. "Significant" is a quarter: bars that differ by less look alike.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.section_iv.figures import violation_counts
from benchmarks.section_iv.plan import (
    EXPERIMENT_1,
    EXPERIMENT_2,
    LABELS,
    REDUNDANCY,
    Plan,
)
from benchmarks.section_iv.simulate import Outcome
from benchmarks.sweep.cases import Result
from benchmarks.sweep.figures import clip_label
from crar_drake.law.parameters import LEVELS
from crar_drake.results.log import SimulationLog

SIGNIFICANT = 0.25
# A damping factor is tolerated up to this multiple of the power at the paper's.
TOLERATED_POWER = 2.0
PAPER_DAMPING = 0.1  # lambda of Section IV [m]


@dataclass(frozen=True)
class Finding:
    """A statement of the paper and what became of it.

    Attributes:
        source: where the paper makes it.
        statement: in our words.
        criterion: what must be true of the data.
        holds: whether it is.
        figures: the data that decide it.
        reason: what else the data say, above all where it does not hold; may be "".
    """

    source: str
    statement: str
    criterion: str
    holds: bool
    figures: str
    reason: str = ""

    @property
    def verdict(self) -> str:
        """As the report prints it."""
        return "holds" if self.holds else "does not hold"


class Data:
    """Outcomes by motion, experiment and series, and sentences about them."""

    def __init__(self, plan: Plan, outcomes: Mapping[str, Outcome]) -> None:
        self.plan = plan
        self.outcomes = outcomes
        self._by_key = {
            (o.simulation.motion, o.simulation.experiment, o.simulation.series): o
            for o in outcomes.values()
        }

    def of(self, motion: str, experiment: str, series: str) -> Outcome:
        """The outcome of a simulation that is not one of the sweep."""
        return self._by_key[motion, experiment, series]

    def ratios(self, field: str, over: tuple[str, str], under: tuple[str, str]) -> dict:
        """By motion, the quotient of a field in two (experiment, series)."""
        return {
            motion: getattr(self.of(motion, *over).result, field)
            / getattr(self.of(motion, *under).result, field)
            for motion in self.plan.motions
        }


def _percent(ratios: Mapping[str, float]) -> str:
    return ", ".join(
        f"{clip_label(m)} {100 * (r - 1):+.0f} %" for m, r in ratios.items()
    )


def _alike(ratios: Mapping[str, float]) -> bool:
    """Neither is a quarter more than the other."""
    return all(max(r, 1.0 / r) < 1.0 + SIGNIFICANT for r in ratios.values())


def _failing(ratios: Mapping[str, float], good: Callable[[float], bool]) -> list[str]:
    return [motion for motion, ratio in ratios.items() if not good(ratio)]


def check_findings(
    plan: Plan,
    outcomes: Mapping[str, Outcome],
    log: Callable[[str, str], SimulationLog],
) -> list[Finding]:
    """Tests every finding, in the paper's order.

    Args:
        plan, outcomes: of the reproduction; every simulation succeeded.
        log: loads the dance's log of an experiment and a series.
    """
    data = Data(plan, outcomes)
    return [
        _many_violations(log(EXPERIMENT_1, "raw")),
        *_distances(data),
        _error_between_levels(data, EXPERIMENT_1),
        _power_between_levels(data),
        _spikes(data),
        *_damping(data),
        _error_between_experiments(data),
        _power_between_experiments(data),
        _error_between_levels(data, EXPERIMENT_2),
        _power_alike_between_levels(data),
        _inertia(data),
    ]


def _many_violations(raw: SimulationLog) -> Finding:
    counts = violation_counts(raw)
    above = counts > REDUNDANCY
    latter = above[len(above) // 2 :].sum() / max(above.sum(), 1)
    return Finding(
        "Fig. 2",
        "The raw dance violates more than five constraints at once in parts of its "
        "latter half: there Experiment 1 has no redundancy left.",
        "some sample of the latter half has more than five violations",
        bool(above[len(above) // 2 :].any()),
        f"at most {counts.max()} at once; more than five in {_share(above.mean())} of "
        f"the samples, {_share(latter)} of these in the latter half",
    )


def _distances(data: Data) -> list[Finding]:
    findings = []
    for level in LEVELS:
        outcome = data.of(data.plan.dance, EXPERIMENT_2, level)
        distance = outcome.result.smallest_distance
        reason = ""
        if distance < 0.0:
            ahead = data.of(data.plan.dance, EXPERIMENT_2, "lookahead").result
            reason = (
                f"{_share(outcome.result.penetrating / outcome.result.samples)} of the "
                "samples penetrate. At this level W weighs accelerations, which does "
                "not stop a velocity (the paper says so after Eq. 34), and a joint is "
                "set free while its own share of a pair's gradient falls although the "
                f"pair approaches. lookahead: {_mm(ahead.smallest_distance)}."
            )
        findings.append(
            Finding(
                "Fig. 3",
                "The distances of all thirty pairs stay positive over the dance in "
                f"Experiment 2 ({LABELS[level]}; the paper does not say which).",
                "no pair is at d < 0 in any sample",
                outcome.result.penetrating == 0,
                f"smallest distance {_mm(distance)}, {outcome.result.smallest_pair}",
                reason,
            )
        )
    for level in LEVELS:
        cells, deep = [], []
        for motion in data.plan.motions:
            for experiment in (EXPERIMENT_1, EXPERIMENT_2):
                r = data.of(motion, experiment, level).result
                cells.append(
                    f"{clip_label(motion)} {experiment} {_mm(r.smallest_distance)}"
                )
                if r.penetrating:
                    deep.append(f"{clip_label(motion)} {experiment}")
        limits = [
            data.of(motion, experiment, level).result
            for motion in data.plan.motions
            for experiment in (EXPERIMENT_1, EXPERIMENT_2)
        ]
        beyond = sum(r.beyond_limit for r in limits) / sum(r.samples for r in limits)
        findings.append(
            Finding(
                "Section V",
                f"Constraints are satisfied, whatever the motion ({LABELS[level]}).",
                "no sample of any motion has a penetrating pair, or a joint beyond "
                "its limit",
                not deep and beyond == 0.0,
                f"{_share(beyond)} of the samples have a joint beyond its limit; "
                "smallest distances " + ", ".join(cells),
                (f"Penetrating: {', '.join(deep)}. " if deep else "")
                + (_farthest(limits) if beyond else ""),
            )
        )
    return findings


def _farthest(results: list[Result]) -> str:
    """How far joints go beyond their limits."""
    worst = max(results, key=lambda r: r.largest_excess)
    return (
        f"A joint is {np.degrees(worst.largest_excess):.1f}° beyond its limit at worst "
        f"({clip_label(worst.motion)} {worst.experiment}): W slows a joint in "
        "proportion, and the loop of Gv needs 1/Gv to stop it."
    )


def _error_between_levels(data: Data, experiment: str) -> Finding:
    number = 1 if experiment == EXPERIMENT_1 else 2
    ratios = data.ratios(
        "rms_task_error", (experiment, "acceleration"), (experiment, "velocity")
    )
    parts = []
    for motion in _failing(ratios, lambda r: _alike({"": r})):
        worse = "acceleration" if ratios[motion] > 1.0 else "velocity"
        details = data.of(motion, experiment, worse).details
        parts.append(
            f"{clip_label(motion)}, {LABELS[worse]}: "
            f"{_share(details.squared_error_in_violation)} of the squared error comes "
            f"from the {_share(details.violated_share)} of the samples in violation "
            f"(rms {_mm(details.error_in_violation)} there, "
            f"{_mm(details.error_otherwise)} elsewhere"
            + (
                f"; {details.limited_joint} is beyond its limit in "
                f"{_share(details.limited_joint_share)} of all samples)."
                if details.limited_joint
                else ")."
            )
        )
    return Finding(
        "Fig. 4" if number == 1 else "Fig. 6",
        f"The task error of Experiment {number} does not differ significantly between "
        "the levels.",
        "on each motion, neither level's error is a quarter more than the other's",
        _alike(ratios),
        f"acceleration against velocity level: {_percent(ratios)}",
        " ".join(parts),
    )


def _power_between_levels(data: Data) -> Finding:
    over, under = (EXPERIMENT_1, "acceleration"), (EXPERIMENT_1, "velocity")
    ratios = data.ratios("mean_power", over, under)
    parts = []
    for motion in _failing(ratios, lambda r: r < 1.0):
        a, v = data.of(motion, *over), data.of(motion, *under)
        parts.append(
            f"{clip_label(motion)}: the acceleration level violates constraints in "
            f"{_share(a.details.violated_share)} of the samples (velocity level "
            f"{_share(v.details.violated_share)}), mostly of "
            f"{a.details.limited_joint or 'pairs'}, where it takes "
            f"{_watt(a.details.power_in_violation)}, elsewhere "
            f"{_watt(a.details.power_otherwise)}."
        )
    return Finding(
        "Fig. 5",
        "In Experiment 1 the acceleration level takes less power.",
        "on each motion, it does",
        all(r < 1.0 for r in ratios.values()),
        f"acceleration against velocity level: {_percent(ratios)}",
        " ".join(parts),
    )


def _spikes(data: Data) -> Finding:
    cells, holds = [], True
    for motion in data.plan.motions:
        v, a = (data.of(motion, EXPERIMENT_1, level) for level in LEVELS)
        holds &= (
            v.result.peak_torque > a.result.peak_torque
            and v.details.rms_torque_step > a.details.rms_torque_step
        )
        cells.append(
            f"{clip_label(motion)} peak {v.result.peak_torque:.0f} against "
            f"{a.result.peak_torque:.0f} Nm, rms change a sample "
            f"{v.details.rms_torque_step:.1f} against "
            f"{a.details.rms_torque_step:.1f} Nm"
        )
    v = data.of(data.plan.dance, EXPERIMENT_1, "velocity").details
    free = data.outcomes.get(data.plan.damping.get(("velocity", "none", PAPER_DAMPING)))
    reason = (
        f"In the dance {_share(v.spikes_at_jumps)} of the velocity level's spikes come "
        f"in a sample in which W jumps ({_share(v.jumps)} of all samples do): Eqs. 18 "
        "and 21 switch at once, and Eq. 10 divides the jump of the joint rates by "
        "the control period."
    )
    if free is not None:
        reason += (
            f" With W = I the velocity level peaks at {free.result.peak_torque:.0f} Nm "
            f"and takes {free.result.mean_power:.0f} W."
        )
    return Finding(
        "Fig. 5",
        "The reason is torque spikes from the numerical derivative of the constrained "
        "joint rates.",
        "on each motion, the velocity level has the larger peak torque and the larger "
        "change of torque from sample to sample",
        bool(holds),
        "velocity against acceleration level: " + "; ".join(cells),
        reason,
    )


def _damping(data: Data) -> list[Finding]:
    """Of the sweep on the dance, and of the variant on all motions."""
    plan = data.plan

    def point(level: str, constraints: str, value: float):
        return data.outcomes[plan.damping[level, constraints, value]].result

    def sweep(level: str, constraints: str) -> str:
        return "; ".join(
            f"λ = {value:g}: {_mm(p.rms_task_error)}, {p.mean_power:.0f} W"
            for value in plan.damping_factors
            for p in [point(level, constraints, value)]
        )

    def tolerated(level: str) -> list[float]:
        most = TOLERATED_POWER * point(level, "paper", PAPER_DAMPING).mean_power
        return [
            value
            for value in plan.damping_factors
            if value <= PAPER_DAMPING
            and point(level, "paper", value).mean_power <= most
        ]

    lowest = {level: min(tolerated(level)) for level in LEVELS}
    best = min(
        point("acceleration", "paper", value).rms_task_error
        for value in tolerated("acceleration")
    )
    gain = best / point("acceleration", "paper", PAPER_DAMPING).rms_task_error
    smallest = min(plan.damping_factors)
    free = {level: point(level, "none", smallest) for level in LEVELS}
    swept = Finding(
        "Section IV, on Fig. 4",
        "The acceleration level tolerates a smaller damping factor, with a lower task "
        "error.",
        f"on the dance, power stays within {TOLERATED_POWER:g} times that at "
        f"λ = {PAPER_DAMPING:g} down to a smaller λ than at the velocity level, and "
        "the error falls on the way",
        lowest["acceleration"] < lowest["velocity"] and gain < 1.0,
        "; ".join(f"tolerated at the {LABELS[v]}: λ ≥ {lowest[v]:g}" for v in LEVELS)
        + f". Acceleration level: {sweep('acceleration', 'paper')}. "
        f"Velocity level: {sweep('velocity', 'paper')}",
        f"With W = I and λ = {smallest:g} the error is "
        + ", ".join(
            f"{_mm(free[v].rms_task_error)} at {free[v].mean_power:.0f} W ({LABELS[v]})"
            for v in LEVELS
        )
        + (
            ". So it is W that limits λ, at both levels: it takes joints away near "
            "constraints, which leaves the Jacobian nearly singular, and there the "
            "inverse of Eq. 34 amplifies by up to 1/(2λ)."
            if all(
                free[v].mean_power
                < TOLERATED_POWER * point(v, "paper", PAPER_DAMPING).mean_power
                for v in LEVELS
            )
            else "."
        ),
    )
    ratios = data.ratios(
        "rms_task_error", (EXPERIMENT_1, "less-damping"), (EXPERIMENT_1, "acceleration")
    )
    power = data.ratios(
        "mean_power", (EXPERIMENT_1, "less-damping"), (EXPERIMENT_1, "acceleration")
    )
    variant = Finding(
        "Section IV, on Fig. 4",
        "A reduced damping factor improves the task error of the acceleration level "
        f"({LABELS['less-damping']}).",
        "on each motion, the error is lower than at λ = 0.1",
        all(r < 1.0 for r in ratios.values()),
        f"error {_percent(ratios)}; power {_percent(power)}",
        " ".join(
            f"{clip_label(m)}: rms error {_mm(d.error_in_violation)} in violation "
            f"({_share(d.violated_share)} of the samples), {_mm(d.error_otherwise)} "
            f"elsewhere; at λ = 0.1 {_mm(b.error_in_violation)} "
            f"({_share(b.violated_share)}) and {_mm(b.error_otherwise)}."
            for m in _failing(ratios, lambda r: r < 1.0)
            for d in [data.of(m, EXPERIMENT_1, "less-damping").details]
            for b in [data.of(m, EXPERIMENT_1, "acceleration").details]
        ),
    )
    return [swept, variant]


def _error_between_experiments(data: Data) -> Finding:
    ratios = {
        level: data.ratios(
            "rms_task_error", (EXPERIMENT_2, level), (EXPERIMENT_1, level)
        )
        for level in LEVELS
    }
    return Finding(
        "Fig. 6",
        "The task error is larger in Experiment 2, which is over-constrained.",
        "on each motion and at each level, it is",
        all(r > 1.0 for by_motion in ratios.values() for r in by_motion.values()),
        "against Experiment 1: "
        + "; ".join(f"{LABELS[v]} {_percent(ratios[v])}" for v in LEVELS),
        " ".join(
            f"{clip_label(m)}, {LABELS[v]}: {_share(d.squared_error_in_violation)} of "
            f"the squared error of Experiment 1 comes from the "
            f"{_share(d.violated_share)} of the samples in violation "
            f"(rms {_mm(d.error_in_violation)}); elsewhere it is "
            f"{_mm(d.error_otherwise)}, in Experiment 2 "
            f"{_mm(data.of(m, EXPERIMENT_2, v).result.rms_task_error)}."
            for v in LEVELS
            for m in _failing(ratios[v], lambda r: r > 1.0)
            for d in [data.of(m, EXPERIMENT_1, v).details]
        ),
    )


def _power_between_experiments(data: Data) -> Finding:
    ratios = {
        level: data.ratios("mean_power", (EXPERIMENT_2, level), (EXPERIMENT_1, level))
        for level in LEVELS
    }
    less = {
        level: _failing(by_motion, lambda r: r < 1.0 - SIGNIFICANT)
        for level, by_motion in ratios.items()
    }
    return Finding(
        "Fig. 7",
        "Much less power is taken in Experiment 2: it follows the human's own motion.",
        "on each motion and at each level, at least a quarter less",
        not any(less.values()),
        "against Experiment 1: "
        + "; ".join(f"{LABELS[v]} {_percent(ratios[v])}" for v in LEVELS),
        " ".join(
            f"{clip_label(m)}, {LABELS[v]}: "
            f"{_share(data.of(m, EXPERIMENT_2, v).details.power_of_peaks)} of the "
            "energy of Experiment 2 is in the 1 % of samples with most power, in "
            f"{_share(data.of(m, EXPERIMENT_2, v).details.spikes_at_jumps)} of its "
            "spikes W has just jumped."
            for v in LEVELS
            for m in less[v]
        ),
    )


def _power_alike_between_levels(data: Data) -> Finding:
    over, under = (EXPERIMENT_2, "acceleration"), (EXPERIMENT_2, "velocity")
    ratios = data.ratios("mean_power", over, under)
    return Finding(
        "Fig. 7",
        "The power of Experiment 2 differs little between the levels, and is slightly "
        "lower at the acceleration level.",
        "on each motion, lower by less than a quarter of the velocity level's",
        all(1.0 - SIGNIFICANT < r <= 1.0 for r in ratios.values()),
        f"acceleration against velocity level: {_percent(ratios)}",
        " ".join(
            f"{clip_label(m)}: the 1 % of samples with most power have "
            f"{_share(data.of(m, *under).details.power_of_peaks)} of the energy at "
            "the velocity level, "
            f"{_share(data.of(m, *over).details.power_of_peaks)} at the acceleration "
            "level."
            for m in _failing(ratios, lambda r: _alike({"": r}))
        ),
    )


def _inertia(data: Data) -> Finding:
    over, under = (EXPERIMENT_1, "inertia"), (EXPERIMENT_1, "acceleration")
    power = data.ratios("mean_power", over, under)
    error = data.ratios("rms_task_error", over, under)
    return Finding(
        "Section IV, on Fig. 7",
        "A dynamically consistent weight improves the energetics of Experiment 1.",
        "on each motion, less power than with the paper's W",
        all(r < 1.0 for r in power.values()),
        f"power {_percent(power)}; error {_percent(error)}",
    )


def _share(value: float) -> str:
    text = f"{100 * value:.0f} %"
    return "<1 %" if 0.0 < value < 0.005 else text


def _watt(value: float) -> str:
    return f"{value:.0f} W" if np.isfinite(value) else "–"


def _mm(value: float) -> str:
    return f"{1e3 * value:.1f} mm" if np.isfinite(value) else "–"
