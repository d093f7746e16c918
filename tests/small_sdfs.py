"""SDF texts for the tests of the import."""

from pathlib import Path

import numpy as np

# A wedge without any symmetry, in a format that Drake takes for no collision.
STL = """\
solid wedge
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0.2 0.3 1
endloop
endfacet
facet normal 1 1 0
outer loop
vertex 1 0 0
vertex 0 1 0
vertex 0.2 0.3 1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 0 1 0
vertex 0 0 0
vertex 0.2 0.3 1
endloop
endfacet
endsolid wedge
"""

WEDGE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.3, 1]])

# All that decides where a link is, of what a joint turns about, what it weighs and
# how it looks; the gripper is another file.
FEATURES = """\
<?xml version="1.0"?>
<sdf version="1.9" xmlns:drake="http://drake.mit.edu">
  <model name="features" canonical_link="base">
    <pose>0.3 0.2 1 0 0 0</pose>
    <!-- <mesh><uri>model://nowhere/old.stl</uri></mesh> -->
    <link name="base">
      <inertial>
        <pose>0.01 0.02 0.03 0.1 0.2 0.3</pose>
        <mass>3</mass>
        <inertia>
          <ixx>0.03</ixx><iyy>0.04</iyy><izz>0.05</izz>
          <ixy>0.001</ixy><ixz>0.002</ixz><iyz>0.003</iyz>
        </inertia>
      </inertial>
      <visual name="look">
        <geometry><box><size>0.2 0.4 0.1</size></box></geometry>
        <material><diffuse>0 1 0 1</diffuse></material>
      </visual>
      <visual name="ground"><geometry><plane/></geometry></visual>
    </link>
    <frame name="shoulder" attached_to="base"><pose>0 0.1 0.2 0.3 0 0.1</pose></frame>
    <frame name="grip" attached_to="wrist"><pose>0 0 0.05 0 0 0</pose></frame>
    <link name="upper">
      <pose relative_to="shoulder">0.05 0 0.1 0 0.4 0</pose>
      <collision name="hull">
        <pose relative_to="upper">0.01 0.02 0.03 0 0 1.5707963267948966</pose>
        <geometry>
          <mesh><uri>meshes/wedge.stl</uri><scale>0.1 -0.2 0.3</scale></mesh>
        </geometry>
        <surface><friction><ode><mu>1</mu></ode></friction></surface>
        <max_contacts>3</max_contacts>
      </collision>
    </link>
    <link name="wrist">
      <pose relative_to="upper">0 0 0.3 0 0 0.2</pose>
      <visual name="look"><geometry><capsule>
        <radius>0.03</radius><length>0.1</length></capsule></geometry></visual>
      <collision name="look"><geometry><sphere>
        <radius>0.04</radius></sphere></geometry></collision>
    </link>
    <joint name="beside" type="revolute">
      <pose>0.02 0.03 -0.1 0.3 0 0</pose>
      <parent>base</parent><child>upper</child>
      <axis>
        <xyz expressed_in="__model__">1 1 0</xyz>
        <limit>
          <lower>-1</lower><upper>2</upper><effort>30</effort><velocity>4</velocity>
        </limit>
        <dynamics><damping>0.5</damping></dynamics>
      </axis>
    </joint>
    <joint name="slide" type="prismatic">
      <pose>0 0.2 0 0 0.7 0</pose>
      <parent>upper</parent><child>wrist</child>
      <axis>
        <xyz>0 1 1</xyz><limit><lower>-0.1</lower><upper>0.2</upper></limit>
      </axis>
    </joint>
    <include>
      <uri>model://gripper/hand.sdf</uri>
      <name>hand</name>
      <pose relative_to="wrist">0 0 0.1 0 0 0.5</pose>
    </include>
    <joint name="mount" type="fixed">
      <parent>wrist</parent><child>hand::base</child>
    </joint>
  </model>
</sdf>
"""

GRIPPER = """\
<sdf version="1.7">
  <model name="gripper">
    <link name="base">
      <visual name="look">
        <geometry><mesh><uri>wedge.stl</uri></mesh></geometry>
      </visual>
    </link>
    <link name="left"><pose>0 0.05 0 0 0 0</pose></link>
    <link name="right"><pose>0 -0.05 0 0 0 0</pose></link>
    <joint name="left_slide" type="prismatic">
      <parent>base</parent><child>left</child>
      <axis><xyz>0 1 0</xyz><limit><lower>0</lower><upper>0.05</upper></limit></axis>
    </joint>
    <joint name="right_turn" type="continuous">
      <parent>base</parent><child>right</child>
      <axis>
        <xyz>0 0 1</xyz>
        <mimic joint="left_slide">
          <multiplier>-2</multiplier><offset>0.1</offset><reference>0.02</reference>
        </mimic>
      </axis>
    </joint>
  </model>
</sdf>
"""

CONFIG = '<model><name>gripper</name><sdf version="1.7">hand.sdf</sdf></model>'


def write_features(folder: Path, text: str = FEATURES) -> Path:
    """Writes the file with all features, its mesh, and the model that it includes."""
    (folder / "meshes").mkdir()
    (folder / "gripper").mkdir()
    (folder / "meshes" / "wedge.stl").write_text(STL)
    (folder / "gripper" / "wedge.stl").write_text(STL)
    (folder / "gripper" / "hand.sdf").write_text(GRIPPER)
    (folder / "gripper" / "model.config").write_text(CONFIG)
    path = folder / "features.sdf"
    path.write_text(text)
    return path


def link(name: str, pose: str = "0 0 0 0 0 0") -> str:
    """A link with a mass and a sphere."""
    return (
        f'<link name="{name}"><pose>{pose}</pose><inertial><mass>2</mass><inertia>'
        "<ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia></inertial>"
        '<visual name="look"><geometry><sphere><radius>0.05</radius></sphere>'
        "</geometry></visual></link>"
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute") -> str:
    """A joint about the child's z axis."""
    return (
        f'<joint name="{name}" type="{kind}"><parent>{parent}</parent>'
        f"<child>{child}</child><axis><xyz>0 0 1</xyz><limit><lower>-1</lower>"
        "<upper>1</upper></limit></axis></joint>"
    )


def model(*parts: str, name: str = "small") -> str:
    """A model."""
    return f'<model name="{name}">{"".join(parts)}</model>'


def sdf(*parts: str) -> str:
    """A file."""
    return f'<sdf version="1.9">{"".join(parts)}</sdf>'
