"""The hulls of the real meshes judge what the capsules are for."""

import numpy as np
import pytest
import trimesh

from crar_drake.errors import ModelError
from crar_drake.results.hull_judge import HullJudge, has_hulls
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks


@pytest.fixture(scope="module")
def judge(imported) -> HullJudge:
    return HullJudge(load_robot_description(imported.folder))


@pytest.fixture(scope="module")
def model(imported) -> ControlModel:
    description = load_robot_description(imported.folder)
    return ControlModel.FromDescription(description, position_tasks(["left_wrist"]))


def corners(model: ControlModel, q: np.ndarray, link: str, local) -> np.ndarray:
    context = model.plant.CreateDefaultContext()
    model.plant.SetPositions(context, q)
    X = model.plant.GetBodyByName(link).EvalPoseInWorld(context)
    return (X.rotation().matrix() @ np.asarray(local).T).T + X.translation()


def test_distance_of_two_boxes(judge, model, imported):
    """Against distances of points sampled on the same boxes, hand and trunk."""
    pair = judge.pairs.index(("torso", "left_arm_hand"))
    files = {
        link: sorted((imported.folder / "hulls").glob(f"{link}_*.obj"))
        for link in ("torso", "left_arm_hand")
    }
    rng = np.random.default_rng(0)
    q = model.rest_positions()
    while not 0.0 < judge.distances(q)[pair] < np.inf:
        q[model.controlled] = rng.uniform(-1.0, 1.0, model.n)
    points = {
        link: np.concatenate(
            [
                corners(
                    model,
                    q,
                    link,
                    trimesh.sample.sample_surface(trimesh.load_mesh(f), 1500, seed=0)[
                        0
                    ],
                )
                for f in paths
            ]
        )
        for link, paths in files.items()
    }
    gaps = np.linalg.norm(
        points["torso"][:, None] - points["left_arm_hand"][None], axis=2
    )
    d = judge.distances(q)[pair]
    assert 0.0 < d <= gaps.min() + 1e-9
    assert gaps.min() - d < 0.02


def test_a_hand_in_the_trunk_is_seen(judge, model):
    q = model.rest_positions()
    inside = q.copy()
    for name, value in (("left_arm_1", -0.4), ("left_arm_2", -1.1)):
        inside[model.plant.GetJointByName(name).position_start()] = value
    verdict = judge.judge(np.array([q, inside]))
    assert verdict.num_samples == 2 and verdict.num_penetrating == 1
    assert verdict.smallest_distance < 0.0
    assert "torso" in verdict.smallest_distance_pair
    assert judge.judge(q[None]).num_penetrating == 0


def test_robots_that_were_not_imported_have_none():
    description = load_robot_description("upper_body")
    assert not has_hulls(description)
    with pytest.raises(ModelError, match="import-robot"):
        HullJudge(description)
