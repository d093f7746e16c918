"""What breaks the lookahead's assumptions, by how much, and what helps against it.

python -m benchmarks.faults [--motion M ...] [--period P] [--preview S]
    [--page docs/measurements/faults.md]
python -m benchmarks.faults --tracking-error E [--tracking-error E ...] [--motion M ...]

The latter is of the filter of joint commands, and a robot that follows them with an
error: `benchmarks.filter_faults`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.fault_cases import Fault, Judged, Moment, find_moment
from benchmarks.filter_faults import filter_table, run_filter_faults
from benchmarks.options import (
    add_preview_option,
    defaults_or_preview,
    lookahead_defaults,
)
from benchmarks.page import Benchmark, Table, run
from crar_drake.commands.options import positive
from crar_drake.errors import InputError
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import LookaheadParameters, with_constraints
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.run import FAILURES, RunResult, run_scenario
from crar_drake.simulation.disturbances import Disturbances, TargetJump
from crar_drake.simulation.scenario import Scenario

# How long each motion runs [s]: until after the first fast stretch in which hands
# come near the body. Other motions run whole.
DURATIONS = {"dance": 5.3, "boxing": 4.9}
PERIOD = 5e-3  # [s] quick to run, and the harder one: the torque is held longer
_JUMP_DURATION = 0.5  # [s]


@dataclass(frozen=True)
class Remedy:
    """What a user can set against a fault.

    Attributes:
        name: of the settings.
        settings: field of `LookaheadParameters` to its value.
        period: of the controller [s]; None to leave it.
    """

    name: str
    settings: dict[str, float] = field(default_factory=dict)
    period: float | None = None


@dataclass(frozen=True)
class Outcome(Judged):
    """A run of the law under a fault.

    Attributes:
        remedy: against it.
        largest_excess: of a joint beyond its limit [rad].
        peak_torque: of a controlled joint [Nm].
        rms_acceleration: commanded, of the controlled joints [rad/s^2].
    """

    remedy: Remedy
    largest_excess: float = np.inf
    peak_torque: float = np.inf
    rms_acceleration: float = np.inf


NO_FAULT = Fault("none", "–")
DEFAULTS = Remedy("")
_WIDER = {"margin": 0.02, "limit_margin": 0.05}
# Each is tried on a run with a violation.
REMEDIES = (
    Remedy("d_min 20 mm, limits 0.05 rad", _WIDER),
    Remedy("the same and T 1/20 s", _WIDER | {"braking_time": 1 / 20}),
    Remedy("the same and T 1/60 s", _WIDER | {"braking_time": 1 / 60}),
    Remedy("control period 1 ms", period=1e-3),
)


def make_faults(moment: Moment) -> list[Fault]:
    """The faults of the table; pushes and jumps come when it matters."""
    model, state = "exact model", "exact state"
    faults = [
        Fault(f"masses, inertias {scale - 1.0:+.0%}", model, Disturbances(scale))
        for scale in (0.8, 1.2)
    ]
    faults += [
        Fault(
            f"noise {1e3 * q:g} mrad, {v:g} rad/s{at}",
            state,
            Disturbances(position_noise=q, velocity_noise=v),
            period,
        )
        # A shorter period gives a difference of noisy velocities more weight.
        for q, v, at, period in (
            (1e-4, 0.01, "", None),
            (1e-3, 0.05, "", None),
            (1e-3, 0.05, ", at 1 ms", 1e-3),
        )
    ]
    faults += [
        Fault(
            f"state {late} late, {1e3 * period:g} ms",
            state,
            Disturbances(delay_periods=delay),
            period,
        )
        for period in (1e-3, 5e-3)
        for delay, late in enumerate(("one period", "two periods", "three periods"), 1)
    ]
    faults += [
        Fault(
            f"state {1e3 * delay * PERIOD:g} ms late, told{and_masses}",
            f"{state}{', exact model' if scale != 1.0 else ''}",
            Disturbances(scale, delay_periods=delay),
            PERIOD,
            delay * PERIOD,
        )
        for delay in (3, 6)
        for scale, and_masses in ((1.0, ""), (1.2, ", masses +20%"))
    ]
    pushes = moment.pushes("segment", (0.0, -0.1, -0.1))
    faults += [
        Fault(name, "no force from outside", Disturbances(pushes=[push]))
        for name, push in pushes.items()
    ]
    faults += [
        Fault(
            f"targets 1 m {direction}",
            "smooth targets",
            Disturbances(
                target_jump=TargetJump(
                    offset, max(moment.time - 0.25, 0.0), _JUMP_DURATION
                )
            ),
        )
        for direction, offset in (
            ("forward", [1.0, 0.0, 0.0]),
            ("backward", [-1.0, 0.0, 0.0]),
        )
    ]
    return faults


def base_scenario(
    motion: str,
    experiment: str,
    period: float = PERIOD,
    preview: float | None = None,
) -> Scenario:
    """A motion under the lookahead's defaults, every step of the plant logged.

    With another preview [s], if one is given.
    """
    scenario = Scenario(
        motion=motion,
        experiment=experiment,
        controller=lookahead_defaults(preview, period=period),
        duration=DURATIONS.get(motion),
    )
    return replace(scenario, log_period=scenario.plant_config.time_step)


def under(scenario: Scenario, fault: Fault, remedy: Remedy = DEFAULTS) -> Scenario:
    """The scenario with a fault, and with what is set against it."""
    controller = replace(
        scenario.controller,
        period=remedy.period or fault.period or scenario.controller.period,
        latency=fault.latency,
        **remedy.settings,
    )
    return replace(scenario, controller=controller, disturbances=fault.disturbances)


def judge(run: RunResult, fault: Fault, remedy: Remedy, where: str) -> Outcome:
    """What the referee says of the true states of a run."""
    model, summary = run.setup.model, run.summary
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    verdict = referee.violations(run.log.q)
    return Outcome(
        *(fault, where, verdict, remedy, verdict.largest_limit_excess),
        *(summary.peak_torque, summary.rms_acceleration),
    )


def run_fault(
    scenario: Scenario, fault: Fault, remedies: Sequence[Remedy] = REMEDIES
) -> list[Outcome]:
    """The fault alone, and if it violates, with each remedy.

    Args:
        scenario: from `base_scenario`.
        fault: what to put into it.
        remedies: what to set against it.
    """
    where = f"{scenario.motion} {scenario.experiment}"
    outcomes: list[Outcome] = []
    for remedy in (DEFAULTS, *remedies):
        try:
            run = run_scenario(under(scenario, fault, remedy), record=False)
        except (InputError, *FAILURES):
            # The state is not finite any more: the loop is unstable.
            outcome = Outcome(fault, where, None, remedy)
        else:
            outcome = judge(run, fault, remedy, where)
        outcomes.append(outcome)
        if not outcomes[0].violated:
            break
    return outcomes


def run_all(
    motions: Sequence[str],
    experiments: Sequence[str] = EXPERIMENTS,
    period: float = PERIOD,
    preview: float | None = None,
) -> list[Outcome]:
    """Every fault on every motion and experiment; prints each run.

    Args:
        motions: names of motions.
        experiments: task sets.
        period: of the controller, where a fault has none of its own [s].
        preview: of the lookahead [s]; None for its own, 0 for none.
    """
    outcomes: list[Outcome] = []

    def add(more: list[Outcome]) -> None:
        outcomes.extend(more)
        for o in more:
            what = ", ".join(filter(None, (o.fault.name, o.remedy.name)))
            print(f"{o.where}: {what}: {o.violated} violations", flush=True)

    for motion in motions:
        for experiment in experiments:
            scenario = base_scenario(motion, experiment, period, preview)
            nominal = run_scenario(scenario, record=False)
            where = f"{motion} {experiment}"
            add([judge(nominal, NO_FAULT, DEFAULTS, where)])
            for fault in make_faults(find_moment(nominal)):
                add(run_fault(scenario, fault))
    return outcomes


def make_tables(outcomes: Sequence[Outcome]) -> list[Table]:
    """Each fault over all runs; and each run in violation, if there are such.

    The first table's figures are the worst of the fault's runs with the defaults.
    """
    plain = [o for o in outcomes if o.remedy is DEFAULTS]
    rows = []
    for name in dict.fromkeys(o.fault.name for o in plain):
        runs = [o for o in plain if o.fault.name == name]
        nearest = min(runs, key=lambda o: o.smallest_distance)
        rows.append(
            [
                name,
                runs[0].fault.assumption,
                f"{sum(o.violated > 0 for o in runs)} of {len(runs)}",
                f"{sum(o.violated for o in runs)} of {sum(o.samples for o in runs)}",
                f"{_distance(nearest.smallest_distance)} ({nearest.where})",
                *_figures(runs),
            ]
        )
    figures = [
        "smallest distance",
        "largest limit excess",
        "peak torque",
        "rms acceleration",
    ]
    whole = ["fault", "assumption broken", "runs in violation", "samples", *figures]
    table = Table(whole, rows)
    violated = {(o.fault.name, o.where) for o in plain if o.violated}
    if not violated:
        return [table]
    details = [
        [
            o.fault.name,
            o.where,
            o.remedy.name or "defaults",
            f"{o.violated} of {o.samples}",
            _distance(o.smallest_distance),
            *_figures([o]),
        ]
        for o in outcomes
        if (o.fault.name, o.where) in violated
    ]
    header = ["fault", "run", "settings", "samples in violation", *figures]
    return [table, Table(header, details)]


def _figures(runs: Sequence[Outcome]) -> list[str]:
    """The worst of some runs, but for distances."""
    excess = max(o.largest_excess for o in runs)
    return [
        f"{np.rad2deg(excess):.2f}°" if excess > 0.0 else "none",
        f"{max(o.peak_torque for o in runs):.0f} Nm",
        f"{max(o.rms_acceleration for o in runs):.0f} rad/s²",
    ]


def _distance(distance: float) -> str:
    return f"{1e3 * distance:.1f} mm" if np.isfinite(distance) else "diverges"


def tracking_tables(motions: Sequence[str], errors: Sequence[float]) -> list[Table]:
    """Of each stated tracking error [rad]: every fault on some motions."""
    runs, moments = {}, {}
    for motion in motions:
        scenario = base_scenario(motion, "upper-body")
        controller = with_constraints(scenario.controller, "none")
        found = run_scenario(replace(scenario, controller=controller), record=False)
        runs[motion], moments[motion] = found, find_moment(found)
    floor = LookaheadParameters().safety_distance
    return [
        filter_table(run_filter_faults(error, runs, moments), error, floor)
        for error in errors
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Runs all faults on dance and boxing, in both experiments."""
    benchmark = Benchmark("benchmarks.faults", __doc__, "faults")
    parser = benchmark.parser
    parser.add_argument(
        "--motion", action="append", help="may be repeated; default dance and boxing"
    )
    parser.add_argument("--period", type=float, default=PERIOD, help="control period")
    add_preview_option(parser)
    parser.add_argument(
        "--tracking-error",
        type=positive,
        action="append",
        metavar="E",
        help="the filter with this stated error of joints [rad]; may be repeated",
    )
    arguments = benchmark.parse(
        argv, lambda a: "tracking" if a.tracking_error else defaults_or_preview(a)
    )
    if arguments.tracking_error:
        motions = arguments.motion or ("dance", "boxing")
        benchmark.report(tracking_tables(motions, arguments.tracking_error))
        return
    outcomes = run_all(
        arguments.motion or ("dance", "boxing"),
        period=arguments.period,
        preview=arguments.preview,
    )
    tables = make_tables(outcomes)
    benchmark.report(tables, "" if tables[1:] else "No run is in violation.")


if __name__ == "__main__":
    run(main)
