"""AddRobot and AddCrarController in a user's own plant; judged by Drake alone."""

import dataclasses
import re
import warnings
from contextlib import contextmanager

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, HalfSpace, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import PdControllerGains, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from small_robots import chain_urdf

from crar_drake import (
    AddCrarController,
    AddRobot,
    AddStandingController,
    CrarWarning,
    LookaheadParameters,
    MakeControlModel,
    ModelError,
    PaperParameters,
    RobotDescription,
    SafetyFilter,
    ScenarioError,
    Task,
    joint_tasks,
    load_robot_description,
    position_tasks,
)
from crar_drake.resources import data_folder
from crar_drake.robot.joints import joint_units
from crar_drake.simulation.builders import connect_controller

TIP = [Task(frame="tip")]


class Cell:
    """A plant with arms of text, and what else a test adds."""

    def __init__(self, time_step: float = 1e-3) -> None:
        self.builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(
            self.builder, time_step
        )

    def arm(self, axes="zyz", name="chain", at=(0.0, 0.0, 0.0), onto=None, **more):
        """A chain that is welded to the world, or onto a frame; its instance."""
        urdf = chain_urdf(axes, **{"extra": ""} | more)
        parser = Parser(self.plant)
        parser.SetAutoRenaming(True)
        (instance,) = parser.AddModelsFromString(
            urdf.replace('name="chain"', f'name="{name}"'), "urdf"
        )
        self.plant.WeldFrames(
            onto or self.plant.world_frame(),
            self.plant.GetFrameByName("base", instance),
            RigidTransform(at),
        )
        return instance

    def thing(self, shape, at, name="post", *, free=False):
        """A link with a shape, welded to the world unless it is free."""
        plant = self.plant
        body = plant.AddRigidBody(
            name,
            plant.AddModelInstance(name),
            SpatialInertia.SolidSphereWithMass(1.0, 0.05),
        )
        plant.RegisterCollisionGeometry(
            body, RigidTransform(), shape, name, CoulombFriction(0.5, 0.5)
        )
        X_WB = RigidTransform(at)
        if free:
            plant.SetDefaultFloatingBaseBodyPose(body, X_WB)
        else:
            plant.WeldFrames(plant.world_frame(), body.body_frame(), X_WB)
        return body

    def control(self, tasks=TIP, parameters=None, **more):
        """A controller, once the plant is finalized."""
        if not self.plant.is_finalized():
            self.plant.Finalize()
        of = self.builder, self.plant, self.scene_graph
        return AddCrarController(*of, tasks, parameters, **more)

    def run(self, *controllers, to=None, seconds=0.8):
        """Simulates; the target is `to`, or 10 cm along y and z from rest. What is
        nearest, by the running plant's scene, of shapes that a filter leaves in."""
        for controller in controllers:
            model = controller.model
            target = model.tasks_at(model.rest_positions())
            target[1:3] += 0.1
            if to is not None:
                target[:3] = to
            source = self.builder.AddSystem(ConstantVectorSource(target))
            port = controller.get_input_port_desired_tasks()
            self.builder.Connect(source.get_output_port(), port)
        diagram = self.builder.Build()
        simulator = Simulator(diagram)
        root, nearest = simulator.get_context(), np.inf
        self.root = root
        query = self.scene_graph.get_query_output_port()
        of_scene = self.scene_graph.GetMyContextFromRoot(root)
        self.promises = []
        inspector = self.scene_graph.model_inspector()
        pairs = [
            pair
            for pair in inspector.GetCollisionCandidates()
            if not any(isinstance(inspector.GetShape(g), HalfSpace) for g in pair)
        ]
        for k in range(1, round(100 * seconds)):
            simulator.AdvanceTo(0.01 * k)
            asked = query.Eval(of_scene)
            nearest = min(
                nearest,
                *(
                    asked.ComputeSignedDistancePairClosestPoints(a, b).distance
                    for a, b in pairs
                ),
            )
            for controller in controllers:
                context = controller.GetMyContextFromRoot(root)
                self.promises.append(controller.diagnostics(context)["promise"])
        self.errors = [
            np.abs(c.diagnostics(c.GetMyContextFromRoot(root))["task_error"]).max()
            for c in controllers
        ]
        return nearest


@contextmanager
def silence():
    """Nothing is warned of."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def told(match: str):
    """Exactly one warning, which says that."""
    return _Told(match)


class _Told:
    def __init__(self, match: str) -> None:
        self._match, self._caught = match, warnings.catch_warnings(record=True)

    def __enter__(self) -> None:
        self._list = self._caught.__enter__()
        warnings.simplefilter("always")

    def __exit__(self, *error) -> None:
        self._caught.__exit__(*error)
        if error[0] is None:
            (one,) = self._list
            assert issubclass(one.category, CrarWarning)
            assert re.search(self._match, str(one.message)), one.message


# --- what is taken ----------------------------------------------------------------


@pytest.mark.parametrize("time_step", [0.0, 1e-3, 1e-2])
def test_the_control_plant_is_the_users(time_step):
    """Its time step, gravity, damping and defaults; so it does what is commanded."""
    cell = Cell(time_step)
    arm = cell.arm(damping=0.7, gear_ratio=20.0)
    cell.plant.mutable_gravity_field().set_gravity_vector([1.0, 0.0, -3.0])
    for i in range(3):
        cell.plant.GetJointByName(f"j{i}", arm).set_default_angle(0.3 * i + 0.1)
    with silence():
        controller = cell.control(parameters=LookaheadParameters(period=1e-2))
    model = controller.model
    assert model.plant.time_step() == time_step
    np.testing.assert_allclose(model.rest_positions(), [0.1, 0.4, 0.7])
    cell.run(controller, seconds=1.5)
    assert max(cell.errors) < 1e-3
    assert set(cell.promises) == {"guaranteed"}


@pytest.mark.parametrize("held_at, promise", [(0.0, "guaranteed"), (0.3, "locked")])
def test_a_gripper_a_table_and_a_free_box(held_at, promise):
    """The gripper is carried with its joint locked, and nothing is promised while it is
    elsewhere; the table is watched; the box is nobody's business."""
    cell = Cell()
    arm = cell.arm("zyzy")
    hand = cell.plant.GetFrameByName("tip", arm)
    gripper = cell.arm("z", name="gripper", onto=hand)
    motor = cell.plant.GetJointActuatorByName("j0", gripper).index()
    cell.plant.get_mutable_joint_actuator(motor).set_controller_gains(
        PdControllerGains(p=1e4, d=2e2)
    )
    cell.thing(Box(1.0, 1.0, 0.1), [0.0, 0.0, -0.4], "table")
    cell.thing(Sphere(0.04), [0.4, 0.4, -0.3], "box", free=True)
    cell.plant.Finalize()
    with silence():
        controller = cell.control(model_instance=arm)
    model = controller.model
    assert model.n == model.plant.num_positions() == 4
    links = {link for pair in model.pairs.names for link in pair}
    assert "table" in links and "box" not in links and "gripper::l0" in links
    mass = model.plant.CalcTotalMass(model.MakeWorkspace().plant_context)
    assert mass == pytest.approx(1.0 + 1.2 + 1.4 + 1.6 + 1.0 + 1.0)
    hold = cell.builder.AddSystem(ConstantVectorSource([held_at, 0.0]))
    cell.builder.Connect(
        hold.get_output_port(), cell.plant.get_desired_state_input_port(gripper)
    )
    cell.run(controller, to=[0.5, 0.3, -0.6])
    assert cell.promises.count(promise) >= 0.95 * len(cell.promises)


def test_a_post_is_watched_by_default():
    cell = Cell()
    cell.arm()
    cell.thing(Capsule(0.05, 0.6), [0.5, 0.4, 0.0])
    with silence():
        controller = cell.control()
    nearest = cell.run(controller, to=[0.0, 0.8, 0.0], seconds=1.5)
    assert 1e-3 < nearest < 0.03
    assert cell.promises.count("guaranteed") >= 0.95 * len(cell.promises)


def test_two_arms_of_one_kind():
    """Under a controller each, far apart: nothing to say. Near one another they do not
    see each other, and neither promises anything; under one controller they do."""
    for apart, says in ((5.0, silence()), (1.0, told("do not see each other"))):
        cell = Cell()
        arms = [cell.arm(), cell.arm(at=(0.0, apart, 0.0))]
        cell.plant.Finalize()
        with says:
            controllers = [cell.control(model_instance=arm) for arm in arms]
        cell.run(*controllers, seconds=0.3)
        assert max(cell.errors) < 0.1
        assert set(cell.promises) == {"guaranteed" if apart > 2.0 else "set-up"}
    cell = Cell()
    arms = [cell.arm(), cell.arm(at=(0.0, 1.0, 0.0))]
    cell.plant.Finalize()
    tips = position_tasks([f"{cell.plant.GetModelInstanceName(a)}::tip" for a in arms])
    with silence():
        both = cell.control(tips, model_instance=arms)
    assert both.model.n == 6 and ("chain::l2", "chain_1::l2") in both.model.pairs.names
    assert joint_units(both.model.plant, both.model.joint_names) == ["rad"] * 6
    mixed = Cell()
    arms = [mixed.arm(), mixed.arm(at=(0.0, 1.0, 0.0))]
    mixed.thing(Sphere(0.05), [3.0, 0.0, 0.0], "ball", free=True)
    mixed.plant.Finalize()
    controller = mixed.control(joint_tasks(["chain_1::j2"]), model_instance=arms)
    assert controller.model.layout.rows.joints.tolist() == [5]
    source = mixed.builder.AddSystem(ConstantVectorSource([0.3, 0.0, 0.0]))
    mixed.builder.Connect(
        source.get_output_port(), controller.get_input_port_desired_tasks()
    )
    simulator = Simulator(mixed.builder.Build())
    simulator.AdvanceTo(1.0)
    context = mixed.plant.GetMyContextFromRoot(simulator.get_context())
    turned = mixed.plant.GetPositions(context, arms[1])
    np.testing.assert_allclose(turned, [0.0, 0.0, 0.3], atol=1e-3)
    with pytest.raises(ModelError, match="chain, chain_1 have actuators; say which"):
        cell.control()


def test_a_robot_in_a_plant_has_all_that_its_description_says():
    path = data_folder("models") / "obstacle_arm"
    for robot in (path, str(path / "robot.yaml"), load_robot_description(path)):
        cell = Cell()
        arm = AddRobot(cell.plant, robot)
        assert cell.plant.GetModelInstanceName(arm) == "arm"
        assert not cell.plant.is_finalized()
        cell.plant.Finalize()
        joint = cell.plant.GetJointByName("joint4", arm)
        assert joint.get_default_angle() == 1.6
    described, cell = load_robot_description("upper_body"), Cell()
    cell.thing(Box(0.1, 0.1, 0.1), [3.0, 0.0, 0.0], "base")  # as the robot's own
    names = ("left", "right")
    robots = [
        AddRobot(
            cell.plant, described, prefix=name, X_WB=RigidTransform([0, 2.0 * i, 0])
        )
        for i, name in enumerate(names)
    ]
    cell.plant.Finalize()
    assert cell.plant.GetModelInstanceName(robots[1]) == "right::upper_body"
    context = cell.plant.CreateDefaultContext()
    at = [
        cell.plant.GetFrameByName("left_elbow", i)
        .CalcPoseInWorld(context)
        .translation()
        for i in robots
    ]
    np.testing.assert_allclose(at[1] - at[0], [0.0, 2.0, 0.0], atol=1e-12)
    waist = ["waist_x", "waist_y", "right::upper_body::waist_z"]
    controller = cell.control(
        position_tasks(["left_elbow"]), model_instance=robots[1], prescribed=waist
    )
    pairs = {frozenset(p.rpartition("::")[2] for p in pair) for pair in described.pairs}
    model = controller.model
    named = [
        frozenset(p.rpartition("::")[2] for p in pair) for pair in model.pairs.names
    ]
    assert set(named) - {p for p in named if "base" in p} == pairs
    assert controller.model.prescribed_names == ["waist_x", "waist_y", "waist_z"]


def test_two_robots_in_one_diagram_do_as_each_alone():
    """Of two kinds, and of one: names are unique, and nothing is shared."""

    def torques(*robots: tuple[str, str]) -> list[np.ndarray]:
        builder, controllers = DiagramBuilder(), []
        for number, (name, frame) in enumerate(robots):
            plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
            plant.set_name(f"plant_{number}")
            scene_graph.set_name(f"scene_graph_{number}")
            robot = AddRobot(plant, name)
            plant.Finalize()
            controller = AddCrarController(
                builder,
                plant,
                scene_graph,
                position_tasks([frame]),
                model_instance=robot,
                prescribed=load_robot_description(name).prescribed_joints,
            )
            model = controller.model
            target = model.tasks_at(model.rest_positions())
            target[2] += 0.05
            values = [(target, controller.get_input_port_desired_tasks())]
            if model.n_p:
                still = model.prescribed_at(model.rest_positions())
                values.append((still, controller.get_input_port_desired_prescribed()))
            for value, port in values:
                source = builder.AddSystem(ConstantVectorSource(value))
                builder.Connect(source.get_output_port(), port)
            controllers.append(controller)
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo(0.1)
        root = simulator.get_context()
        return [
            c.get_output_port_actuation().Eval(c.GetMyContextFromRoot(root))
            for c in controllers
        ]

    body, arm = ("upper_body", "left_wrist"), ("obstacle_arm", "tool")
    alone = [*torques(body), *torques(arm)]
    for both, expected in (
        (torques(body, arm), alone),
        (torques(arm, arm), [alone[1]] * 2),
    ):
        for found, its in zip(both, expected, strict=True):
            np.testing.assert_array_equal(found, its)


def test_links_that_nobody_watches_do_not_push(tmp_path):
    """They are inside each other at rest, as an import's capsules often are."""
    ball = '<sphere radius="0.32"/>'
    (tmp_path / "robot.urdf").write_text(chain_urdf("zyzy", shapes=(ball,), extra=""))
    described = RobotDescription(
        name="fat",
        model="robot.urdf",
        base="base",
        pairs=[["l0", "l3"]],
        folder=str(tmp_path),
    )
    cell = Cell()
    AddRobot(cell.plant, described)
    with silence():
        controller = cell.control()
    assert controller.model.pairs.names == (("l0", "l3"),)
    assert cell.run(controller) > 4e-3
    port = cell.plant.get_contact_results_output_port()
    context = cell.plant.GetMyContextFromRoot(cell.root)
    assert port.Eval(context).num_point_pair_contacts() == 0
    assert set(cell.promises) == {"guaranteed"} and max(cell.errors) < 1e-2


# --- what is refused --------------------------------------------------------------


def with_arm(**more):
    cell = Cell()
    cell.arm(**more)
    return cell


def on_a_lift():
    cell = Cell()
    lift = cell.arm("z", name="lift")
    onto = cell.plant.GetFrameByName("l0", lift)
    return cell, cell.arm(onto=onto, at=(0.3, 0.0, 0.2))


def test_a_robot_that_something_else_carries():
    cell, arm = on_a_lift()
    cell.plant.Finalize()
    with pytest.raises(ModelError, match="'base' is carried by joint 'j0' of 'lift'"):
        cell.control(model_instance=arm)
    with silence():  # one controller of both
        both = [cell.plant.GetModelInstanceByName("lift"), arm]
        cell.control([Task(frame="chain::tip")], model_instance=both)


def test_a_second_controller_of_one_robot():
    cell = with_arm()
    cell.control()
    systems = len(cell.builder.GetSystems())
    with pytest.raises(ModelError, match="actuation is connected already"):
        cell.control()
    assert len(cell.builder.GetSystems()) == systems


MISTAKES = [
    (dict(tasks=["tip"]), r"'tip' is no Task; write position_tasks\(\['tip'\]\)"),
    (dict(tasks="tip"), "'tip' is no list of tasks"),
    (dict(tasks=[Task(frame="tpi")]), "tpi.*did you mean 'tip'"),
    (dict(parameters={"period": 0.01}), "parameters cannot be a dict"),
    (dict(watch="l0"), "watch: 'l' is no pair"),
    (dict(watch=[["l0"]]), r"watch: \['l0'\] is no pair"),
    (dict(watch=[["l0", "lo2"]]), "'lo2'; did you mean"),
    (dict(watch=[["l0", "ball"]]), "link 'ball' of 'ball' moves by itself"),
    (dict(watch=[["l0", "l0"]]), "two different links"),
    (dict(prescribed="j0"), "prescribed: 'j0' must be a list"),
    (dict(prescribed=["j9"]), "no joint 'j9'; known are j0, j1"),
    (dict(prescribed=["j0", "j1", "j2"]), "no joint left to control"),
    (dict(model_instance="chain"), "'chain' is none; give what AddRobot"),
]


@pytest.mark.parametrize("given, words", MISTAKES, ids=[str(k) for k, _ in MISTAKES])
def test_arguments_of_another_shape(given, words):
    cell = with_arm()
    cell.thing(Sphere(0.1), [2.0, 0.0, 0.0], "ball", free=True)
    with pytest.raises(ModelError, match=words):
        cell.control(**given)


def test_a_period_that_is_not_a_multiple():
    cell = Cell(2e-3)
    cell.arm()
    with pytest.raises(ScenarioError, match="controller.period: 0.003 s.*0.002 s"):
        cell.control(parameters=LookaheadParameters(period=3e-3))


def test_a_model_of_another_time_step():
    cell, other = with_arm(), Cell(2e-3)
    cell.plant.Finalize()
    model = MakeControlModel(cell.plant, cell.scene_graph, TIP)
    other.arm()
    other.plant.Finalize()
    given = other.builder, other.plant
    with pytest.raises(ModelError, match="0.001 s; make it with time_step=0.002"):
        connect_controller(*given, model, LookaheadParameters(period=0.01))
    with pytest.raises(ModelError, match="0.001 s; make it with time_step=0, contin"):
        AddStandingController(*given, None, model)
    assert not other.builder.IsConnectedOrExported(
        other.plant.get_actuation_input_port()
    )


def test_a_period_beyond_what_a_plan_bears():
    """Said by itself: its gains are nobody's who could change them."""
    with pytest.raises(
        ScenarioError, match="period: 5 s is too long: choose one below"
    ):
        with_arm().control(parameters=LookaheadParameters(period=5.0))


def test_the_world_is_ground_if_that_is_all_it_has():
    for crate, name in ((False, "ground"), (True, "world")):
        cell = with_arm()
        for shape in (HalfSpace(), Box(0.1, 0.1, 0.1))[: 1 + crate]:
            cell.plant.RegisterCollisionGeometry(
                *(cell.plant.world_body(), RigidTransform([0.0, 0.0, -1.0]), shape),
                *(type(shape).__name__, CoulombFriction(0.5, 0.5)),
            )
        assert (name, "l2") in cell.control().model.pairs.names


def test_a_short_slide_keeps_a_tenth_of_its_range():
    """No more, though other joints keep 0.02 rad; a margin that leaves none is refused,
    and the joint named."""
    for target, rests in ((0.026, 0.026), (0.03, 0.027)):
        cell = Cell()
        cell.arm(rail="y")
        rail = cell.plant.GetJointByName("rail")
        rail.set_position_limits([0.0], [0.03])
        rail.set_default_translation(0.01)
        tasks = joint_tasks(["rail"])
        wide = LookaheadParameters(limit_margin=0.04)
        cell.plant.Finalize()
        with pytest.raises(ScenarioError, match="joint rail no room"):
            cell.control(tasks, wide)
        controller = cell.control(tasks)
        cell.run(controller, to=[target, 0.0, 0.0], seconds=3.0)
        context = cell.plant.GetMyContextFromRoot(cell.root)
        assert rail.get_translation(context) == pytest.approx(rests, abs=2e-4)
        assert set(cell.promises) == {"guaranteed"}


def test_a_robot_that_cannot_be_added():
    cell = Cell()
    with pytest.raises(ModelError, match="'uper_body'.*did you mean 'upper_body'"):
        AddRobot(cell.plant, "uper_body")
    with pytest.raises(ModelError, match="AddMultibodyPlantSceneGraph"):
        AddRobot(MultibodyPlant(1e-3), "upper_body")
    with pytest.raises(ModelError, match="X_WB is a RigidTransform, not list"):
        AddRobot(cell.plant, "upper_body", X_WB=[1.0, 0.0, 0.0])
    degrees = dataclasses.replace(
        load_robot_description("upper_body"), rest_posture={"left_elbow": -80.0}
    )
    with pytest.raises(ModelError, match="left_elbow: -80 rad is far.*give radians"):
        AddRobot(cell.plant, degrees, prefix="a")
    AddRobot(cell.plant, "upper_body")
    with pytest.raises(ModelError, match="give another prefix"):
        AddRobot(cell.plant, "upper_body")
    cell.plant.Finalize()
    with pytest.raises(ModelError, match="finalized already"):
        AddRobot(cell.plant, "upper_body")


def test_what_an_ambiguous_name_may_mean():
    cell = Cell()
    arms = [cell.arm(), cell.arm(at=(0.0, 1.0, 0.0))]
    cell.plant.Finalize()
    with pytest.raises(ModelError, match="write chain::tip or chain_1::tip"):
        cell.control(model_instance=arms)


# --- what is warned of ------------------------------------------------------------


def meets_at_rest(cell):
    cell.thing(Sphere(0.1), [0.75, 0.1, 0.0])
    return {}


def inside_at_rest(cell):
    meets_at_rest(cell)
    return {"watch": [["l0", "l2"], ["l1", "post"], ["l0", "post"], ["l2", "post"]]}


def not_in_a_pair(cell):
    cell.thing(Sphere(0.1), [0.0, 0.9, 0.0])
    return {"watch": [["l0", "l2"]]}


def a_half_space_on_a_link(cell):
    cell.thing(HalfSpace(), [0.0, 0.0, -1.0], "floor")
    return {}


def without_effect(cell):
    return {"parameters": PaperParameters(), "obstacle_speeds": [1.0]}


WRONG = [
    (meets_at_rest, "l2 - post meet at rest and are not watched"),
    (inside_at_rest, "l2 - post are inside one another at rest"),
    (not_in_a_pair, "l1 - post, l2 - post can touch and are not watched"),
    (a_half_space_on_a_link, "floor.* cannot be watched: .*register it on plant.world"),
    (without_effect, "obstacle_speeds have no effect"),
]


@pytest.mark.parametrize("wrong, says", WRONG, ids=[w.__name__ for w, _ in WRONG])
def test_what_a_user_has_to_know(wrong, says):
    """One warning, or an error where it is strict."""
    cell = with_arm()
    given = wrong(cell)
    with told(says):
        controller = cell.control(**given)
    cell.run(controller, seconds=0.05)
    assert "guaranteed" not in cell.promises
    cell = with_arm()
    given = wrong(cell)
    with pytest.raises(ModelError, match=says):
        cell.control(**given, strict=True)


def test_no_pair_to_watch():
    cell = with_arm(axes="z")
    with pytest.raises(ModelError, match="no pair of shapes is left"):
        cell.control()
    with silence():
        cell.control(watch=[])
    of = cell.plant, cell.scene_graph
    with pytest.raises(ModelError, match="no pair of shapes is left"):
        MakeControlModel(*of)
    with silence():
        model = MakeControlModel(*of, watch=[])
    with told("robot chain: no pair of links is watched"):
        SafetyFilter(model)


def test_a_filter_of_ones_own_plant_watches_what_the_controller_would():
    cell = with_arm()
    cell.thing(Sphere(0.1), [2.0, 0.0, 0.0], "ball", free=True)
    post = meets_at_rest(cell)
    cell.plant.Finalize()
    of = cell.plant, cell.scene_graph
    with told("l2 - post meet at rest and are not watched"):
        model = MakeControlModel(*of, **post)
    with pytest.raises(ModelError, match="l2 - post meet at rest"):
        MakeControlModel(*of, strict=True)
    with silence():
        filter = SafetyFilter(model)
    with told("l2 - post meet at rest"):
        assert cell.control().model.pairs.names == model.pairs.names
    assert ("l1", "post") in model.pairs.names and filter.model is model


def test_a_start_inside_a_post():
    for strict in (False, True):
        cell = with_arm()
        cell.thing(Sphere(0.1), [0.2, 0.7, 0.0])
        with silence():
            controller = cell.control(strict=strict)
        cell.plant.SetDefaultPositions([1.3, 0.0, 0.0])
        if strict:
            with pytest.raises(ModelError, match="starts with l2 - post inside"):
                cell.run(controller, seconds=0.05)
        else:
            with told("starts with l2 - post inside one another by"):
                cell.run(controller, seconds=0.05)
            assert cell.promises[0] == "path"
