"""The paper's findings, each tested on the data of a reproduction.

A finding holds if its criterion does for every motion; the criteria are fixed here,
before any data. "Significant" is a quarter: bars that differ by less look alike.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.section_iv.figures import violation_counts
from benchmarks.section_iv.plan import EXPERIMENT_1, EXPERIMENT_2, LABELS, REDUNDANCY
from benchmarks.section_iv.simulate import Outcomes
from benchmarks.sweep.cases import Result, clip_label
from crar_drake.law.parameters import LEVELS
from crar_drake.results.log import SimulationLog

SIGNIFICANT = 0.25
# A damping factor is tolerated up to this multiple of the power at the paper's.
TOLERATED_POWER = 2.0
PAPER_DAMPING = 0.1  # lambda of Section IV [m]

Ratios = Mapping[str, float]  # by motion, of a figure in two simulations


@dataclass(frozen=True)
class Finding:
    """A statement of the paper and what became of it.

    Attributes:
        source: where the paper makes it.
        statement: in our words.
        criterion: what must be true of the data.
        holds: whether it is.
        figures: the data that decide it.
    """

    source: str
    statement: str
    criterion: str
    holds: bool
    figures: str

    @property
    def verdict(self) -> str:
        """As the report prints it."""
        return "holds" if self.holds else "does not hold"


def check_findings(
    data: Outcomes, log: Callable[[str, str], SimulationLog]
) -> list[Finding]:
    """Tests every finding, in the paper's order.

    Args:
        data: of the reproduction; every simulation succeeded.
        log: loads the dance's log of an experiment and a series.
    """
    less = "on each motion, it does", lambda r: r < 1.0
    alike = (
        "on each motion, neither level's error is a quarter more than the other's",
        lambda r: max(r, 1.0 / r) < 1.0 + SIGNIFICANT,
    )
    return [
        _many_violations(log(EXPERIMENT_1, "raw")),
        *_distances(data),
        *_satisfied(data),
        _between_levels(
            data,
            *("Fig. 4", EXPERIMENT_1, "rms_task_error"),
            "The task error of Experiment 1 does not differ significantly between the "
            "levels.",
            *alike,
        ),
        _between_levels(
            data,
            *("Fig. 5", EXPERIMENT_1, "mean_power"),
            "In Experiment 1 the acceleration level takes less power.",
            *less,
        ),
        _spikes(data),
        *_damping(data),
        _between_experiments(
            data,
            *("Fig. 6", "rms_task_error"),
            "The task error is larger in Experiment 2, which is over-constrained.",
            "on each motion and at each level, it is",
            lambda r: r > 1.0,
        ),
        _between_experiments(
            data,
            *("Fig. 7", "mean_power"),
            "Much less power is taken in Experiment 2: it follows the human's own "
            "motion.",
            "on each motion and at each level, at least a quarter less",
            lambda r: r < 1.0 - SIGNIFICANT,
        ),
        _between_levels(
            data,
            *("Fig. 6", EXPERIMENT_2, "rms_task_error"),
            "The task error of Experiment 2 does not differ significantly between the "
            "levels.",
            *alike,
        ),
        _between_levels(
            data,
            *("Fig. 7", EXPERIMENT_2, "mean_power"),
            "The power of Experiment 2 differs little between the levels, and is "
            "slightly lower at the acceleration level.",
            "on each motion, lower by less than a quarter of the velocity level's",
            lambda r: 1.0 - SIGNIFICANT < r <= 1.0,
        ),
        _inertia(data),
    ]


def _ratios(
    data: Outcomes, field: str, over: tuple[str, str], under: tuple[str, str]
) -> Ratios:
    """Of a field in two (experiment, series)."""
    return {
        motion: getattr(data.of(motion, *over).result, field)
        / getattr(data.of(motion, *under).result, field)
        for motion in data.plan.motions
    }


def _percent(ratios: Ratios) -> str:
    return ", ".join(
        f"{clip_label(m)} {100 * (r - 1):+.0f} %" for m, r in ratios.items()
    )


def _between_levels(
    data: Outcomes,
    source: str,
    experiment: str,
    field: str,
    statement: str,
    criterion: str,
    good: Callable[[float], bool],
) -> Finding:
    """Of the acceleration level's figure over the velocity level's."""
    levels = (experiment, "acceleration"), (experiment, "velocity")
    ratios = _ratios(data, field, *levels)
    figures = f"acceleration against velocity level: {_percent(ratios)}"
    return Finding(
        source, statement, criterion, all(map(good, ratios.values())), figures
    )


def _between_experiments(
    data: Outcomes,
    source: str,
    field: str,
    statement: str,
    criterion: str,
    good: Callable[[float], bool],
) -> Finding:
    """Of Experiment 2's figure over that of Experiment 1, at both levels."""
    ratios = {
        level: _ratios(data, field, (EXPERIMENT_2, level), (EXPERIMENT_1, level))
        for level in LEVELS
    }
    figures = "; ".join(f"{LABELS[v]} {_percent(ratios[v])}" for v in LEVELS)
    holds = all(good(r) for each in ratios.values() for r in each.values())
    return Finding(
        source, statement, criterion, holds, f"against Experiment 1: {figures}"
    )


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


def _distances(data: Outcomes) -> list[Finding]:
    """Of the dance in Experiment 2, at each level."""
    results = {
        level: data.of(data.plan.dance, EXPERIMENT_2, level).result for level in LEVELS
    }
    return [
        Finding(
            "Fig. 3",
            "The distances of all thirty pairs stay positive over the dance in "
            f"Experiment 2 ({LABELS[level]}; the paper does not say which).",
            "no pair is at d < 0 in any sample",
            r.penetrating == 0,
            f"smallest distance {_mm(r.smallest_distance)}, {r.smallest_pair}",
        )
        for level, r in results.items()
    ]


def _satisfied(data: Outcomes) -> list[Finding]:
    """Of all motions in both experiments, at each level."""
    findings = []
    for level in LEVELS:
        results = [
            data.of(motion, experiment, level).result
            for motion in data.plan.motions
            for experiment in (EXPERIMENT_1, EXPERIMENT_2)
        ]
        beyond = sum(r.beyond_limit for r in results) / sum(r.samples for r in results)
        worst = max(results, key=lambda r: np.nan_to_num(r.largest_excess))
        distances = ", ".join(
            f"{clip_label(r.motion)} {r.experiment} {_mm(r.smallest_distance)}"
            for r in results
        )
        findings.append(
            Finding(
                "Section V",
                f"Constraints are satisfied, whatever the motion ({LABELS[level]}).",
                "no sample of any motion has a penetrating pair, or a joint beyond "
                "its limit",
                not any(r.penetrating or r.beyond_limit for r in results),
                f"{_share(beyond)} of the samples have a joint beyond its limit, "
                f"{np.degrees(worst.largest_excess):.1f}° at worst; smallest distances "
                f"{distances}",
            )
        )
    return findings


def _spikes(data: Outcomes) -> Finding:
    cells, holds = [], True
    for motion in data.plan.motions:
        v, a = (data.of(motion, EXPERIMENT_1, level) for level in LEVELS)
        holds &= v.result.peak_torque > a.result.peak_torque
        holds &= v.rms_torque_step > a.rms_torque_step
        cells.append(
            f"{clip_label(motion)} peak {v.result.peak_torque:.0f} against "
            f"{a.result.peak_torque:.0f} Nm, rms change a sample "
            f"{v.rms_torque_step:.1f} against {a.rms_torque_step:.1f} Nm"
        )
    return Finding(
        "Fig. 5",
        "The reason is torque spikes from the numerical derivative of the constrained "
        "joint rates.",
        "on each motion, the velocity level has the larger peak torque and the larger "
        "change of torque from sample to sample",
        bool(holds),
        "velocity against acceleration level: " + "; ".join(cells),
    )


def _damping(data: Outcomes) -> list[Finding]:
    """Of the sweep on the dance, and of the variant on all motions."""
    factors = data.plan.damping_factors

    def point(level: str, value: float) -> Result:
        return data.damped(level, "paper", value)

    def sweep(level: str) -> str:
        return "; ".join(
            f"λ = {value:g}: {_mm(p.rms_task_error)}, {p.mean_power:.0f} W"
            for value in factors
            for p in [point(level, value)]
        )

    def tolerated(level: str) -> list[float]:
        most = TOLERATED_POWER * point(level, PAPER_DAMPING).mean_power
        smaller = [value for value in factors if value <= PAPER_DAMPING]
        return [v for v in smaller if point(level, v).mean_power <= most]

    lowest = {level: min(tolerated(level)) for level in LEVELS}
    best = min(
        point("acceleration", value).rms_task_error
        for value in tolerated("acceleration")
    )
    gains = best < point("acceleration", PAPER_DAMPING).rms_task_error
    free = {level: data.damped(level, "none", min(factors)) for level in LEVELS}
    swept = Finding(
        "Section IV, on Fig. 4",
        "The acceleration level tolerates a smaller damping factor, with a lower task "
        "error.",
        f"on the dance, power stays within {TOLERATED_POWER:g} times that at "
        f"λ = {PAPER_DAMPING:g} down to a smaller λ than at the velocity level, and "
        "the error falls on the way",
        lowest["acceleration"] < lowest["velocity"] and gains,
        "; ".join(f"tolerated at the {LABELS[v]}: λ ≥ {lowest[v]:g}" for v in LEVELS)
        + f". Acceleration level: {sweep('acceleration')}. "
        f"Velocity level: {sweep('velocity')}. With W = I and λ = {min(factors):g} the "
        "error is "
        + ", ".join(
            f"{_mm(free[v].rms_task_error)} at {free[v].mean_power:.0f} W ({LABELS[v]})"
            for v in LEVELS
        ),
    )
    of = (EXPERIMENT_1, "less-damping"), (EXPERIMENT_1, "acceleration")
    error, power = (_ratios(data, f, *of) for f in ("rms_task_error", "mean_power"))
    variant = Finding(
        "Section IV, on Fig. 4",
        "A reduced damping factor improves the task error of the acceleration level "
        f"({LABELS['less-damping']}).",
        "on each motion, the error is lower than at λ = 0.1",
        all(r < 1.0 for r in error.values()),
        f"error {_percent(error)}; power {_percent(power)}",
    )
    return [swept, variant]


def _inertia(data: Outcomes) -> Finding:
    of = (EXPERIMENT_1, "inertia"), (EXPERIMENT_1, "acceleration")
    error, power = (_ratios(data, f, *of) for f in ("rms_task_error", "mean_power"))
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


def _mm(value: float) -> str:
    return f"{1e3 * value:.1f} mm" if np.isfinite(value) else "–"
