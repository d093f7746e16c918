"""TSID: inverse dynamics with 6d contacts at both feet (C++, four calls a step)."""

from __future__ import annotations

import numpy as np
import pinocchio
from tsid import tsid_pywrap as tsid

from benchmarks.peers.driver import NoAnswer, Targets, main
from benchmarks.peers.floating import Floating, from_pinocchio, to_pinocchio

HARD, SOFT = 0, 1  # levels of priority
SOLVED = 0


class Tsid(Floating):
    """Settings besides: kp of the wrists [1/s^2]; com, weight of the centre of mass;
    posture, weight of the rest posture. held, weight of the pelvis' whole pose instead
    of its orientation alone. It has no task that keeps pairs apart."""

    packages = ("tsid", "pin", "eiquadprog", "numpy")

    def set_up(self, settings: dict) -> None:
        problem, standing = self.problem, self.standing
        model = pinocchio.buildModelFromUrdf(
            str(problem.folder / "robot_pinocchio.urdf"),
            pinocchio.JointModelFreeFlyer(),
        )
        names = list(model.names)[2:]  # after the universe and the root
        self.order = [problem.joints.index(name) for name in names]
        self.back = np.argsort(self.order)
        self.robot = robot = tsid.RobotWrapper(model, tsid.FLOATING_BASE_SYSTEM, False)
        q, v = self._turn(*self.rest())
        self.formulation = tsid.InverseDynamicsFormulationAccForce("tsid", robot, False)
        self.formulation.computeProblemData(0.0, q, v)
        data = self.formulation.data()
        weight = 9.81 * sum(inertia.mass for inertia in model.inertias)
        self.parts = []  # kept alive beside the formulation
        for sole in standing["soles"]:
            corners = np.array(sole["corners"]).T
            middle = corners.mean(axis=1, keepdims=True)
            sizes = np.array([[sole["length"]], [sole["width"]]])
            shrink = 1.0 - 2.0 * settings["inside"] / sizes
            corners[:2] = middle[:2] + shrink * (corners[:2] - middle[:2])
            contact = tsid.Contact6d(
                *(f"stand_{sole['link']}", robot, sole["link"], corners),
                *(np.array([0.0, 0.0, 1.0]), self.pyramid, 0.0, 3.0 * weight),
            )
            contact.setKp(100.0 * np.ones(6))
            contact.setKd(20.0 * np.ones(6))
            contact.setReference(
                robot.framePosition(data, model.getFrameId(sole["link"]))
            )
            self.formulation.addRigidContact(contact, 1e-5)
            self.parts.append(contact)
        self.wrists = []
        for link in problem.links:
            task = tsid.TaskSE3Equality(f"reach_{link}", robot, link)
            task.setMask(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
            task.useLocalFrame(False)
            self._motion(task, settings["kp"] * np.ones(6), 1.0)
            self.wrists.append((task, tsid.TrajectorySample(12, 6)))
        com = tsid.TaskComEquality("com", robot)
        self._motion(com, 100.0 * np.ones(3), settings["com"])
        com.setReference(
            tsid.TrajectoryEuclidianConstant("c", robot.com(data)).computeNext()
        )
        trunk = tsid.TaskSE3Equality("trunk", robot, problem.base)
        held = settings.get("held", 0.0)
        trunk.setMask(np.array([held > 0.0] * 3 + [True] * 3, dtype=float))
        self._motion(trunk, 100.0 * np.ones(6), held or 0.1)
        at = robot.framePosition(data, model.getFrameId(problem.base))
        trunk.setReference(tsid.TrajectorySE3Constant("t", at).computeNext())
        posture = tsid.TaskJointPosture("posture", robot)
        self._motion(posture, 100.0 * np.ones(len(names)), settings["posture"])
        posture.setReference(tsid.TrajectoryEuclidianConstant("p", q[7:]).computeNext())
        bounds = tsid.TaskJointPosVelAccBounds("bounds", robot, self.period, False)
        bounds.setPositionBounds(problem.lower[self.order], problem.upper[self.order])
        bounds.setVelocityBounds(problem.velocity_limits[self.order])
        bounds.setAccelerationBounds(1e3 * np.ones(len(names)))
        bounds.setImposeBounds(True, True, True, False)
        self.formulation.addMotionTask(bounds, 1.0, HARD, 0.0)
        efforts = np.array(standing["efforts"])[self.order]
        torques = tsid.TaskActuationBounds("torques", robot)
        torques.setBounds(-efforts, efforts)
        self.formulation.addActuationTask(torques, 1.0, HARD, 0.0)
        self.parts += [com, trunk, posture, bounds, torques]
        self.solver = tsid.SolverHQuadProgFast("solver")
        self._resize()

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        at, speed = self._turn(q, v)
        for i, (task, sample) in enumerate(self.wrists):
            none = np.zeros(3)
            sample.value(np.concatenate([targets.p[i], np.eye(3).ravel()]))
            sample.derivative(np.concatenate([targets.v[i], none]))
            sample.second_derivative(np.concatenate([targets.a[i], none]))
            task.setReference(sample)
        solution = self.solver.solve(
            self.formulation.computeProblemData(0.0, at, speed)
        )
        if solution.status != SOLVED:
            raise NoAnswer
        a = np.array(self.formulation.getAccelerations(solution))
        a[6:] = a[6:][self.back]
        return from_pinocchio(q, v, a)

    def _turn(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at, speed = to_pinocchio(q, v)
        at[7:], speed[6:] = at[7:][self.order], speed[6:][self.order]
        return at, speed

    def _motion(self, task, kp: np.ndarray, weight: float) -> None:
        task.setKp(kp)
        task.setKd(2.0 * np.sqrt(kp))
        self.formulation.addMotionTask(task, weight, SOFT, 0.0)

    def _resize(self) -> None:
        f = self.formulation
        self.solver.resize(f.nVar, f.nEq, f.nIn)


if __name__ == "__main__":
    main(Tsid)
