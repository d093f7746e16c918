"""MJCF texts for the tests of the import."""

from pathlib import Path

# A mesh without any symmetry, so that a turned one is noticed.
WEDGE = """\
v 0 0 0
v 1 0 0
v 0 1 0
v 0.2 0.3 1
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""

# Everything that decides where a body is and what it weighs, but for the joints'
# references; the forearm's piece is in another file.
FEATURES = """\
<mujoco model="features">
  <compiler angle="radian" eulerseq="zyx" meshdir="meshes"/>
  <default>
    <joint damping="0.5"/>
    <default class="arm">
      <joint axis="0 1 0" range="-1 2" limited="true"/>
      <geom rgba="0.2 0.4 0.8 1" density="700"/>
      <default class="seen"><geom contype="0" conaffinity="0" group="2"/></default>
      <default class="hit"><geom group="3" rgba="1 0 0 1"/></default>
    </default>
  </default>
  <asset>
    <mesh name="wedge" file="wedge.obj" scale="0.1 0.2 0.3"/>
    <material name="green" rgba="0 1 0 1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <inertial pos="0.01 0 0.02" mass="3"
                fullinertia="0.03 0.04 0.05 0.001 0.002 0.003"/>
      <geom type="box" size="0.1 0.2 0.05" material="green"/>
      <body name="turned" pos="0.1 0.2 0.3" euler="0.1 0.2 0.3" childclass="arm">
        <inertial pos="0 0.1 0" quat="0.9 0.1 0.2 0.3" mass="2"
                  diaginertia="0.01 0.02 0.025"/>
        <joint name="turn" pos="0.01 0.02 0.03"/>
        <joint name="slide" type="slide" axis="1 1 0" range="-0.1 0.2"/>
        <joint name="twist" axis="0 0 2" limited="false"/>
        <geom class="seen" type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.03"/>
        <body name="angled" pos="0 0 0.2" axisangle="1 2 3 0.7">
          <joint name="bend" class="arm" damping="2"/>
          <geom class="hit" type="cylinder" size="0.02 0.1" pos="0 0 0.1"/>
          <geom class="hit" type="sphere" size="0.03"/>
          <include file="forearm.xml"/>
        </body>
      </body>
      <body name="axes" pos="0 -0.2 0" xyaxes="0 1 0 -1 0 0.2">
        <joint name="side" axis="1 0 0"/>
        <geom type="box" size="0.02 0.03 0.04" euler="0.3 0 0.1"/>
        <body name="zaxis" zaxis="1 1 1">
          <geom type="ellipsoid" size="0.02 0.03 0.04"/>
          <site name="tool" pos="0 0 0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="turn" gear="40" ctrlrange="-1 0.5" ctrllimited="true"/>
    <general joint="bend" gear="2" forcerange="-7 9" forcelimited="true"
             gaintype="fixed" biastype="affine" gainprm="100" biasprm="0 -100 0"/>
    <position joint="side" kp="10"/>
  </actuator>
</mujoco>
"""

FOREARM = """\
<mujocoinclude>
  <body name="forearm" pos="0 0 0.3">
    <joint name="wrist" axis="1 0 0"/>
    <geom class="seen" type="mesh" mesh="wedge" pos="0.01 0.02 0.03"/>
  </body>
</mujocoinclude>
"""


def write_features(folder: Path, text: str = FEATURES) -> Path:
    """Writes the features with what they include and returns the path."""
    (folder / "meshes").mkdir()
    (folder / "meshes" / "wedge.obj").write_text(WEDGE)
    (folder / "forearm.xml").write_text(FOREARM)
    path = folder / "features.xml"
    path.write_text(text)
    return path


def mjcf(bodies: str, more: str = "", compiler: str = "") -> str:
    """A model of these bodies in the world, e.g. of `body`; `more` is beside them."""
    return (
        f'<mujoco model="small">{compiler}<worldbody>{bodies}</worldbody>{more}'
        "</mujoco>"
    )


def body(name: str, inside: str = "", joint: str = '<joint name="{}_joint"/>') -> str:
    """A body of a ball, with a hinge, and what is inside of it."""
    return (
        f'<body name="{name}" pos="0 0 0.2">{joint.format(name)}'
        f'<geom size="0.05"/>{inside}</body>'
    )


def humanoid() -> str:
    """The humanoid of `small_urdfs`, as far as its arms go, with a free joint."""
    parts = []
    for side, y in (("left", 1), ("right", -1)):
        arm = f"{side}_arm"
        parts.append(f"""
<body name="{arm}_pitch" pos="0 {0.2 * y} 0.4">
  <joint name="{arm}_1" axis="0 1 0" range="-90 90"/>
  <geom size="0.02"/>
  <body name="{arm}_roll"><joint name="{arm}_2" axis="1 0 0" range="-90 90"/>
    <geom size="0.02"/>
    <body name="{arm}_upper"><joint name="{arm}_3" axis="0 0 1" range="-90 90"/>
      <geom type="cylinder" size="0.04 0.08" pos="0 0 -0.12"/>
      <body name="{arm}_fore" pos="0 0 -0.25">
        <joint name="{arm}_4" axis="0 1 0" range="-120 0"/>
        <geom type="cylinder" size="0.03 0.08" pos="0 0 -0.12"/>
        <body name="{arm}_wrist" pos="0 0 -0.25">
          <joint name="{arm}_5" axis="0 0 1" range="-90 90"/><geom size="0.02"/>
          <body name="{arm}_hand"><joint name="{arm}_6" axis="1 0 0" range="-90 90"/>
            <geom type="box" size="0.025 0.015 0.06" pos="0 0 -0.07"/>
          </body></body></body></body></body></body>""")
    for side, y in (("left", 1), ("right", -1)):
        legs = f"""
<body name="{side}_leg" pos="0 {0.08 * y} -0.1">
  <joint name="{side}_hip" axis="0 1 0" range="-90 90"/>
  <geom type="cylinder" size="0.05 0.33" pos="0 0 -0.37"/>
</body>"""
        parts.append(legs)
    arms, legs = "".join(parts[:2]), "".join(parts[2:])
    return mjcf(
        f"""
<geom type="plane" size="1 1 1"/>
<body name="pelvis" pos="0 0 0.8"><freejoint/>
  <geom type="box" size="0.08 0.12 0.08"/>
  {legs}
  <body name="torso"><joint name="waist_yaw" axis="0 0 1" range="-90 90"/>
    <geom type="box" size="0.08 0.12 0.15" pos="0 0 0.28"/>
    <body name="head" pos="0 0 0.56"><joint name="neck" axis="0 0 1" range="-1 1"/>
      <geom size="0.09"/></body>
    {arms}
  </body>
</body>""",
        '<actuator><motor joint="waist_yaw" gear="50" ctrlrange="-1 1"/></actuator>',
    )
