"""Wrist targets of a robot that stands: our law, PlaCo's dynamics and TSID on the same.

    python -m benchmarks.peers.standing [--tune] [--seeds 3] [--page PAGE]

The law with balance and without, PlaCo's `DynamicsSolver` with planar contacts at both
feet and TSID with 6d contacts are given the same targets, from rest: two recordings,
and swings of three kinds. Each runs on its own command. PlaCo and TSID move legs and
pelvis, too; the law keeps them still, but for a row whose pelvis sways and squats.

The judge is the same for all and nothing of theirs: Drake's inverse dynamics of the
robot with a root that floats, at three instants of each step, and Drake's distances and
limits. `--tune` tries each one's grid on swings of other seeds first, and keeps what it
chose in `standing-settings.json`.
"""

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from pydrake.multibody.tree import MultibodyForces

from benchmarks.balance import INSTANTS, PERIOD, TRACKED, Soles, swings
from benchmarks.page import Benchmark, Table, run
from benchmarks.peers import robot_files
from benchmarks.peers.compare import (
    Entry,
    add_peer_options,
    drive,
    environment,
    job,
)
from benchmarks.peers.floating import after
from benchmarks.peers.peers import ENVIRONMENTS, Peer, every
from benchmarks.peers.problem import finite_or_none
from crar_drake.control.parameters import BalanceParameters
from crar_drake.errors import CrarError
from crar_drake.files import whole_file, write_whole
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import (
    GROUND,
    LIMIT_TOLERANCE,
    RobotDescription,
    find_body,
    find_frame,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.moving_pelvis import SLIDES, WholeCommand
from crar_drake.robot.soles import shrunk, sole_corners
from crar_drake.robot.standing import leg_joints, standing_description
from crar_drake.robot.task import position_tasks
from crar_drake.simulation.scenario import Pelvis
from crar_drake.targets.motion import load_motion_targets

SETTINGS = Path(__file__).parent / "standing-settings.json"
SAMPLE = 1e-3  # [s] of the targets
BEGIN = 1.0  # [s] over which targets leave the rest posture
SWING, MOTION = 4.0, 8.0  # [s] of a case
EVERY = 8  # steps apart, pairs are looked at: Drake's distances take the longest
WARM_UP = 20  # first steps of a run, not timed
MOTIONS = {"traffic 14_25": "cmu:14_25", "boxing 13_17": "cmu:13_17"}
# Widths [m] and frequencies [Hz] of swings; the last are those of `benchmarks.balance`.
SWINGS = {
    "gentle swings": ((0.03, 0.08), (0.2, 0.8)),
    "middling swings": ((0.08, 0.15), (0.3, 1.5)),
    "wild swings": ((0.15, 0.3), (0.5, 3.0)),
}
TUNING = ("middling swings", "wild swings")
# Rows besides: the law with a pelvis that sways, and without balance; TSID's step is
# short enough for another period; with its pelvis held it may do no more than the law.
VARIANTS = {
    "law": {
        "the pelvis sways": {"pelvis": True},
        "without balance": {"balance": False},
    },
    "TSID": {"1 ms": {"period": SAMPLE}, "pelvis held": {"held": 1e4}},
}
HEADER = (
    *("targets", "controller", "outside the soles: at steps, in all"),
    "farthest outside",
    *(
        "beyond friction",
        "pairs",
        "limits",
        "failed",
        "beyond motors",
        "rms error",
        "largest q̈",
    ),
    *("pelvis moves", "soles move", "step (p99)"),
)
TOLERANCE = 1e-4  # [m] outside the soles that a solver of a program may be
OFF = 2.0  # [m] of a root from its rest, beyond which a robot is not judged any more

LAW = {"horizon": (0.02, 0.05), "Kp": (900.0,), "damping": (0.02, 0.1)}
CONTROLLERS = (
    Peer(
        "law",
        "stand_crar",
        "",
        every(balance=(True,), inside=(0.0,), **LAW),
        python=True,
    ),
    Peer(
        "PlaCo, dynamics",
        "stand_placo",
        "placo",
        every(
            kp=(100.0, 400.0),
            com=(10.0, 100.0, 1000.0),
            posture=(1e-2,),
            inside=(0.0, 0.003),
            collisions=(True,),
        ),
        python=False,
    ),
    Peer(
        "TSID",
        "stand_tsid",
        "tsid",
        every(
            kp=(100.0, 400.0),
            com=(10.0, 100.0, 1000.0),
            posture=(1e-2,),
            inside=(0.0, 0.003),
        ),
        python=False,
    ),
)


@dataclass(frozen=True)
class Figures:
    """Of one run.

    Attributes:
        outside_at: share of the steps at whose begin the centre of pressure is outside
            the soles less the margin, or there is none.
        outside: the same share, of three instants of each step.
        farthest: outside [m]; infinite without a centre.
        slips: share of instants with a force beyond friction.
        pairs: share of samples with a watched pair in penetration.
        limits: share of samples with a joint beyond its limit.
        failed: share of steps without an answer.
        motors: share of steps in which a joint above the legs takes more torque than
            its motor has; what legs take depends on how both feet share a load.
        error: rms over time and wrists [m].
        acceleration: the largest of a joint [rad/s^2].
        pelvis: the farthest that it goes from its rest [m].
        soles: the farthest that a sole's corner goes [m].
        lost: share of samples after which the robot is off, not judged otherwise.
    """

    outside_at: float
    outside: float
    farthest: float
    slips: float
    pairs: float
    limits: float
    failed: float
    motors: float
    error: float
    acceleration: float
    pelvis: float
    soles: float
    lost: float

    @property
    def wrong(self) -> float:
        """What tuning is to be rid of first; TSID cannot keep pairs apart."""
        moved = float(self.soles > 0.005)
        return self.outside + self.slips + self.limits + self.failed + moved


class Judge:
    """The robot with a root that floats, as shipped, in Drake.

    Attributes:
        model: of it.
        home: (2, 3) where the wrists rest in the world [m].
        joints: names, in the order of all arrays.
    """

    def __init__(
        self,
        whole: RobotDescription,
        margins: BalanceParameters,
        tracked: Sequence[str] = TRACKED,
    ) -> None:
        tasks = position_tasks(tracked)
        self.whole = whole
        self.frames = [whole.task_frames[name] for name in tracked]
        standing = standing_description(whole)
        self.standing = ControlModel.FromDescription(standing, tasks, time_step=0.0)
        self.model = model = ControlModel.FromDescription(whole, tasks)
        corners = sole_corners(self.standing, standing.soles)
        self.margins = margins
        self.ground = Soles(corners, margins.margin)
        self._pairs = [pair for pair in whole.pairs if GROUND not in pair]
        self._referee = Referee(model.plant, model.scene_graph, self._pairs)
        self.joints = list(self.standing.position_names)
        positions, velocities = list(model.position_names), list(model.velocity_names)
        root = [n for n in positions if n not in self.joints]
        rates = [n for n in velocities if n not in self.joints]
        self._q_at = [positions.index(n) for n in (*root, *self.joints)]
        self._v_at = [velocities.index(n) for n in (*rates, *self.joints)]
        self._efforts = np.full(model.plant.num_velocities(), np.inf)
        legs = {joint.name() for joint in leg_joints(model.plant, whole)}
        for index in model.plant.GetJointActuatorIndices():
            actuator = model.plant.get_joint_actuator(index)
            joint = actuator.joint()
            if joint.name() not in legs:
                self._efforts[joint.velocity_start()] = actuator.effort_limit()
        self._context = model.plant.CreateDefaultContext()
        self._command: WholeCommand | None = None
        self.rest = model.rest_positions()[self._q_at]
        points, self._soles = self._places(self.rest[None])
        self.home = points[0]

    def figures(
        self,
        found: dict[str, np.ndarray],
        p: np.ndarray,
        every: int = EVERY,
        follow: Callable | None = None,
    ) -> Figures:
        """Judges what a driver recorded.

        Args:
            found: by the driver.
            p: (T, tasks, 3) targets at its times [m].
            every: so many steps apart, pairs are looked at; 0 for never.
            follow: makes of a state and accelerations those whose legs follow the root,
                where these are no accelerations that are held.
        """
        Q, V, A = found["q"], found["v"], found["a"]
        away = np.linalg.norm(Q[:, 4:7] - self.rest[4:7], axis=1)
        off = ~(away < OFF)
        on = int(np.argmax(off)) if off.any() else len(Q)
        period = found["time"][1] - found["time"][0]
        # The same instants of all, of a quicker loop too.
        some = slice(0, on, round(PERIOD / period))
        peak, failed = float(np.abs(A[:on, 6:]).max()), float(found["no_answer"].mean())
        Q, V, A, p = Q[some], V[some], A[some], p[some]
        shares = [share * period for share in INSTANTS]
        q = np.array([after(*x, t) for x in zip(Q, V, A, strict=True) for t in shares])
        v = np.array([v + t * a for v, a in zip(V, A, strict=True) for t in shares])
        a = np.repeat(A, len(shares), axis=0)
        if follow is not None:
            q, v, a = (np.array(x) for x in zip(*map(follow, q, v, a), strict=True))
            Q, V, A = (x[:: len(shares)] for x in (q, v, a))
        outside, slope = self.demand(q, v, a)
        whole = self._whole(Q)
        lower, upper = self._referee.lower, self._referee.upper
        beyond = np.maximum(lower - whole, whole - upper) > LIMIT_TOLERANCE
        beyond_count, pairs = beyond.sum(axis=1), 0.0
        if every:
            seen = self._referee.violations(whole[::every])
            pairs = float((seen.count > beyond_count[::every]).mean())
        points, soles = self._places(Q)
        moved = np.linalg.norm(soles - self._soles, axis=2)
        return Figures(
            outside_at=float((outside[:: len(shares)] > TOLERANCE).mean()),
            outside=float((outside > TOLERANCE).mean()),
            farthest=float(outside.max()),
            slips=float((~(slope <= self.margins.friction * (1.0 + 1e-3))).mean()),
            pairs=pairs,
            limits=float((beyond_count > 0).mean()),
            failed=failed,
            motors=float(self.too_weak(Q, V, A).mean()),
            error=float(np.sqrt(np.mean(np.sum((points - p) ** 2, axis=2)))),
            acceleration=peak,
            pelvis=float(away[:on].max()),
            soles=float(moved.max()),
            lost=float(off.mean()),
        )

    def legs_follow(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same with legs as they follow a pelvis in our law's command."""
        if self._command is None:
            description = standing_description(self.whole, Pelvis().box())
            names = [*SLIDES, *self.joints]
            self._command = WholeCommand(description.pelvis, names)
        at = q[4:] - np.append(self.rest[4:7], np.zeros(len(self.joints)))
        joints, _ = self._command(at, v[3:], a[3:])
        q_joints, v_joints, a_joints = joints[:, 3:]
        return (
            np.append(q[:7], q_joints),
            np.append(v[:6], v_joints),
            np.append(a[:6], a_joints),
        )

    def demand(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far (T,) centres of pressure are outside the soles less the margin [m],
        and (T,) the slope of the force."""
        plant = self.model.plant
        rates = np.zeros((2, len(q), plant.num_velocities()))
        rates[0][:, self._v_at], rates[1][:, self._v_at] = v, a
        return self.ground.demand(plant, self._whole(q), *rates)

    def too_weak(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(T,) whether a joint above the legs takes more torque than its motor has."""
        plant, found = self.model.plant, []
        external = MultibodyForces(plant)
        rates = np.zeros((2, len(q), plant.num_velocities()))
        rates[0][:, self._v_at], rates[1][:, self._v_at] = v, a
        for positions, speeds, accelerations in zip(
            self._whole(q), *rates, strict=True
        ):
            plant.SetPositions(self._context, positions)
            plant.SetVelocities(self._context, speeds)
            plant.CalcForceElementsContribution(self._context, external)
            torque = plant.CalcInverseDynamics(self._context, accelerations, external)
            found.append((np.abs(torque) > self._efforts * (1.0 + 1e-3)).any())
        return np.array(found)

    def _whole(self, q: np.ndarray) -> np.ndarray:
        whole = np.empty_like(q)
        whole[:, self._q_at] = q
        return whole

    def _places(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where (T, tasks, 3) task points and (T, corners, 3) soles are [m]."""
        plant, points, soles = self.model.plant, [], []
        frames = [find_frame(plant, frame) for frame in self.frames]
        for each in self._whole(q):
            plant.SetPositions(self._context, each)
            points.append(
                [f.CalcPoseInWorld(self._context).translation() for f in frames]
            )
            soles.append(
                [
                    plant.EvalBodyPoseInWorld(
                        self._context, find_body(plant, link)
                    ).multiply(np.array(corner, dtype=float))
                    for link, corners in self.whole.soles.items()
                    for corner in corners
                ]
            )
        return np.array(points), np.array(soles)


def write_robot(folder: Path, judge: Judge) -> None:
    """Writes the robot that stands for all drivers.

    Args:
        folder: is made.
        judge: of the robot.

    Raises:
        CrarError: a sole's axes are not the rest posture's, so that no rectangle in it
            is known.
    """
    folder.mkdir(parents=True, exist_ok=True)
    whole, model = judge.whole, judge.standing
    links = [robot_files.unscoped(frame) for frame in judge.frames]
    urdf = robot_files.simplified_urdf(Path(whole.folder) / whole.model, {}, links)
    soles = []
    for link, corners in whole.soles.items():
        small = shrunk(np.array(corners, dtype=float), judge.margins.margin)
        low, high = small.min(axis=0), small.max(axis=0)
        middle, half = 0.5 * (low + high), np.abs(small - 0.5 * (low + high))
        if high[2] - low[2] > 1e-6:
            raise CrarError(f"{whole.name}: soles: {link}: not flat in its own axes")
        frame = f"{link}_sole"
        robot_files.add_point(urdf, frame, link, middle)
        length, width = 2.0 * half.min(axis=0)[:2]
        soles.append(
            {
                "link": link,
                "frame": frame,
                "corners": small.tolist(),
                "length": length,
                "width": width,
            }
        )
    plant = model.plant
    efforts = dict.fromkeys(judge.joints, np.inf)
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        efforts[actuator.joint().name()] = min(actuator.effort_limit(), 1e4)
    speeds = dict(
        zip(model.velocity_names, plant.GetVelocityUpperLimits(), strict=True)
    )
    pairs = [
        [robot_files.unscoped(a), robot_files.unscoped(b)]
        for a, b in whole.pairs
        if GROUND not in (a, b)
    ]
    problem = {
        "robot": whole.name,
        "base": robot_files.unscoped(whole.base),
        "joints": judge.joints,
        "lower": finite_or_none(plant.GetPositionLowerLimits()),
        "upper": finite_or_none(plant.GetPositionUpperLimits()),
        "velocity_limits": [speeds[name] for name in judge.joints],
        "task_links": links,
        "pairs": pairs,
        "rest": judge.rest[7:].tolist(),
    }
    standing = {
        "root": judge.rest[:7].tolist(),
        "friction": judge.margins.friction,
        "margin": judge.margins.margin,
        "efforts": [efforts[name] for name in judge.joints],
        "soles": soles,
    }
    for name, text in (
        ("robot_pinocchio.urdf", robot_files.pinocchio_urdf(urdf)),
        ("problem.json", json.dumps(problem, indent=1)),
        ("standing.json", json.dumps(standing, indent=1)),
        ("collisions.json", json.dumps(pairs)),
    ):
        write_whole(folder / name, text)


def write_case(path: Path, home: np.ndarray, targets: Callable, seconds: float) -> None:
    """Targets that leave home with no jump of position, speed and acceleration.

    Args:
        path: of the case: time (T,), p, v, a (T, tasks, 3), made from rest.
        home: (tasks, 3) where the wrists rest [m].
        targets: time to positions, velocities and accelerations, one after the other.
        seconds: its length.
    """
    time = SAMPLE * np.arange(round(seconds / SAMPLE) + 1)
    given = np.array([targets(t) for t in time]).reshape(len(time), 3, *home.shape)
    s = np.minimum(time / BEGIN, 1.0)
    share = (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)[:, None, None]
    rate = (30.0 * s**2 * (1.0 - s) ** 2 / BEGIN)[:, None, None]
    bend = (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / BEGIN**2)[:, None, None]
    p, v, a = given[:, 0] - home, given[:, 1], given[:, 2]
    with whole_file(path) as temporary:
        np.savez(
            temporary,
            time=time,
            p=home + share * p,
            v=rate * p + share * v,
            a=bend * p + 2.0 * rate * v + share * a,
        )


def write_swings(folder: Path, judge: Judge, kind: str, seeds: Sequence[int]) -> list:
    """Writes a case for each seed; their names."""
    names = []
    for seed in seeds:
        rng = np.random.default_rng([list(SWINGS).index(kind), seed])
        targets = swings(judge.home.ravel(), rng, *SWINGS[kind])
        names.append(f"{kind} {seed}")
        write_case(folder / f"{names[-1]}.npz", judge.home, targets, SWING)
    return names


def write_motions(folder: Path, judge: Judge) -> dict[str, list[str]]:
    """Writes the recordings that are there; each a group with one case."""
    found = {}
    for name, motion in MOTIONS.items():
        try:
            desired = load_motion_targets(motion, judge.standing)
        except CrarError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        seconds = min(MOTION, desired.duration)

        def targets(t: float, desired=desired) -> np.ndarray:
            return desired.tasks_at(t)

        write_case(folder / f"{name}.npz", judge.home, targets, seconds)
        found[name] = [name]
    return found


def merged(figures: Sequence[Figures]) -> Figures:
    """Of several runs of the same length: shares, the farthest, the rms error."""
    rows = {key: [asdict(f)[key] for f in figures] for key in asdict(figures[0])}
    largest = ("farthest", "acceleration", "pelvis", "soles")
    means = {key: float(np.mean(values)) for key, values in rows.items()}
    peaks = {key: float(np.max(rows[key])) for key in largest}
    error = float(np.sqrt(np.mean(np.square(rows["error"]))))
    return Figures(**means | peaks | {"error": error})


def best(judged: Sequence[Figures]) -> int:
    """Which settings are taken: the least error of those with nothing wrong; where
    there are none, those with the least share of wrong instants."""
    right = [i for i, figures in enumerate(judged) if not figures.wrong]
    if right:
        return min(right, key=lambda i: judged[i].error)
    return min(range(len(judged)), key=lambda i: judged[i].wrong)


class Runs:
    """Drives controllers through cases, and judges them."""

    def __init__(self, arguments, folder: Path, judge: Judge) -> None:
        self._out = arguments.out.resolve() / "runs"
        self._environments = arguments.environments.resolve()
        self._folder, self._judge = folder, judge

    def of(
        self,
        peer: Peer,
        settings: dict,
        cases: Sequence[str],
        what: str = "",
        every: int = EVERY,
    ) -> tuple[list[Figures], list[np.ndarray]]:
        """Figures and step times [s] of each case."""
        python = environment(
            self._environments, peer.environment, ENVIRONMENTS[peer.environment]
        )
        period = settings.get("period", PERIOD)
        entry = Entry(peer.name, peer, dict.fromkeys(cases, settings))
        jobs = [
            job(case, settings, self._out / f"{entry.name} {what} {case}.npz", period)
            for case in cases
        ]
        drive(peer, {peer.environment: python}, self._folder, jobs)
        figures, times = [], []
        for case, one in zip(cases, jobs, strict=True):
            found = dict(np.load(one["out"]))
            p = np.load(self._folder / f"{case}.npz")["p"]
            p = p[:: round(period / SAMPLE)]
            follow = self._judge.legs_follow if settings.get("pelvis") else None
            figures.append(self._judge.figures(found, p, every, follow))
            times.append(found["step_time"][WARM_UP:])
        return figures, times


def tune(runs: Runs, peers: Sequence[Peer], cases: Sequence[str]) -> None:
    """Tries every grid, and keeps the best settings of each."""
    for peer in peers:
        judged = []
        for i, settings in enumerate(peer.grid):
            found, _ = runs.of(peer, settings, cases, f"tuning {i}", 0)
            judged.append(merged(found))
            print(peer.name, settings, judged[-1], file=sys.stderr, flush=True)
        taken = best(judged)
        kept = json.loads(SETTINGS.read_text()) if SETTINGS.is_file() else {}
        kept[peer.name] = {
            "settings": peer.grid[taken],
            "tried": len(peer.grid),
            "right": sum(not figures.wrong for figures in judged),
        }
        write_whole(SETTINGS, json.dumps(kept, indent=1) + "\n")


def cells(group: str, name: str, f: Figures, times: np.ndarray) -> list[str]:
    """Of a row."""
    far = "no centre" if np.isinf(f.farthest) else f"{1e3 * f.farthest:.1f} mm"
    median, p99 = 1e3 * np.median(times), 1e3 * np.percentile(times, 99)
    return [
        *(group, name, f"{f.outside_at:.2%}, {f.outside:.2%}", far),
        *(f"{f.slips:.2%}", f"{f.pairs:.2%}"),
        *(
            f"{f.limits:.2%}",
            f"{f.failed:.2%}",
            f"{f.motors:.2%}",
            f"{1e3 * f.error:.1f} mm",
        ),
        *(f"{f.acceleration:.0f} rad/s²", f"{1e3 * f.pelvis:.0f} mm"),
        *(f"{1e3 * f.soles:.1f} mm", f"{median:.2f} ({p99:.2f}) ms"),
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Tunes where asked, runs all and prints or writes the table."""
    benchmark = Benchmark("benchmarks.peers.standing", __doc__, "standing-peers")
    parser = benchmark.parser
    parser.add_argument("--robot", default="g1_whole_body")
    parser.add_argument("--seeds", type=int, default=3, help="swings of each kind")
    parser.add_argument("--tune", action="store_true", help="try the grids first")
    parser.add_argument("--only", default="", help="controllers with this in the name")
    add_peer_options(parser, "out/standing-peers")
    options = benchmark.parse(argv, lambda options: options.robot)
    judge = Judge(load_robot_description(options.robot), BalanceParameters())
    folder = options.out.resolve() / options.robot
    write_robot(folder, judge)
    runs = Runs(options, folder, judge)
    peers = [peer for peer in CONTROLLERS if options.only in peer.name]
    if options.tune:
        cases = [
            name
            for kind in TUNING
            for name in write_swings(folder, judge, kind, (1000,))
        ]
        tune(runs, peers, cases)
    if not SETTINGS.is_file():
        raise CrarError(f"{SETTINGS}: is not there; run with --tune")
    kept = json.loads(SETTINGS.read_text())
    groups = write_motions(folder, judge)
    for kind in SWINGS:
        groups[kind] = write_swings(folder, judge, kind, range(options.seeds))
    rows: dict[str, list] = {group: [] for group in groups}
    cases = [case for group in groups.values() for case in group]
    for peer in peers:
        if peer.name not in kept:
            raise CrarError(f"{SETTINGS}: has no {peer.name!r}; run with --tune")
        settings = kept[peer.name]["settings"]
        for name, more in ({"": {}} | VARIANTS.get(peer.name, {})).items():
            found = list(zip(*runs.of(peer, settings | more, cases, name), strict=True))
            shown = f"{peer.name}, {name}" if name else peer.name
            for group, names in groups.items():
                figures, times = zip(
                    *(found[cases.index(case)] for case in names), strict=True
                )
                rows[group].append(
                    cells(group, shown, merged(figures), np.concatenate(times))
                )
                print(*rows[group][-1], sep=" | ", file=sys.stderr, flush=True)
                if lost := merged(figures).lost:
                    print(f"off, and not judged: {lost:.1%}", file=sys.stderr)
    taken = [
        [
            peer.name,
            ", ".join(f"{k} {v:g}" for k, v in kept[peer.name]["settings"].items()),
            f"{kept[peer.name]['right']} of {kept[peer.name]['tried']}",
        ]
        for peer in peers
    ]
    settings = Table(("controller", "settings", "nothing wrong"), taken, "Settings")
    benchmark.report([Table(HEADER, sum(rows.values(), [])), settings])


if __name__ == "__main__":
    run(main)
