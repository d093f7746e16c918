"""A ball that slides in a plane between posts: all distances are known by hand."""

from collections.abc import Sequence

from small_robots import make_model

from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

BOTH = 2e-3  # the radii of ball and post [m]


def among_posts(
    posts: Sequence[Sequence[float]], time_step: float = 1e-3, radius: float = BOTH / 2
) -> ControlModel:
    """`slider` along y on `x` along x, its two positions its place, and posts (x, y),
    balls as it is, welded to `base`."""
    shape = f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>'
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" '
        'ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    text = '<robot name="ball"><link name="base"/>'
    text += f'<link name="x">{inertia}</link><link name="slider">{inertia}{shape}'
    text += "</link>"
    for name, parent, child, axis in (
        ("along_x", "base", "x", "1 0 0"),
        ("along_y", "x", "slider", "0 1 0"),
    ):
        text += (
            f'<joint name="{name}" type="prismatic"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-9" upper="9"/></joint>'
            "<transmission><type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{name}"><hardwareInterface>EffortJointInterface'
            f'</hardwareInterface></joint><actuator name="{name}"/></transmission>'
        )
    for k, (x, y) in enumerate(posts):
        text += (
            f'<link name="post{k}">{shape}</link><joint name="weld{k}" type="fixed">'
            f'<parent link="base"/><child link="post{k}"/>'
            f'<origin xyz="{x} {y} 0"/></joint>'
        )
    return make_model(
        text + "</robot>",
        [Task(frame="slider")],
        time_step=time_step,
        pairs=[["slider", f"post{k}"] for k in range(len(posts))],
    )
