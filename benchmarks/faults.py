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
from pydrake.multibody.tree import JacobianWrtVariable

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
from crar_drake.simulation.disturbances import Disturbances, Push, TargetJump
from crar_drake.simulation.scenario import Scenario

# How long each motion runs [s]: until after the first fast stretch in which hands
# come near the body. Other motions run whole.
DURATIONS = {"dance": 5.3, "boxing": 4.9}
PERIOD = 5e-3  # [s] quick to run, and the harder one: the torque is held longer
_PUSH_DURATION = 0.2  # [s]
_JUMP_DURATION = 0.5  # [s]


@dataclass(frozen=True)
class Fault:
    """A way in which the simulated robot differs from what the controller believes.

    Attributes:
        name: of the table's row.
        assumption: that it breaks.
        disturbances: it.
        period: of the controller [s]; None for the one of the whole table.
        latency: that the controller is told of [s].
    """

    name: str
    assumption: str
    disturbances: Disturbances = field(default_factory=Disturbances)
    period: float | None = None
    latency: float = 0.0


@dataclass(frozen=True)
class Moment:
    """When and where the robot without a fault came nearest to itself.

    Attributes:
        time: [s].
        hand: link that a push acts on.
        towards: (3,) direction in which it comes nearer, in W.
    """

    time: float
    hand: str
    towards: np.ndarray


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
class Outcome:
    """A run under a fault, judged by the referee on the true state.

    Attributes:
        fault, assumption, remedy: names; no remedy for the defaults.
        where: motion and experiment.
        violated: samples with a violation, of
        samples: all, one per step of the plant.
        smallest_distance: over pairs and samples [m].
        largest_excess: of a joint beyond its limit [rad].
        peak_torque: of a controlled joint [Nm].
        rms_acceleration: commanded, of the controlled joints [rad/s^2].
    """

    fault: str
    assumption: str
    remedy: str
    where: str
    violated: int
    samples: int
    smallest_distance: float
    largest_excess: float
    peak_torque: float
    rms_acceleration: float


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
    up = np.array([0.0, 0.0, 1.0])
    sideways = np.cross(moment.towards, up)
    pushes = [
        ("towards the nearest segment", moment.towards, 0.0),
        ("sideways", sideways / max(np.linalg.norm(sideways), 1e-9), -0.1),
        ("up", up, -0.1),
    ]
    faults += [
        Fault(
            f"50 N on a hand, {direction}",
            "no force from outside",
            Disturbances(
                pushes=[
                    Push(
                        moment.hand,
                        (50.0 * unit).tolist(),
                        max(moment.time + since, 0.0),
                        _PUSH_DURATION,
                    )
                ]
            ),
        )
        for direction, unit, since in pushes
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


def find_moment(run: RunResult, settled: float = 1.0) -> Moment:
    """When a hand of this run came nearest to something, from `settled` [s] on.

    The direction is that of the force on the hand that brings it nearer: the one
    whose share J^T f of the joints is most like the distance's negative gradient.
    """
    model, log = run.setup.model, run.log
    hands = [_hand_of(str(name)) for name in log.pair_names]
    distances = np.where([bool(h) for h in hands], log.signed_distances, np.inf)
    distances[log.time < settled] = np.inf
    # After a push there must be time to see what it did.
    distances[log.time > log.time[-1] - _PUSH_DURATION - 0.1] = np.inf
    sample, pair = np.unravel_index(distances.argmin(), distances.shape)
    q, hand = log.q[sample], hands[pair]
    gradient = model.evaluate(
        model.MakeWorkspace(), q, np.zeros(len(model.order))
    ).dd_dq[pair]
    J = hand_jacobian(run, q, hand)
    towards = -np.linalg.lstsq(J.T, gradient, rcond=None)[0]
    return Moment(
        float(log.time[sample]), hand, towards / max(np.linalg.norm(towards), 1e-9)
    )


def hand_jacobian(run: RunResult, q: np.ndarray, link: str) -> np.ndarray:
    """Translational Jacobian (3, n) of a link's origin by the controlled joints."""
    model = run.setup.model
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    W = plant.world_frame()
    J = plant.CalcJacobianTranslationalVelocity(
        context,
        JacobianWrtVariable.kV,
        plant.GetFrameByName(link),
        np.zeros(3),
        W,
        W,
    )
    return J[:, model.controlled]


def _hand_of(pair: str) -> str:
    """The first hand in a pair's name; "" if there is none."""
    return next((link for link in pair.split(" - ") if link.endswith("hand")), "")


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
    model = run.setup.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    verdict = referee.violations(run.log.q)
    return Outcome(
        fault=fault.name,
        assumption=fault.assumption,
        remedy=remedy.name,
        where=where,
        violated=verdict.num_violated,
        samples=verdict.num_samples,
        smallest_distance=verdict.smallest_distance,
        largest_excess=verdict.largest_limit_excess,
        peak_torque=run.summary.peak_torque,
        rms_acceleration=run.summary.rms_acceleration,
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
            names, infinite = (fault.name, fault.assumption, remedy.name), np.inf
            outcome = Outcome(*names, where, 1, 1, -infinite, *[infinite] * 3)
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
            what = f"{o.fault}, {o.remedy}" if o.remedy else o.fault
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
    plain = [o for o in outcomes if not o.remedy]
    names = list(dict.fromkeys(o.fault for o in plain))
    rows = []
    for name in names:
        runs = [o for o in plain if o.fault == name]
        nearest = min(runs, key=lambda o: o.smallest_distance)
        rows.append(
            [
                name,
                runs[0].assumption,
                f"{sum(o.violated > 0 for o in runs)} of {len(runs)}",
                f"{sum(o.violated for o in runs)} of {sum(o.samples for o in runs)}",
                f"{_distance(nearest.smallest_distance)} ({nearest.where})",
                _excess(max(o.largest_excess for o in runs)),
                f"{max(o.peak_torque for o in runs):.0f} Nm",
                f"{max(o.rms_acceleration for o in runs):.0f} rad/s²",
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
    violated = {(o.fault, o.where) for o in plain if o.violated}
    if not violated:
        return [table]
    details = [
        [
            o.fault,
            o.where,
            o.remedy or "defaults",
            f"{o.violated} of {o.samples}",
            _distance(o.smallest_distance),
            _excess(o.largest_excess),
            f"{o.peak_torque:.0f} Nm",
            f"{o.rms_acceleration:.0f} rad/s²",
        ]
        for o in outcomes
        if (o.fault, o.where) in violated
    ]
    header = ["fault", "run", "settings", "samples in violation", *figures]
    return [table, Table(header, details)]


def _distance(distance: float) -> str:
    return f"{1e3 * distance:.1f} mm" if np.isfinite(distance) else "diverges"


def _excess(angle: float) -> str:
    return f"{np.rad2deg(angle):.2f}°" if angle > 0.0 else "none"


def tracking_tables(motions: Sequence[str], errors: Sequence[float]) -> list[Table]:
    """Of each stated tracking error [rad]: every fault on some motions."""
    runs, moments = {}, {}
    for motion in motions:
        scenario = base_scenario(motion, "upper-body")
        controller = with_constraints(scenario.controller, "none")
        found = run_scenario(replace(scenario, controller=controller), record=False)
        moment = find_moment(found)
        runs[motion] = found
        moments[motion] = moment.time, moment.hand, moment.towards
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
