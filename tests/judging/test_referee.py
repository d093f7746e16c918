"""The referee against closed forms, SciPy and Drake's own distances."""

import math

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import brentq, lsq_linear
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.judging.referee_distances import capsule_distance

ROOT_HALF = math.sqrt(0.5)

# name: (p_a0, p_a1, r_a, p_b0, p_b1, r_b), expected distance [m]
CLOSED_FORMS = {
    "parallel side by side": (
        ((0, 0, 0), (0, 0, 1), 0.1, (0.5, 0, 0), (0.5, 0, 1), 0.2),
        0.2,
    ),
    "parallel, shifted, overlapping": (
        ((0, 0, 0), (0, 0, 1), 0.1, (0.3, 0, 0.4), (0.3, 0, 2), 0.1),
        0.1,
    ),
    "antiparallel, past each other": (
        ((0, 0, 0), (0, 0, 1), 0.1, (3, 0, 9), (3, 0, 5), 0.2),
        4.7,
    ),
    "parallel, exactly touching": (
        ((0, 0, 0), (0, 0, 1), 0.25, (0.5, 0, 0), (0.5, 0, 1), 0.25),
        0.0,
    ),
    "parallel, inside": (
        ((0, 0, 0), (0, 0, 1), 0.25, (0.125, 0, 0), (0.125, 0, 1), 0.25),
        -0.375,
    ),
    "identical": (((0, 0, 0), (0, 0, 1), 0.1, (0, 0, 0), (0, 0, 1), 0.2), -0.3),
    "collinear end to end": (
        ((0, 0, 0), (1, 0, 0), 0.1, (2, 0, 0), (3, 0, 0), 0.2),
        0.7,
    ),
    "collinear, overlapping": (
        ((0, 0, 0), (1, 0, 0), 0.1, (0.5, 0, 0), (3, 0, 0), 0.2),
        -0.3,
    ),
    "crossing at a distance": (
        ((-1, 0, 0), (1, 0, 0), 0.1, (0.2, -1, 0.5), (0.2, 3, 0.5), 0.1),
        0.3,
    ),
    "crossing axes": (
        ((-1, 0, 0), (1, 0, 0), 0.1, (0, -1, 0), (0, 1, 0), 0.1),
        -0.2,
    ),
    "T: end above a middle": (
        ((-1, 0, 0), (1, 0, 0), 0.1, (0.2, 0, 0.6), (0.2, 0, 2), 0.1),
        0.4,
    ),
    "skew, end to end": (
        ((0, 0, 0), (-1, 0, 0), 0.1, (3, 4, 0), (3, 4, 9), 0.1),
        4.8,
    ),
    "L: stationary point outside the square": (
        ((0, 0, 0), (1, 0, 0), 0, (2, 1, 0), (2, 5, 0), 0),
        math.sqrt(2),
    ),
    "point and point": (
        ((1, 2, 3), (1, 2, 3), 0.5, (1, 5, 7), (1, 5, 7), 0.25),
        4.25,
    ),
    "the same point": (((1, 2, 3), (1, 2, 3), 0.5, (1, 2, 3), (1, 2, 3), 0.25), -0.75),
    "point beside a segment": (
        ((0.3, 0.4, 0.5), (0.3, 0.4, 0.5), 0.1, (0, 0, 0), (0, 0, 1), 0.1),
        0.3,
    ),
    "point beyond a segment's end": (
        ((0, 3, 5), (0, 3, 5), 0.1, (0, 0, 0), (0, 0, 1), 0.1),
        4.8,
    ),
    "point on a segment": (
        ((0, 0, 0.5), (0, 0, 0.5), 0.1, (0, 0, 0), (0, 0, 1), 0.1),
        -0.2,
    ),
    "diagonal against a face diagonal": (
        ((0, 0, 0), (1, 1, 0), 0, (0, 1, 1), (1, 0, 1), 0),
        1.0,
    ),
    "a cube's edge against its face diagonal": (
        ((0, 0, 0), (0, 0, 1), 0, (1, 0, 0), (0, 1, 0), 0),
        ROOT_HALF,
    ),
}


def random_pair(rng: np.random.Generator, kind: int) -> tuple:
    """A pair of capsules; every `kind` modulo 7 is awkward in another way."""
    a0, b0 = rng.uniform(-1, 1, (2, 3))
    u, v = rng.normal(size=(2, 3))
    kind %= 7
    if kind == 1:
        u *= 10.0 ** rng.uniform(-12, -3)  # tiny
    elif kind == 2:
        u *= 10.0 ** rng.uniform(-12, -3)
        v *= 10.0 ** rng.uniform(-12, -3)
    elif kind == 3:
        v = rng.choice([-1, 1]) * rng.uniform(0.1, 3) * u  # parallel
    elif kind == 4:
        v = u + 10.0 ** rng.uniform(-12, -4) * v  # nearly parallel
    if kind == 6:  # nearly parallel
        v = u + 10.0 ** rng.uniform(-9, -2) * v
    if kind >= 5:  # axes that cross, or nearly
        a0 = b0 + rng.uniform() * v - rng.uniform() * u
        a0 += 10.0 ** rng.uniform(-15, -3) * rng.normal(size=3)
    return a0, a0 + u, rng.uniform(0, 0.2), b0, b0 + v, rng.uniform(0, 0.2)


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_closed_forms(name):
    capsules, expected = CLOSED_FORMS[name]
    distance, _, _ = capsule_distance(*capsules)
    assert distance == pytest.approx(expected, abs=1e-14)


def test_witness_points_of_crossing_axes():
    _, p_a, p_b = capsule_distance(
        (-1, 0, 0), (1, 0, 0), 0.1, (0.2, -1, 0.5), (0.2, 3, 0.5), 0.1
    )
    np.testing.assert_allclose(p_a, [0.2, 0, 0], atol=1e-15)
    np.testing.assert_allclose(p_b, [0.2, 0, 0.5], atol=1e-15)


def test_penetration_is_what_parts_the_capsules():
    """Moved apart along the witness line by the depth, they just touch."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        a0, a1, _, b0, b1, _ = random_pair(rng, 0)
        axis_distance, p_a, p_b = capsule_distance(a0, a1, 0, b0, b1, 0)
        radius = 0.75 * axis_distance
        distance, _, _ = capsule_distance(a0, a1, radius, b0, b1, radius)
        assert distance < 0.0
        shift = -distance * (p_a - p_b) / axis_distance
        parted, _, _ = capsule_distance(a0 + shift, a1 + shift, radius, b0, b1, radius)
        assert parted == pytest.approx(0.0, abs=1e-12)
        # No shorter way out: in no direction does less of a shift part them.
        for direction in rng.normal(size=(10, 3)):
            less = -0.99 * distance * direction / np.linalg.norm(direction)
            inside, _, _ = capsule_distance(
                a0 + less, a1 + less, radius, b0, b1, radius
            )
            assert inside < 0.0


@pytest.mark.parametrize("kind", [0, 3, 5])
def test_bounded_least_squares(kind):
    """SciPy's solver of min |w + [u, -v] x| with 0 <= x <= 1."""
    rng = np.random.default_rng(10 + kind)
    for _ in range(60):
        a0, a1, _, b0, b1, _ = random_pair(rng, kind)
        matrix = np.column_stack([a1 - a0, b0 - b1])
        solution = lsq_linear(matrix, b0 - a0, (0, 1), method="bvls", tol=1e-15)
        expected = np.linalg.norm(matrix @ solution.x - (b0 - a0))
        distance, _, _ = capsule_distance(a0, a1, 0, b0, b1, 0)
        assert distance == pytest.approx(expected, abs=1e-9)


def test_optimality_of_the_witness_points():
    """By convexity they are nearest if no end of either axis lies further towards
    the other witness point; to 1e-14 m² this needs no other solver."""
    rng = np.random.default_rng(20)
    for trial in range(3000):
        a0, a1, _, b0, b1, _ = random_pair(rng, trial)
        _, p_a, p_b = capsule_distance(a0, a1, 0, b0, b1, 0)
        gap = p_b - p_a
        for end in (a0, a1):
            assert (end - p_a) @ gap <= 1e-14
        for end in (b0, b1):
            assert (end - p_b) @ -gap <= 1e-14


def test_symmetry_under_swap_and_rigid_motion():
    rng = np.random.default_rng(30)
    for trial in range(300):
        a0, a1, radius_a, b0, b1, radius_b = random_pair(rng, trial)
        distance, _, _ = capsule_distance(a0, a1, radius_a, b0, b1, radius_b)
        swapped, _, _ = capsule_distance(b0, b1, radius_b, a0, a1, radius_a)
        turned, _, _ = capsule_distance(a1, a0, radius_a, b0, b1, radius_b)
        rotation = Rotation.random(random_state=rng).as_matrix()
        shift = rng.uniform(-2, 2, 3)
        m0, m1, n0, n1 = (rotation @ p + shift for p in (a0, a1, b0, b1))
        moved, _, _ = capsule_distance(m0, m1, radius_a, n0, n1, radius_b)
        # Rounding of the moved ends turns nearly parallel axes by 1e-16 or so.
        np.testing.assert_allclose([swapped, turned, moved], distance, atol=5e-8)


# ---------------------------------------------------------------------------------

SPHERE = '<sphere radius="{}"/>'
CAPSULE = '<capsule radius="{}" length="{}"/>'


def link(name: str, *shapes: tuple[str, str, str]) -> str:
    collisions = "".join(
        f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry>'
        "</collision>"
        for shape, xyz, rpy in shapes
    )
    return (
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="0.01" '
        'iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"{collisions}</link>"
    )


def joint(name: str, kind: str, parent: str, child: str, xyz: str, limit: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child '
        f'link="{child}"/><origin xyz="{xyz}" rpy="0.2 0.1 0"/><axis xyz="0 0.6 0.8"/>'
        f"{limit}</joint>"
    )


URDF = (
    '<robot name="r">'
    + link("base", (CAPSULE.format(0.1, 0.5), "0 0 0.2", "0 0.5 0"))
    + link(
        "upper",
        (CAPSULE.format(0.06, 0.3), "0.1 0 0.1", "0.7 0 0.3"),
        (SPHERE.format(0.08), "0.2 0 0.3", "0 0 0"),
    )
    + link("hand", (SPHERE.format(0.07), "0.1 0.05 0", "0 0 0"))
    + link("slider", (SPHERE.format(0.05), "0 0 0.1", "0 0 0"))
    + link("bare")
    + link("can", ('<cylinder radius="1" length="3"/>', "0 0 0", "0 0 0"))
    + joint("weld_can", "fixed", "base", "can", "0 0 0", "")
    + joint("weld_bare", "fixed", "base", "bare", "0 0 0", "")
    + joint("weld", "fixed", "world", "base", "0 0 0.1", "")
    + joint(
        "shoulder",
        "revolute",
        "base",
        "upper",
        "0.2 0 0.4",
        '<limit lower="-1" upper="0.5" effort="1" velocity="1"/>',
    )
    + joint("elbow", "continuous", "upper", "hand", "0.3 0 0.3", "")
    + joint(
        "slide",
        "prismatic",
        "base",
        "slider",
        "0.1 0.1 0.1",
        '<limit lower="-0.3" upper="0.3" effort="1" velocity="1"/>',
    )
    + "</robot>"
)

# All are sphere against sphere or against capsule: exact in Drake.
PAIRS = [
    ["hand", "base"],
    ["hand", "slider"],
    ["slider", "upper"],
    ["r::hand", "upper"],
]


def build(finalize: bool = True) -> tuple:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModelsFromString(URDF, "urdf")
    if finalize:
        plant.Finalize()
    return builder, plant, scene_graph


@pytest.fixture(scope="module")
def robot() -> tuple:
    builder, plant, scene_graph = build()
    return builder.Build(), plant, scene_graph


@pytest.fixture(scope="module")
def referee(robot) -> Referee:
    _, plant, scene_graph = robot
    return Referee(plant, scene_graph, PAIRS)


def test_distances_against_drake(robot, referee):
    diagram, plant, scene_graph = robot
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyContextFromRoot(context)
    query = scene_graph.get_query_output_port().Eval(
        scene_graph.GetMyContextFromRoot(context)
    )

    def shapes(name):
        body = plant.GetBodyByName(name.split("::")[-1])
        return plant.GetCollisionGeometriesForBody(body)

    rng = np.random.default_rng(1)
    seen = []
    for _ in range(50):
        q = rng.uniform([-3, -3, -1], [3, 3, 1])
        plant.SetPositions(plant_context, q)
        expected = [
            min(
                query.ComputeSignedDistancePairClosestPoints(a, b).distance
                for a in shapes(pair[0])
                for b in shapes(pair[1])
            )
            for pair in PAIRS
        ]
        # FCL stops at about 1e-10 for sphere-capsule.
        np.testing.assert_allclose(referee.distances(q), expected, atol=1e-9)
        seen.extend(expected)
    assert min(seen) < -0.01 and max(seen) > 0.1  # both sides of touching


def test_limit_excess(referee):
    names = list(referee.joint_names)
    assert sorted(names) == ["elbow", "shoulder", "slide"]
    for shoulder, elbow, slide, expected in [
        (0.0, 0.0, 0.0, (0, 0, 0)),
        (0.5, 1e6, -0.3, (0, 0, 0)),
        (0.75, -1e6, 0.0, (0.25, 0, 0)),
        (-1.5, 0.0, -0.4, (0.5, 0, 0.1)),
    ]:
        values = {"shoulder": shoulder, "elbow": elbow, "slide": slide}
        excess = referee.limit_excess(np.array([values[name] for name in names]))
        by_name = dict(zip(names, excess, strict=True))
        np.testing.assert_allclose(
            [by_name["shoulder"], by_name["elbow"], by_name["slide"]],
            expected,
            atol=1e-15,
        )


def test_violations(robot):
    """A slider that passes through the base, then joints outside their limits."""
    _, plant, scene_graph = robot
    referee = Referee(plant, scene_graph, [["slider", "base"], ["hand", "base"]])
    place = {name: i for i, name in enumerate(referee.joint_names)}
    q = np.zeros((6, 3))
    q[:, place["slide"]] = [0.29, 0.1, -0.05, 0.29, 0.3 + 5e-7, 0.3 + 5e-6]
    q[:, place["shoulder"]] = [0, 0, 0.6, 0.75, 0, 0]
    d = np.array([referee.distances(sample) for sample in q])
    penetrating = d < 0
    assert penetrating[1:3, 0].all() and not penetrating[[0, 3, 4, 5]].any()

    found = referee.violations(q)
    assert found.num_samples == 6
    assert found.num_penetrating == 2
    assert found.num_beyond_limit == 3  # 2, 3 and 5; not 4, within the tolerance
    assert found.num_violated == 4
    np.testing.assert_array_equal(found.count, penetrating.sum(1) + [0, 0, 1, 1, 0, 1])
    assert found.smallest_distance == d.min()
    assert found.smallest_distance_pair == ("slider", "base")
    assert found.largest_limit_excess == pytest.approx(0.25)
    assert found.largest_limit_excess_joint == "shoulder"


def test_speeds_are_counted_apart(robot):
    """Shoulder and slide have a limit of 1; the elbow states none."""
    _, plant, scene_graph = robot
    referee = Referee(plant, scene_graph, [["slider", "base"]])
    place = {name: i for i, name in enumerate(referee.velocity_names)}
    assert sorted(place) == ["elbow", "shoulder", "slide"]
    q, v = np.zeros((5, 3)), np.zeros((5, 3))
    q[:, referee.joint_names.index("slide")] = 0.29
    v[:, place["elbow"]] = 1e6
    v[:, place["shoulder"]] = [1.0, -1.5, 0.0, 1.0 + 5e-7, -1.0 - 5e-6]
    v[:, place["slide"]] = [0.0, 0.0, 1.25, 0.0, 0.0]
    found = referee.violations(q, v)
    assert found.num_beyond_speed == 3  # 1, 2 and 4; not 3, within the tolerance
    assert found.largest_speed_excess == pytest.approx(0.5)
    assert found.largest_speed_excess_joint == "shoulder"
    assert found.num_violated == 0 and not found.count.any()
    # Without velocities nothing is said of them, and all else is the same.
    silent = referee.violations(q)
    assert silent.num_beyond_speed is None
    assert silent.largest_speed_excess_joint is None
    assert silent.smallest_distance == found.smallest_distance


def test_speed_limits_of_the_callers_choice(robot):
    _, plant, scene_graph = robot
    limits = np.array([2.0, np.inf, 0.5])
    referee = Referee(plant, scene_graph, [], limits)
    v = np.array([[2.0, 9.0, -0.5], [0.0, -9.0, 0.75]])
    np.testing.assert_array_equal(
        [referee.speed_excess(row) for row in v], [[0, 0, 0], [0, 0, 0.25]]
    )
    found = referee.violations(np.zeros((2, 3)), v)
    assert found.num_beyond_speed == 1
    assert found.largest_speed_excess_joint == referee.velocity_names[2]


def test_the_faster_direction_may_have_a_limit_of_its_own():
    _, plant, scene_graph = build(finalize=False)
    shoulder = plant.GetJointByName("shoulder")
    shoulder.set_velocity_limits([-0.5], [2.0])
    plant.GetJointByName("slide").set_velocity_limits([0.0], [0.0])  # none is stated
    plant.Finalize()
    referee = Referee(plant, scene_graph, [])
    v = np.zeros(3)
    v[referee.velocity_names.index("slide")] = 7.0
    for speed, excess in ((2.0, 0.0), (2.5, 0.5), (-0.5, 0.0), (-0.75, 0.25)):
        v[shoulder.velocity_start()] = speed
        assert referee.speed_excess(v).tolist() == [
            excess if i == shoulder.velocity_start() else 0.0 for i in range(3)
        ]


def test_penetration_begins_at_zero_distance(robot):
    _, plant, scene_graph = robot
    referee = Referee(plant, scene_graph, [["slider", "base"]])

    def positions(slide):
        q = np.zeros(3)
        q[referee.joint_names.index("slide")] = slide
        return q

    touch = brentq(lambda x: referee.distances(positions(x))[0], 0.1, 0.29, xtol=1e-14)
    found = referee.violations(
        np.array([positions(touch + 1e-9), positions(touch - 1e-9)])
    )
    np.testing.assert_array_equal(found.count, [0, 1])
    assert found.smallest_distance == pytest.approx(0.0, abs=1e-8)


def test_a_clean_trajectory_without_pairs(robot):
    _, plant, scene_graph = robot
    found = Referee(plant, scene_graph, []).violations(np.zeros((2, 3)))
    assert found.num_violated == 0
    assert found.smallest_distance == math.inf
    assert found.smallest_distance_pair is None
    assert found.largest_limit_excess == 0.0
    assert found.largest_limit_excess_joint is None


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        (["hand", "can"], "can.*is a Cylinder"),
        (["hand", "bare"], "'bare'.*no collision geometry"),
        (["hnad", "base"], "'hnad'.*did you mean 'hand'"),
    ],
)
def test_refused_pairs(robot, pair, message):
    _, plant, scene_graph = robot
    with pytest.raises(ModelError, match=message):
        Referee(plant, scene_graph, [pair])


def test_refused_plants():
    _, plant, scene_graph = build(finalize=False)
    with pytest.raises(ModelError, match="Finalize"):
        Referee(plant, scene_graph, PAIRS)
    alone = MultibodyPlant(0.0)
    alone.Finalize()
    with pytest.raises(ModelError, match="registered"):
        Referee(alone, scene_graph, [])


def test_refused_positions(referee):
    with pytest.raises(ValueError, match=r"q must be \(3,\), not \(2,\)"):
        referee.distances(np.zeros(2))
    with pytest.raises(ValueError, match="T > 0"):
        referee.violations(np.zeros((0, 3)))
    q = np.zeros((4, 3))
    q[2, referee.joint_names.index("elbow")] = np.nan
    with pytest.raises(ValueError, match="'elbow' is nan"):
        referee.violations(q)


def test_refused_velocities(robot, referee):
    _, plant, scene_graph = robot
    q, v = np.zeros((4, 3)), np.zeros((4, 3))
    with pytest.raises(ValueError, match=r"v_trajectory must be \(4, nv\)"):
        referee.violations(q, v[:3])
    with pytest.raises(ValueError, match=r"v must be \(3,\), not \(2,\)"):
        referee.violations(q, v[:, :2])
    v[2, referee.velocity_names.index("slide")] = np.nan
    with pytest.raises(ValueError, match="velocity of joint 'slide' is nan"):
        referee.violations(q, v)
    for limits in (np.ones(2), np.array([1.0, np.nan, 1.0])):
        with pytest.raises(ValueError, match="velocity_limits must be"):
            Referee(plant, scene_graph, [], limits)
