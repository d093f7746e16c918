"""A robot's own URDF: where it is, what is in it, and what of it is not supported."""

from __future__ import annotations

import importlib.metadata
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from crar_drake.errors import ModelError
from crar_drake.nearest import nearest

# How an import names a URDF of that package, wherever it is installed.
PACKAGE_SCHEME = "example-robot-data:"

WORLD = "world"  # the link that Drake takes for its own world

_MOVING = ("revolute", "continuous", "prismatic")
# Names of files and folders that many robots share.
_SAYS_NOTHING = (
    *("model", "robot", "main", "scene", "urdf", "mjcf", "xml", "xmls"),
    *("robots", "description", "models"),
)
# Drake's elements that close a chain, which the controller's model has no part for.
_LOOPS = (
    "drake:linear_bushing_rpy",
    "drake:ball_constraint",
    "drake:tendon_constraint",
    "loop_joint",
)


@dataclass(frozen=True)
class Mesh:
    """A mesh file and the scale that the URDF gives it."""

    path: Path
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Shape:
    """A visual or collision element of a link.

    Attributes:
        X_LG: pose of the geometry in the link's frame.
        mesh: the mesh; None for a primitive.
        kind: "mesh", "triangles", "box", "cylinder", "sphere", "capsule" or
            "ellipsoid".
        size: a box's edges, or (radius, length), or (radius,), or an ellipsoid's
            semi-axes [m].
        rgba: colour; None if the file has none.
        triangles: vertices (N, 3) [m] and faces (M, 3) of a mesh that was read
            already.
    """

    X_LG: RigidTransform
    kind: str
    mesh: Mesh | None = None
    size: tuple[float, ...] = ()
    rgba: tuple[float, ...] | None = None
    triangles: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True)
class Link:
    """A link with its shapes and its inertial element, if there is one."""

    name: str
    visual: tuple[Shape, ...]
    collision: tuple[Shape, ...]
    inertial: ElementTree.Element | None


@dataclass(frozen=True)
class Joint:
    """A joint as the file says it.

    Attributes:
        kind: as in a URDF, or "ball".
        X_PC: pose of the child link in the parent at position zero.
        axis: unit vector in the child's frame.
        lower, upper: [rad or m]; infinite if continuous.
        effort: [Nm or N]; None if there is none.
        mimic: name of the joint that it follows, "" if none, with its
        multiplier and offset [rad or m].
    """

    name: str
    kind: str
    parent: str
    child: str
    X_PC: RigidTransform
    axis: np.ndarray
    lower: float
    upper: float
    effort: float | None
    velocity: float | None
    damping: float
    mimic: str = ""
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it has a single axis to move about or along."""
        return self.kind in _MOVING

    @property
    def unit(self) -> str:
        """Of its positions: "m" or "rad"."""
        return "m" if self.kind == "prismatic" else "rad"

    def transform(self, position: float) -> RigidTransform:
        """X_PC at a position [rad or m]."""
        if self.kind == "prismatic":
            return self.X_PC @ RigidTransform(position * self.axis)
        if self.moves:
            return self.X_PC @ RigidTransform(_rotation(self.axis, position))
        return self.X_PC


@dataclass(frozen=True)
class Loop:
    """A closed chain: what ties two links together that joints are between."""

    name: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class SourceRobot:
    """A tree of links and joints, read from a URDF or an MJCF.

    Attributes:
        name: of the robot.
        path: of the file.
        links: by name, in the file's order.
        joints: by name, in the file's order.
        root: the link without a parent.
        notes: what was left out or read otherwise than it stands there.
        X_FR: pose of the root link in the frame F that all poses are given in: z
            up, x the robot's front (`facing`).
        loops: chains that the file closes; the tree has them open.
        posture: joint to position [rad or m] in a rest posture of the file's own, or of
            its SRDF.
        allowed: pairs of links that may touch by its SRDF.
    """

    name: str
    path: Path
    links: dict[str, Link]
    joints: dict[str, Joint]
    root: str
    _parents: dict[str, Joint] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    X_FR: RigidTransform = field(default_factory=RigidTransform)
    loops: tuple[Loop, ...] = ()
    posture: dict[str, float] = field(default_factory=dict)
    allowed: frozenset[frozenset[str]] = frozenset()

    def parent_joint(self, link: str) -> Joint | None:
        """The joint that carries a link; None for the root."""
        return self._parents.get(link)

    def children(self, link: str) -> list[Joint]:
        """The joints that a link carries."""
        return [joint for joint in self.joints.values() if joint.parent == link]

    def is_bare(self, link: str) -> bool:
        """Whether a link has no geometry: a mere frame."""
        return not (self.links[link].visual or self.links[link].collision)

    def path_to(self, link: str) -> list[Joint]:
        """The joints from the root to a link, all kinds."""
        way: list[Joint] = []
        while (joint := self.parent_joint(link)) is not None:
            way.append(joint)
            link = joint.parent
        return way[::-1]

    def poses(self, positions: dict[str, float] | None = None) -> dict:
        """X_FL of every link L, with joints at zero or where `positions` says."""
        positions = positions or {}
        X = {self.root: self.X_FR}
        for link in self.below(self.root):
            if link != self.root:
                joint = self._parents[link]
                at = positions.get(joint.name, 0.0)
                X[link] = X[joint.parent] @ joint.transform(at)
        return X

    def below(self, link: str) -> Iterator[str]:
        """A link and everything that it carries, parents first."""
        yield link
        for joint in self.children(link):
            yield from self.below(joint.child)

    def without_world(self) -> SourceRobot | None:
        """The robot without a root link that only says where it stands.

        None where the root is not of that kind: a link named world, without
        geometry, that carries one link by a joint that is fixed or floating. If it
        carries several that are fixed to it, it gets another name instead.
        """
        joints = self.children(self.root)
        if self.root != WORLD or not self.is_bare(self.root) or not joints:
            return None
        if len(joints) > 1:
            welded = all(joint.kind == "fixed" for joint in joints)
            return self._renamed_world() if welded else None
        (joint,) = joints
        if joint.kind not in ("fixed", "floating"):
            return None
        return replace(
            self,
            links={name: v for name, v in self.links.items() if name != self.root},
            joints={name: v for name, v in self.joints.items() if v is not joint},
            root=joint.child,
            _parents={k: v for k, v in self._parents.items() if v is not joint},
        )

    def _renamed_world(self) -> SourceRobot:
        """The robot with another name of its root link."""
        name = "mount"
        while name in self.links:
            name += "_"
        joints = {
            key: replace(joint, parent=name) if joint.parent == self.root else joint
            for key, joint in self.joints.items()
        }
        others = {k: v for k, v in self.links.items() if k != self.root}
        links = {name: replace(self.links[self.root], name=name), **others}
        return replace(
            self,
            links=links,
            joints=joints,
            root=name,
            _parents={joint.child: joint for joint in joints.values()},
        )


def find_urdf(name: str | os.PathLike[str]) -> tuple[Path, str]:
    """The file of a path, of `example-robot-data:some/path`, or of a file's name there.

    Args:
        name: e.g. "robot.urdf", "robot.xml", "romeo",
            "example-robot-data:robots/…/g1.urdf".

    Returns:
        The file, and how an import file names it.

    Raises:
        ModelError: there is no such file; the message names what there is.
    """
    text = str(name)
    if Path(text).is_file():
        return Path(text).resolve(), str(Path(text).resolve())
    if not text.startswith(PACKAGE_SCHEME) and (
        "/" in text or text.endswith((".urdf", ".xacro", ".xml"))
    ):
        raise ModelError(f"no URDF or MJCF at {text}")
    folder = robot_data_folder()
    if folder is None:
        raise ModelError(
            f"no robot {text!r} without the package example-robot-data: "
            "pip install 'crar-drake[robots]', or give the path of a URDF or MJCF"
        )
    if text.startswith(PACKAGE_SCHEME):
        path = folder / text.removeprefix(PACKAGE_SCHEME)
        if not path.is_file():
            raise ModelError(
                f"the installed example-robot-data has no {path.relative_to(folder)}; "
                "install another version of it"
            )
        return path, text
    known = {path.stem: path for path in sorted(folder.glob("robots/**/*.urdf"))}
    if text not in known:
        raise ModelError(
            f"no robot {text!r}: neither a URDF nor one of the package "
            f"example-robot-data{nearest(text, known)}"
        )
    path = known[text]
    return path, PACKAGE_SCHEME + path.relative_to(folder).as_posix()


def robot_data_folder() -> Path | None:
    """Where the package example-robot-data has its files; None if not installed."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        parts = file.parts
        if "robots" in parts and file.suffix == ".urdf":
            return Path(str(file.locate())).parents[
                len(parts) - parts.index("robots") - 1
            ]
    return None


def read_urdf(path: Path, package_paths: Sequence[Path] = ()) -> SourceRobot:
    """Reads a URDF and resolves its meshes.

    Args:
        path: of the file.
        package_paths: folders that contain packages, besides those that the
            environment (ROS_PACKAGE_PATH, AMENT_PREFIX_PATH) and the file's own
            place suggest.

    Raises:
        ModelError: the file is no URDF, its links are not one tree, or a mesh or
            package is not there; the message names link, address and remedy.
    """
    try:
        root = ElementTree.fromstring(_without_prefix_errors(path))
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: not a URDF: {error}") from error
    if root.tag != "robot":
        raise ModelError(f"{path}: not a URDF: its root element is <{root.tag}>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise ModelError(
            f"{path}: it is made of macros that are not expanded; expand it with "
            f"ROS's xacro ({path.name} > robot.urdf) and import what that writes"
        )
    for tag in _LOOPS:
        element = next(root.iter(tag.replace("drake:", "_drake_")), None)
        if element is not None:
            raise ModelError(
                f"{path}: <{tag}> {element.get('name', '')!r} closes a chain, "
                "which the controller does not support; take it out of the URDF"
            )
    colours = {
        material.get("name"): _floats(colour.get("rgba"))
        for material in root.iter("material")
        if (colour := material.find("color")) is not None
    }
    meshes = _MeshFinder(path, package_paths)
    notes: list[str] = []
    links = {}
    for element in root.findall("link"):
        with _naming(path, "link", element):
            link = _read_link(element, colours, meshes, path, notes)
        if link.name in links:
            raise ModelError(f"{path}: two links are named {link.name!r}")
        links[link.name] = link
    meshes.check()
    joints = {}
    for element in root.findall("joint"):
        with _naming(path, "joint", element):
            joint = _read_joint(element, path)
        if joint.name in joints:
            raise ModelError(f"{path}: two joints are named {joint.name!r}")
        joints[joint.name] = joint
    parents = _check_tree(path, links, joints)
    (top,) = [name for name in links if name not in parents]
    if any("," in text for text in _number_texts(root)):
        notes.append(
            "numbers with commas: 1,5 was read as 1.5, and a comma before a space as "
            "nothing"
        )
    return SourceRobot(
        _robot_name(root.get("name") or "", path),
        path,
        links,
        joints,
        top,
        parents,
        tuple(notes),
    )


def default_name(path: Path) -> str:
    """What a robot is called after its file: the file's name, or where that says
    nothing (model.urdf) the folder's, or the robot element's."""
    for name in (path.stem, *(folder.name for folder in path.absolute().parents[:2])):
        if name and name.lower() not in _SAYS_NOTHING:
            return name
    try:
        root = ElementTree.fromstring(_without_prefix_errors(path))
        name = root.get("name") or root.get("model")
    except (ElementTree.ParseError, UnicodeDecodeError, OSError):
        name = None  # it is refused where it is read
    return (name or path.stem).replace("/", "_").replace(" ", "_")


def _robot_name(name: str, path: Path) -> str:
    return default_name(path) if name.lower() in ("", *_SAYS_NOTHING) else name


@contextmanager
def _naming(path: Path, what: str, element: ElementTree.Element) -> Iterator[None]:
    """Numbers that are none become an error that names the element."""
    try:
        yield
    except ValueError as error:
        name = element.get("name") or ""
        raise ModelError(f"{path}: {what} {name!r}: {error}") from error


def _number_texts(root: ElementTree.Element) -> Iterator[str]:
    """The attributes that are numbers, of all elements."""
    words = ("xyz", "rpy", "size", "radius", "length", "scale", "value", "lower")
    for element in root.iter():
        for key in (*words, "upper", "effort", "velocity"):
            if (text := element.get(key)) is not None:
                yield text


def _without_prefix_errors(path: Path) -> str:
    """The file's text, readable although it may use undeclared XML prefixes."""
    text = path.read_text(encoding="utf-8")
    return text.replace("<drake:", "<_drake_").replace("</drake:", "</_drake_")


def _check_tree(path: Path, links: dict, joints: dict[str, Joint]) -> dict[str, Joint]:
    if not links:
        raise ModelError(f"{path}: it has no links")
    parents: dict[str, Joint] = {}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ModelError(
                    f"{path}: joint {joint.name!r} names the link {end!r}, which is "
                    f"not there{nearest(end, links)}"
                )
        if joint.child in parents:
            raise ModelError(
                f"{path}: link {joint.child!r} hangs on the joints "
                f"{parents[joint.child].name!r} and {joint.name!r}: a closed chain, "
                "which is not supported; remove one of them"
            )
        parents[joint.child] = joint
        if joint.mimic and joint.mimic not in joints:
            raise ModelError(
                f"{path}: joint {joint.name!r} mimics {joint.mimic!r}, which is not "
                f"there{nearest(joint.mimic, joints)}"
            )
    tops = [name for name in links if name not in parents]
    if len(tops) != 1:
        raise ModelError(
            f"{path}: the links are not one tree; these have no parent: "
            f"{', '.join(tops) or 'none (a closed chain)'}"
        )
    # A ring of joints beside the tree leaves links that no way leads to.
    seen, stack = set(), [tops[0]]
    while stack:
        link = stack.pop()
        seen.add(link)
        stack += [joint.child for joint in joints.values() if joint.parent == link]
    if lost := [name for name in links if name not in seen]:
        raise ModelError(
            f"{path}: these links form a closed chain, which is not supported: "
            f"{', '.join(lost)}"
        )
    return parents


def _read_link(element, colours, meshes, path, notes) -> Link:
    name = element.get("name") or ""
    shapes = {
        kind: tuple(
            shape
            for entry in element.findall(kind)
            if (shape := _read_shape(entry, name, colours, meshes, path, notes))
        )
        for kind in ("visual", "collision")
    }
    inertial = element.find("inertial")
    if inertial is not None:
        _check_numbers(inertial)
    return Link(name, shapes["visual"], shapes["collision"], inertial)


def _check_numbers(inertial: ElementTree.Element) -> None:
    """What is read later; ValueError where it is no number."""
    _origin(inertial)
    for element in inertial:
        for key in ("value", "ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            if (text := element.get(key)) is not None:
                one_number(text)


def _read_shape(element, link, colours, meshes, path, notes) -> Shape | None:
    geometry = element.find("geometry")
    if geometry is None or not len(geometry):
        return None
    shape = geometry[0]
    material = element.find("material")
    rgba = None
    if material is not None:
        colour = material.find("color")
        rgba = (
            _floats(colour.get("rgba"))
            if colour is not None
            else colours.get(material.get("name"))
        )
    X_LG = _origin(element)
    kind = shape.tag.removeprefix("_drake_")
    if kind == "mesh":
        scale = _three(shape.get("scale", "1 1 1"))
        if not all(scale):
            notes.append(f"link {link}: a mesh with a scale of zero is left out")
            return None
        found = meshes.find(shape.get("filename", ""), link)
        return Shape(X_LG, kind, Mesh(found, scale), rgba=rgba)
    sizes = {"box": ("size",), "sphere": ("radius",)}
    names = sizes.get(kind, ("radius", "length"))
    if kind not in ("box", "sphere", "cylinder", "capsule"):
        raise ModelError(f"{path}: link {link!r}: unknown geometry <{kind}>")
    size = tuple(v for name in names for v in _floats(shape.get(name, "")))
    if len(size) != {"box": 3, "sphere": 1}.get(kind, 2):
        raise ModelError(f"{path}: link {link!r}: <{kind}> has no valid size")
    if not min(size) > 0.0:
        notes.append(f"link {link}: a {kind} without volume is left out")
        return None
    return Shape(X_LG, kind, size=size, rgba=rgba)


def _read_joint(element, path: Path) -> Joint:
    name = element.get("name") or ""
    kind = element.get("type") or ""
    if kind not in (*_MOVING, "fixed", "floating", "planar"):
        raise ModelError(f"{path}: joint {name!r} has the unknown type {kind!r}")
    ends = {tag: element.find(tag) for tag in ("parent", "child")}
    if any(end is None for end in ends.values()):
        raise ModelError(f"{path}: joint {name!r} lacks its parent or child")
    limit = element.find("limit")
    # A weld follows nothing, whatever the file says of it.
    mimic = None if kind == "fixed" else element.find("mimic")
    dynamics, axis = element.find("dynamics"), element.find("axis")
    vector = np.array(_three(axis.get("xyz")) if axis is not None else (1, 0, 0.0))
    length = np.linalg.norm(vector)
    if kind in _MOVING and not length > 0.0:
        raise ModelError(f"{path}: joint {name!r} has an axis of no length")

    def number(of, key: str) -> float | None:
        if of is None or of.get(key) is None:
            return None
        return one_number(of.get(key))

    lower, upper = number(limit, "lower"), number(limit, "upper")
    if kind == "continuous" or lower is None or upper is None:
        lower, upper = -np.inf, np.inf
    return Joint(
        name,
        kind,
        ends["parent"].get("link", ""),
        ends["child"].get("link", ""),
        _origin(element),
        vector / length if length else vector,
        lower,
        upper,
        number(limit, "effort"),
        number(limit, "velocity"),
        number(dynamics, "damping") or 0.0,
        "" if mimic is None else mimic.get("joint", ""),
        number(mimic, "multiplier")
        if mimic is not None and mimic.get("multiplier")
        else 1.0,
        number(mimic, "offset") or 0.0,
    )


def _origin(element) -> RigidTransform:
    origin = element.find("origin")
    if origin is None:
        return RigidTransform()
    return RigidTransform(
        RollPitchYaw(_three(origin.get("rpy", "0 0 0"))),
        _three(origin.get("xyz", "0 0 0")),
    )


def _floats(text: str | None) -> tuple[float, ...]:
    """Numbers in a text, also those that were written with commas.

    "1.5 2 3", "1.5, 2, 3" and "1.5,2,3" are three numbers, "1,5" is one.
    """
    words = [word.strip(",") for word in (text or "").split()]
    numbers = []
    for word in words:
        decimal = word.count(",") == 1 and "." not in word
        pieces = [word.replace(",", ".")] if decimal else word.split(",")
        for piece in pieces:
            try:
                numbers.append(float(piece))
            except ValueError:
                raise ValueError(f"{text!r} is not made of numbers") from None
    return tuple(numbers)


def _three(text: str | None) -> tuple[float, ...]:
    numbers = _floats(text)
    if len(numbers) != 3:
        raise ValueError(f"{text!r} is not three numbers")
    return numbers


def one_number(text: str) -> float:
    """The number that an attribute is; "1,5" is 1.5. ValueError if it is none."""
    numbers = _floats(text)
    if len(numbers) != 1:
        raise ValueError(f"{text!r} is not a number")
    return numbers[0]


def vector_of(text: str) -> np.ndarray:
    """(3,) the numbers that an attribute is; ValueError if it is none."""
    return np.array(_three(text))


def _rotation(axis: np.ndarray, angle: float):
    from pydrake.common.eigen_geometry import AngleAxis
    from pydrake.math import RotationMatrix

    return RotationMatrix(AngleAxis(angle, axis))


class _MeshFinder:
    """Resolves mesh addresses, and tells all that are missing at once."""

    def __init__(self, urdf: Path, package_paths: Sequence[Path]) -> None:
        self._urdf = urdf
        variables = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
        entries = [e for v in variables for e in os.environ.get(v, "").split(":") if e]
        around = [Path(entry) for entry in entries]
        around += [path / "share" for path in around]
        self._roots = [*map(Path, package_paths), *around]
        self._missing: list[str] = []
        self._packages: set[str] = set()

    def find(self, address: str, link: str) -> Path:
        scheme, _, rest = address.rpartition("://")
        if scheme in ("package", "model"):
            package, _, inner = rest.lstrip("/").partition("/")
            folder = self._package(package)
            if folder is None:
                self._packages.add(package)
                return Path(inner)
            path = folder / inner
        else:
            path = self._urdf.parent / rest
        if not path.is_file():
            self._missing.append(f"{address} (link {link})")
        return path

    def check(self) -> None:
        if self._packages:
            raise ModelError(
                f"{self._urdf}: its meshes lie in packages that are not found: "
                f"{', '.join(sorted(self._packages))}; name the folder that contains "
                "them with --package-path (or in ROS_PACKAGE_PATH)"
            )
        if self._missing:
            shown = "; ".join(self._missing[:5])
            more = len(self._missing) - 5
            raise ModelError(
                f"{self._urdf}: meshes are missing: {shown}"
                f"{f'; and {more} more' if more > 0 else ''}"
            )

    def _package(self, name: str) -> Path | None:
        for root in self._roots:
            for folder in (root / name, root):
                if folder.is_dir() and _is_package(folder, name):
                    return folder
        for ancestor in self._urdf.parents:
            for folder in (ancestor, ancestor / name):
                if folder.is_dir() and _is_package(folder, name):
                    return folder
        return None


def _is_package(folder: Path, name: str) -> bool:
    if folder.name == name:
        return True
    try:
        manifest = ElementTree.parse(folder / "package.xml").getroot()
    except (OSError, ElementTree.ParseError):
        return False
    return (manifest.findtext("name") or "").strip() == name
