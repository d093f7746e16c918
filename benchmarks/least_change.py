"""How little any filter could change a reference, frame by frame.

    python -m benchmarks.least_change g1_whole_body dance.csv leap.csv ...
        [--every 10] [--page docs/measurements/cleaning.md]

Each frame by itself, without a past, a speed limit or a way to the next: the
configuration that differs the least from the reference among those whose watched pairs
keep the floor of `crar-drake clean` and whose joints keep their limits. The least of
what? Three answers: of the joints alone, wherever that takes the feet; of the norm that
`clean` uses, with the feet's weights; and of the hands' and the feet's places, whatever
the joints have to do for it.

Each is a local minimum, by sequential quadratic programs (Drake's Clarabel) from three
starts: the reference, the frame that `clean` made, and what was found for the frame
before. That bounds the least change from above, and is no proof of how small it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import JacobianWrtVariable, RigidBody
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from benchmarks.page import Benchmark, Table, run
from crar_drake.references.change import rms
from crar_drake.references.cleaning import Cleaner, CleaningParameters
from crar_drake.references.ground_contact import HANDS
from crar_drake.references.motion_files import read_motions
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import (
    RobotDescription,
    find_frame,
    load_robot_description,
    whole_body_name,
)
from crar_drake.trajectory.distance_rows import configurations

_STEPS = 25  # quadratic programs for a frame
_REGION, _SMALLEST = 0.3, 1e-4  # how far one of them may move a joint [rad]
_LOOKED_AT = 0.15  # pairs nearer than this have a row [m]
_KEPT = 2e-5  # by so much less than the floor a distance may be [m]
_BROKEN = 1e3  # of the merit, a metre of distances below the floor
# Where hands and feet matter: weights of joints and turns of feet [m/rad].
_JOINTS_LEAST, _FEET_TURN = 1e-2, 0.2
_ALIKE = np.ones(3)
OURS = "crar-drake clean"
MEASURES = ("joints alone", "norm of clean", "hands and feet")
HEADER = (
    "",
    "joints, rms / worst",
    "feet, rms / worst",
    "hands, rms / worst",
    "below the floor",
)


@dataclass(frozen=True)
class Found:
    """A frame's least change.

    Attributes:
        q: (n,) of the joints.
        cost: squared change in the measure.
        broken: what distances are below the floor by, at most [m].
    """

    q: np.ndarray
    cost: float
    broken: float


class LeastChange:
    """Least changes of one robot's frames in one measure."""

    def __init__(self, cleaner: Cleaner, measure: str) -> None:
        """
        Args:
            cleaner: of the robot, with its feet.
            measure: one of MEASURES.
        """
        self._model = cleaner.model
        self._floor = cleaner.parameters.floor
        self._workspace = self._model.MakeWorkspace()
        self._rest = self._model.rest_positions()
        self._parameters, self._measure = cleaner.parameters, measure
        plant, frames = self._model.plant, cleaner.description.task_frames
        self._feet = [find_frame(plant, frames[f]).body() for f in cleaner.feet]
        self._hands = [
            find_frame(plant, frames[f]).body() for f in HANDS if f in frames
        ]

    def find(self, reference: np.ndarray, starts: Sequence[np.ndarray]) -> Found:
        """The least change of a frame (n,), of several local ones."""
        self._set(reference)
        wanted = [self._pose(body) for body in self._feet + self._hands]
        found = [self._descend(reference, wanted, start) for start in starts]
        clear = [each for each in found if each.broken <= _KEPT]
        return min(clear or found, key=lambda each: each.cost)

    def places(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(2, 3) where the feet's links are, and (2, 3) the hands' [m]."""
        self._set(q)
        feet, hands = (
            np.array([self._pose(body).translation() for body in bodies])
            for bodies in (self._feet, self._hands)
        )
        return feet, hands

    def _descend(self, reference, wanted, start) -> Found:
        q, region = np.clip(start, self._model.lower, self._model.upper), _REGION
        A, b = self._residuals(q, reference, wanted)
        d, g = self._distances(q)
        broken = max(0.0, float((self._floor - d).max(initial=0.0)))
        for _ in range(_STEPS):
            step = self._step(q, A, b, d, g, region)
            if step is None or np.abs(step).max() < _SMALLEST:
                break
            A_new, b_new = self._residuals(q + step, reference, wanted)
            d_new, g_new = self._distances(q + step)
            broken_new = max(0.0, float((self._floor - d_new).max(initial=0.0)))
            worse = b_new @ b_new + _BROKEN * broken_new > b @ b + _BROKEN * broken
            if worse:
                region = 0.3 * min(region, float(np.abs(step).max()))
                continue
            q, A, b, d, g, broken = q + step, A_new, b_new, d_new, g_new, broken_new
        return Found(q, float(b @ b), broken)

    def _step(self, q, A, b, d, g, region) -> np.ndarray | None:
        """The step that a quadratic program takes, distances soft where it must."""
        n = len(q)
        program = MathematicalProgram()
        x = program.NewContinuousVariables(n)
        program.AddQuadraticCost(2.0 * A.T @ A, 2.0 * A.T @ b, x)
        low = np.maximum(self._model.lower - q, -region)
        high = np.minimum(self._model.upper - q, region)
        program.AddBoundingBoxConstraint(low, high, x)
        if len(d):
            (missing,) = program.NewContinuousVariables(1)
            program.AddBoundingBoxConstraint(0.0, np.inf, [missing])
            program.AddLinearCost(_BROKEN * missing)
            rows = np.column_stack([g, np.ones(len(d))])
            program.AddLinearConstraint(
                rows, self._floor - d, np.full(len(d), np.inf), [*x, missing]
            )
        result = ClarabelSolver().Solve(program)
        return result.GetSolution(x) if result.is_success() else None

    def _residuals(self, q, reference, wanted) -> tuple[np.ndarray, np.ndarray]:
        """A, b: the change in the measure, b + A x after a step x."""
        p = self._parameters
        places = self._measure == "hands and feet"
        weight = _JOINTS_LEAST if places else p.joint_weight
        A, b = [weight * np.eye(len(q))], [weight * (q - reference)]
        self._set(q)
        feet, hands = wanted[: len(self._feet)], wanted[len(self._feet) :]
        tasks: list[tuple[RigidBody, RigidTransform, np.ndarray, float]] = []
        if self._measure != "joints alone":
            along = np.array([p.foot_weight, p.foot_weight, p.foot_height_weight])
            weights = (_ALIKE, _FEET_TURN) if places else (along, p.foot_turn_weight)
            pairs = zip(self._feet, feet, strict=True)
            tasks += [(body, X, *weights) for body, X in pairs]
            weight = 1.0 if places else p.hand_weight
            pairs = zip(self._hands, hands, strict=True)
            tasks += [(body, X, weight * _ALIKE, 0.0) for body, X in pairs]
        for body, X, linear, angular in tasks:
            J = self._jacobian(body)
            X_now = self._pose(body)
            A.append(linear[:, None] * J[3:])
            b.append(linear * (X_now.translation() - X.translation()))
            turned = X_now.rotation().multiply(X.rotation().inverse()).ToAngleAxis()
            A.append(angular * J[:3])
            b.append(angular * turned.angle() * turned.axis())
        return np.vstack(A), np.concatenate(b)

    def _distances(self, q) -> tuple[np.ndarray, np.ndarray]:
        found = self._model.evaluate_distances(self._workspace, self._whole(q))
        near = found.d < _LOOKED_AT
        return found.d[near], found.dd_dq[near]

    def _whole(self, q: np.ndarray) -> np.ndarray:
        return configurations(self._model, self._rest, q)

    def _set(self, q: np.ndarray) -> None:
        self._model.plant.SetPositions(self._workspace.plant_context, self._whole(q))

    def _pose(self, body: RigidBody) -> RigidTransform:
        return self._model.plant.EvalBodyPoseInWorld(
            self._workspace.plant_context, body
        )

    def _jacobian(self, body: RigidBody) -> np.ndarray:
        plant = self._model.plant
        world = plant.world_frame()
        J = plant.CalcJacobianSpatialVelocity(
            self._workspace.plant_context,
            JacobianWrtVariable.kV,
            body.body_frame(),
            np.zeros(3),
            world,
            world,
        )
        return J[:, self._model.controlled]


def least_changes(
    cleaner: Cleaner,
    reference: np.ndarray,
    cleaned: np.ndarray,
    measure: str,
) -> tuple[np.ndarray, float]:
    """The frames of least change, (T, n), and what the worst lacks of the floor [m].

    Args:
        cleaner: of the robot.
        reference, cleaned: (T, n) joints before and after.
        measure: one of MEASURES.
    """
    least = LeastChange(cleaner, measure)
    # Frames that violate nothing stay as they are.
    margins = cleaner.margins(reference)
    clear = (margins.distance >= cleaner.parameters.floor) & (margins.limit >= 0.0)
    frames, broken = reference.copy(), 0.0
    for k in np.flatnonzero(~clear):
        starts = [reference[k], cleaned[k], frames[max(k - 1, 0)]]
        found = least.find(reference[k], starts)
        frames[k], broken = found.q, max(broken, found.broken)
    return frames, broken


def row(name: str, least: LeastChange, reference, frames, broken: float) -> list[str]:
    """What a motion's frames differ from the reference by."""
    change = np.degrees(frames - reference)
    before, after = ([least.places(q) for q in each] for each in (reference, frames))
    feet, hands = (
        1e3
        * np.linalg.norm(
            [b[i] - a[i] for a, b in zip(before, after, strict=True)], axis=2
        )
        for i in range(2)
    )
    return [
        name,
        f"{rms(change):.2f}° / {np.abs(change).max():.1f}°",
        f"{rms(feet):.1f} / {feet.max():.1f} mm",
        f"{rms(hands):.1f} / {hands.max():.1f} mm",
        f"{1e3 * broken:.2f} mm",
    ]


def table(description: RobotDescription, path: Path, every: int) -> Table:
    """What `clean` changes in a motion, and the least that can be."""
    (motion,) = read_motions(path, robot=WholeBody(description))
    rows, cleaner = [], Cleaner(description, motion.rate)
    names = cleaner.model.joint_names
    columns = [motion.joint_names.index(name) for name in names]
    q = np.ascontiguousarray(motion.joint_positions[:, columns])
    measured = LeastChange(cleaner, MEASURES[0])
    ours = cleaner.clean(q).q
    hands = CleaningParameters(hands=True)
    by_hands = Cleaner(description, motion.rate, hands).clean(q).q
    some = slice(None, None, every)
    for name, made in ((OURS, ours), (f"{OURS} --hands", by_hands)):
        rows.append(row(name, measured, q[some], made[some], 0.0))
    for measure in MEASURES:
        frames, broken = least_changes(cleaner, q[some], ours[some], measure)
        rows.append(
            row(f"least change of {measure}", measured, q[some], frames, broken)
        )
    for each in rows:
        print(path.stem, *each, sep=" | ", flush=True)
    return Table(HEADER, rows, path.stem)


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints the tables."""
    benchmark = Benchmark("benchmarks.least_change", __doc__, "cleaning")
    benchmark.parser.add_argument("robot", help="name or folder")
    benchmark.parser.add_argument("motions", nargs="+", type=Path)
    benchmark.parser.add_argument(
        "--every", type=int, default=1, help="look at each n-th frame alone (default 1)"
    )
    arguments = benchmark.parse(argv, lambda given: "least-change")
    name = whole_body_name(arguments.robot)
    description = load_robot_description(name).without_ground()
    benchmark.report(
        [table(description, motion, arguments.every) for motion in arguments.motions]
    )


if __name__ == "__main__":
    run(main)
