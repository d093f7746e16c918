"""Draws a robot: `python models/render_picture.py models/upper_body/robot.yaml`.

One panel shows the robot in its rest posture; each `--pose` adds a panel beside
it, with the named joints moved from there:

    python models/render_picture.py models/upper_body/robot.yaml \\
        --pose "left_shoulder_roll=2.2 left_elbow=-0.9" --out picture.png

It needs no display: Drake's VTK renderer works off screen.
"""

import argparse
from pathlib import Path

import matplotlib.image
import numpy as np
from pydrake.geometry import (
    Box,
    ClippingRange,
    ColorRenderCamera,
    GeometryInstance,
    LightParameter,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from crar_drake.files import whole_file
from crar_drake.robot.description import add_robot, load_robot_description

_FLOOR = np.array([0.80, 0.85, 0.87])
_OVERSAMPLING = 3  # the picture is rendered larger and averaged: smooth edges


def _set_posture(
    plant: MultibodyPlant, context: Context, posture: dict[str, float]
) -> None:
    q = plant.GetPositions(context)
    for name, value in posture.items():
        q[plant.GetJointByName(name).position_start()] = value
    plant.SetPositions(context, q)


def look_from(
    yaw: float, pitch: float, distance: float, target: np.ndarray
) -> RigidTransform:
    """X_WC of a camera that looks at a point; z is its viewing axis.

    Args:
        yaw, pitch: azimuth about world z and elevation of the camera as seen from
            the point [rad]; yaw 0 is on the +x axis.
        distance: from the point [m].
        target: (3,) the point [m].
    """
    direction = np.array(
        [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
    )
    z = -direction
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return RigidTransform(
        RotationMatrix(np.column_stack([x, np.cross(z, x), z])),
        target + distance * direction,
    )


def render(
    description: Path,
    pose: dict[str, float],
    size: tuple[int, int],
    target: np.ndarray,
    distance: float,
    yaw: float,
    pitch: float,
) -> np.ndarray:
    """Returns one panel, (height, width, 3) in [0, 1].

    Args:
        description: path of a robot.yaml.
        pose: joint -> value [rad or m], on top of the rest posture.
        size: width and height in pixels.
        target: the point looked at, in world [m], (3,).
        distance: from the camera to `target` [m].
        yaw: the camera's azimuth about world z [rad]; 0 is on the +x axis.
        pitch: the camera's elevation [rad].
    """
    robot = load_robot_description(description)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    add_robot(plant, robot)
    plant.Finalize()

    # Key, fill, from above, and from the camera, whose shadows nobody sees.
    lights, irradiance = [], 0.0
    for d_yaw, elevation, intensity in (
        (0.70, 0.95, 0.50),
        (-0.80, 0.70, 0.26),
        (0.0, np.pi / 2 - 0.01, 0.34),
        (0.0, pitch, 0.46),
    ):
        irradiance += intensity * np.sin(elevation)
        towards_light = look_from(yaw + d_yaw, elevation, 1.0, np.zeros(3))
        lights.append(
            LightParameter(
                type="directional",
                frame="world",
                direction=-towards_light.translation(),
                intensity=intensity,
            )
        )
    scene_graph.AddRenderer(
        "vtk",
        MakeRenderEngineVtk(
            RenderEngineVtkParams(
                # The floor's own colour, so that no horizon shows.
                default_clear_color=np.minimum(irradiance * _FLOOR, 1.0),
                lights=lights,
                cast_shadows=True,
                shadow_map_size=4096,
            )
        ),
    )
    floor = GeometryInstance(RigidTransform([0, 0, -0.05]), Box(60, 60, 0.1), "floor")
    properties = PerceptionProperties()
    properties.AddProperty("phong", "diffuse", Rgba(*_FLOOR, 1))
    floor.set_perception_properties(properties)
    source = scene_graph.RegisterSource("picture")
    scene_graph.RegisterAnchoredGeometry(source, floor)

    width, height = (_OVERSAMPLING * pixels for pixels in size)
    core = RenderCameraCore(
        "vtk",
        CameraInfo(width=width, height=height, fov_y=np.deg2rad(26)),
        ClippingRange(0.05, 60.0),
        RigidTransform(),
    )
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    _set_posture(
        plant,
        plant.GetMyMutableContextFromRoot(context),
        {**robot.rest_posture, **pose},
    )
    query = scene_graph.get_query_output_port().Eval(
        scene_graph.GetMyContextFromRoot(context)
    )
    image = query.RenderColorImage(
        ColorRenderCamera(core),
        scene_graph.world_frame_id(),
        look_from(yaw, pitch, distance, target),
    )
    pixels = image.data[:, :, :3].astype(float) / 255.0
    blocks = pixels.reshape(size[1], _OVERSAMPLING, size[0], _OVERSAMPLING, 3)
    return blocks.mean(axis=(1, 3))


def _pose(text: str) -> dict[str, float]:
    try:
        pairs = (item.split("=") for item in text.replace(",", " ").split())
        return {name: float(value) for name, value in pairs}
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f'a pose is "joint=value joint=value ...", not {text!r}'
        ) from error


def main() -> None:
    """Reads the command line and writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", type=Path, help="path of a robot.yaml")
    parser.add_argument("--out", type=Path, help="default: picture.png beside it")
    parser.add_argument("--pose", type=_pose, action="append", default=[])
    parser.add_argument("--size", type=int, nargs=2, default=(460, 600))
    parser.add_argument("--target", type=float, nargs=3, default=(0, 0, 0.68))
    parser.add_argument("--distance", type=float, default=3.4, help="metres")
    parser.add_argument("--yaw", type=float, default=35.0, help="degrees")
    parser.add_argument("--pitch", type=float, default=15.0, help="degrees")
    options = parser.parse_args()
    if not options.robot.is_file():
        parser.error(f"there is no robot description {options.robot}")
    panels = [
        render(
            options.robot,
            pose,
            tuple(options.size),
            np.array(options.target, dtype=float),
            options.distance,
            np.deg2rad(options.yaw),
            np.deg2rad(options.pitch),
        )
        for pose in [{}, *options.pose]
    ]
    out = options.out or options.robot.parent / "picture.png"
    with whole_file(out) as temporary:
        matplotlib.image.imsave(temporary, np.clip(np.hstack(panels), 0.0, 1.0))
    print(f"wrote {out} ({out.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
