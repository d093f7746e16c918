"""A slide on a turning joint takes its shape farther than its limits say.

A turning joint about z carries a slide along x, which carries a ball; a post stands
where the ball would come by. Prescribed slides are not kept within their limits, and a
controlled one may begin beyond them. The judge here is the plane's own trigonometry.
"""

import numpy as np
import pytest
from small_robots import make_model

from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters, PaperGains
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

AT, BALL, POST = 0.1, 0.02, 0.01  # the slide's place and both radii [m]
FLOOR = 4e-3  # [m]


def swing(post_at: float, limits: str, prescribed: bool) -> ControlModel:
    """A post stands at x = post_at, upright."""
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
        'ixz="0" iyz="0"/></inertial>'
    )

    def joint(name: str, kind: str, parent: str, child: str, rest: str) -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/>{rest}</joint>'
        )

    def actuated(name: str) -> str:
        return (
            "<transmission><type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{name}"/><actuator name="{name}"/></transmission>'
        )

    urdf = (
        '<robot name="swing"><link name="base"/>'
        f'<link name="arm">{inertia}</link><link name="ball">{inertia}<collision>'
        f'<geometry><sphere radius="{BALL}"/></geometry></collision></link>'
        f'<link name="post"><collision><geometry><capsule radius="{POST}" length="2"/>'
        "</geometry></collision></link>"
        + joint(
            *("turn", "revolute", "base", "arm"),
            '<axis xyz="0 0 1"/><limit lower="-3" upper="3"/>',
        )
        + joint(
            *("slide", "prismatic", "arm", "ball"),
            f'<origin xyz="{AT} 0 0"/><axis xyz="1 0 0"/>{limits}',
        )
        + joint("stands", "fixed", "base", "post", f'<origin xyz="{post_at} 0 0"/>')
        + actuated("turn")
        + actuated("slide")
        + "</robot>"
    )
    return make_model(
        urdf,
        [Task(kind="joint", joint="turn")],
        time_step=1e-3,
        prescribed_joints={"slide": "hold"} if prescribed else {},
        pairs=[["ball", "post"]],
    )


def least_on(q: np.ndarray, end: np.ndarray, post_at: float) -> float:
    """The smallest distance on the straight way between two configurations [m]."""
    along = np.linspace(0.0, 1.0, 2001)[:, None]
    turn, slide = (q + along * (end - q)).T
    radius = AT + slide
    away = np.hypot(radius * np.cos(turn) - post_at, radius * np.sin(turn))
    return away.min() - BALL - POST


CASES = {
    "prescribed, far": (2.0, True, lambda time: 2.0),
    "prescribed, driven": (0.6, True, lambda time: min(0.6, 0.6 * time)),
    "controlled, beyond": (2.0, False, None),
}


@pytest.mark.parametrize("limits", ['<limit lower="-0.1" upper="0.1"/>', ""])
@pytest.mark.parametrize("nominal", [None, PaperGains()], ids=["plan", "paper"])
@pytest.mark.parametrize("period", [0.005, 0.02])
@pytest.mark.parametrize("case", CASES)
def test_a_slide_takes_nothing_into_what_it_reaches(case, period, nominal, limits):
    q_post, prescribed, way = CASES[case]
    post_at = AT + q_post
    model = swing(post_at, limits, prescribed)
    gains = LookaheadParameters(period=period, blend_time=0.0, nominal=nominal)
    law = ControlLaw(model, gains)
    T = law.parameters.T
    # Beside the post by 3 cm, or where it will be when the slide is there.
    slide = way(0.0) if way else q_post
    q = np.array([2.0 * np.arcsin((0.03 + BALL + POST) / 2 / post_at), slide])
    v, least, nearest, turned = np.zeros(2), np.inf, np.inf, []
    for step in range(round(3.0 / period)):
        target = np.array([0.5 * np.cos(6.0 * step * period), 0.0, 0.0])
        told = np.zeros(0)
        if prescribed:
            rate = (way((step + 1) * period) - way(step * period)) / period
            told = np.array([q[1], rate, (rate - v[1]) / period])
        answer = law.step(q, v, target, told)
        _, _, clearance, clear = answer.admission
        path = least_on(q, q + T * v, post_at)
        assert path >= FLOOR - 1e-9 or not clear
        after = answer.position_command
        least = min(least, path, least_on(q, after[:2], post_at))
        q, v = after[:2], after[2:]
        # What the port says of the next path is a bound.
        assert clearance <= least_on(q, q + T * v, post_at) + 1e-12
        nearest = min(nearest, least_on(q, q, post_at))
        turned.append(q[0])
    assert least >= FLOOR - 1e-9
    # It came by, unless the slide that was free to get out of the way did.
    assert nearest < 0.035 if prescribed else np.ptp(turned) > 0.5
