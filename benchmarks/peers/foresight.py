"""What a controller that knows the whole motion beforehand could reach at most.

    python -m benchmarks.peers.crossings --seeds 12
    python -m benchmarks.peers.foresight --seeds 12

Controllers are compared by two figures that pull against each other: the rms error of
the points, and the rms acceleration of the joints. How far could both come down? Here
the random crossings of `crossings` are solved as a whole, offline: of all joint motions
that start where and how the controllers do, keep the same distance, joint limits and
speed limits, those with the least

    (error / 1 mm)^2 + weight (acceleration / 1 rad/s^2)^2

for several weights, which gives the trade between the two. Motions are cubic splines
with a knot every 20 ms, found by sequential quadratic programs (Drake's Clarabel) from
what several controllers did. These are local minima: what is found is possible, by the
judge of all controllers; it is no proof that less is not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from rich.progress import track
from scipy.interpolate import BSpline

from benchmarks.page import Benchmark, Table
from benchmarks.peers.compare import PERIOD, run_command
from benchmarks.peers.crossings import HEADER, asked, best_errors, row, told_before
from benchmarks.peers.driver import Problem
from benchmarks.peers.judge import Figures, Judge
from benchmarks.peers.problem import SAMPLE
from crar_drake.robot.description import find_frame

WEIGHTS = (0.02, 0.1, 0.4, 1.6)
STARTS = ("lookahead, no preview", "Pink")
_KNOT, _EVERY = 0.02, 0.01  # spacing of knots, and of where all is asked for [s]
_DEGREE = 3
_STEPS = 20  # quadratic programs for a weight
_REGION, _SMALLEST = 0.2, 2e-4  # how far one of them may move a joint [rad]
_ENOUGH = 1e-4  # share of the merit by which a step must lower it to go on
_LOOKED_AT = 0.1  # pairs nearer than this have a row [m]
_ASKED = 0.0052  # the margin that all were asked to keep, and 0.2 mm more [m]
_BROKEN = 1e4  # of the cost, a metre of distance below it at a sample


@dataclass(frozen=True)
class Sample:
    """What is known of one instant: J (3 tasks, n), p - p_d (3 tasks,) [m], and of the
    pairs nearby the gradients (C, n) and distances (C,) [m]."""

    J: np.ndarray
    lacks: np.ndarray
    g: np.ndarray
    d: np.ndarray


@dataclass(frozen=True)
class Iterate:
    """Control points (M, n), what they lead to, and what that costs."""

    points: np.ndarray
    samples: list[Sample]
    merit: float


class Foresight:
    """The least costs of one motion, as a whole.

    Attributes:
        every: (T,) when a controller would be asked [s].
    """

    def __init__(
        self, judge: Judge, problem: Problem, motion: dict[str, np.ndarray]
    ) -> None:
        """
        Args:
            judge: of the problem.
            problem: whose motion it is.
            motion: time (T,), p (T, tasks, 3) and q_start (n,) of one of its files.
        """
        self._judge, self._model = judge, judge.model
        self._workspace = self._model.MakeWorkspace()
        self._frames = [find_frame(self._model.plant, link) for link in problem.links]
        self._lower, self._upper = problem.lower, problem.upper
        self._fastest = problem.velocity_limits
        self._motion = motion
        self._end = end = float(motion["time"][-1])
        time = np.linspace(0.0, end, round(end / _EVERY) + 1)
        self.every = np.linspace(0.0, end, round(end / PERIOD) + 1)
        self._knots = np.arange(-_DEGREE, round(end / _KNOT) + _DEGREE + 1) * _KNOT
        basis = BSpline(self._knots, np.eye(len(self._knots) - _DEGREE - 1), _DEGREE)
        self._basis = [basis(time, derivative) for derivative in range(3)]
        self._first = np.argmax(self._basis[0] > 0.0, axis=1)
        self._at_rest = np.vstack([basis(0.0), basis(0.0, 1)])

    def trade(
        self, starts: Sequence[np.ndarray]
    ) -> Iterator[tuple[float, dict[str, np.ndarray]]]:
        """Each weight, and of the least cost that is found what `driver.run` returns.

        Args:
            starts: (S, n) joints each, from the first instant on to the last.
        """
        candidates = [self._points_near(start) for start in starts]
        for weight in WEIGHTS:
            found = [self._descend(points, weight) for points in candidates]
            best = min(found, key=lambda each: each.merit).points
            candidates = [best]
            spline = BSpline(self._knots, best, _DEGREE)
            yield (
                weight,
                {
                    "time": self.every,
                    "q": spline(self.every),
                    "v": spline(self.every, 1),
                    "p": self._motion["p"][:: round(PERIOD / SAMPLE)],
                    "no_answer": np.zeros(len(self.every) - 1),
                },
            )

    def _points_near(self, joints: np.ndarray) -> np.ndarray:
        given = np.linspace(0.0, self._end, len(joints))
        time = np.linspace(0.0, self._end, len(self._first))
        q = np.column_stack([np.interp(time, given, x) for x in joints.T])
        return np.linalg.lstsq(self._basis[0], q, rcond=None)[0]

    def _descend(self, points: np.ndarray, weight: float) -> Iterate:
        # First onto the start, which the fit misses by a little.
        now, region = self._at(points, weight), _REGION
        begun = False
        for _ in range(_STEPS):
            step = self._step(now, weight, region)
            if step is None or np.abs(step).max() < _SMALLEST:
                break
            then = self._at(now.points + step, weight)
            gain = now.merit - then.merit
            if begun and gain < 0.0:
                region = 0.3 * min(region, float(np.abs(step).max()))
                continue
            now, begun = then, True
            if 0.0 <= gain < _ENOUGH * now.merit:
                break
        return now

    def _step(self, now: Iterate, weight: float, region: float) -> np.ndarray | None:
        """The change of the control points (M, n) that a quadratic program chooses."""
        (M, n), count = now.points.shape, len(now.samples)
        program = MathematicalProgram()
        x = program.NewContinuousVariables(M, n)
        missing = program.NewContinuousVariables(count)
        program.AddBoundingBoxConstraint(0.0, np.inf, missing)
        program.AddLinearCost(np.full(count, _BROKEN), 0.0, missing)
        program.AddBoundingBoxConstraint(
            np.maximum(self._lower - now.points, -region),
            np.minimum(self._upper - now.points, region),
            x,
        )
        start = np.vstack([self._motion["q_start"], np.zeros(n)])
        lacks = start - self._at_rest @ now.points
        for i in range(n):
            program.AddLinearEqualityConstraint(self._at_rest, lacks[:, i], x[:, i])
        errors, accelerations = self._shares(count, n, weight)
        eye = np.eye(n)
        for k, sample in enumerate(now.samples):
            window = slice(self._first[k], self._first[k] + _DEGREE + 1)
            w, w_dot, w_ddot = (basis[k, window] for basis in self._basis)
            near = x[window].ravel()
            A, B = np.kron(w, sample.J), np.kron(w_ddot, eye)
            a, v = (self._basis[i][k] @ now.points for i in (2, 1))
            program.AddQuadraticCost(
                2.0 * (errors * A.T @ A + accelerations * B.T @ B),
                2.0 * (errors * A.T @ sample.lacks + accelerations * B.T @ a),
                near,
                is_convex=True,
            )
            program.AddLinearConstraint(
                np.kron(w_dot, eye), -self._fastest - v, self._fastest - v, near
            )
            if len(sample.d):
                program.AddLinearConstraint(
                    np.column_stack([np.kron(w, sample.g), np.ones(len(sample.d))]),
                    _ASKED - sample.d,
                    np.full(len(sample.d), np.inf),
                    [*near, missing[k]],
                )
        result = ClarabelSolver().Solve(program)
        return result.GetSolution(x) if result.is_success() else None

    def _shares(self, count: int, n: int, weight: float) -> tuple[float, float]:
        """What squares of a metre and of a rad/s^2 cost at one of the samples."""
        return 1e6 / (count * len(self._frames)), weight / (count * n)

    def _at(self, points: np.ndarray, weight: float) -> Iterate:
        plant, context = self._model.plant, self._workspace.plant_context
        world = plant.world_frame()
        whole = self._judge.whole(self._basis[0] @ points)
        targets = self._motion["p"][:: round(_EVERY / SAMPLE)]
        samples, squares, broken = [], 0.0, 0.0
        for q, p_d in zip(whole, targets, strict=True):
            plant.SetPositions(context, q)
            J, lacks = [], []
            for frame, p in zip(self._frames, p_d, strict=True):
                of = (context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world)
                J.append(plant.CalcJacobianTranslationalVelocity(*of))
                lacks.append(frame.CalcPose(context, world).translation() - p)
            found = self._model.evaluate_distances(self._workspace, q)
            close = found.d < _LOOKED_AT
            sample = Sample(
                np.vstack(J)[:, self._model.controlled],
                np.concatenate(lacks),
                found.dd_dq[close],
                found.d[close],
            )
            squares += sample.lacks @ sample.lacks
            broken += max(0.0, float((_ASKED - sample.d).max(initial=0.0)))
            samples.append(sample)
        errors, accelerations = self._shares(len(samples), points.shape[1], weight)
        a = self._basis[2] @ points
        cost = errors * squares + accelerations * np.sum(a**2)
        return Iterate(points, samples, float(cost + _BROKEN * broken))


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.foresight", __doc__, "crossings")
    arguments, out, cases, judge = asked(benchmark, argv, lambda _: "foresight")
    best = best_errors(told_before(out, arguments.robot, cases))
    problem, runs = Problem(out / "problem"), out / "runs"
    judged: dict[float, list[Figures]] = {weight: [] for weight in WEIGHTS}
    for case in track(cases, "motions"):
        starts = [np.load(runs / f"{name} {case}.npz")["q"] for name in STARTS]
        foresight = Foresight(
            judge, problem, dict(np.load(problem.folder / f"{case}.npz"))
        )
        for weight, found in foresight.trade(starts):
            judged[weight].append(judge.figures(found))
    rows = [row(f"weight {weight:g}", each, best) for weight, each in judged.items()]
    benchmark.report([Table(HEADER, rows)])


if __name__ == "__main__":
    run_command(main)
