"""What README.md and the pages in docs/ say is true: links, program, public names."""

import ast
import dataclasses
import importlib
import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

import crar_drake

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
YOUR_DIAGRAM = ROOT / "docs" / "guides" / "your-diagram.md"
REFERENCE = ROOT / "docs" / "site" / "reference.rst"
PAGES = [
    README,
    *sorted((ROOT / "docs").glob("**/*.md")),
    *sorted((ROOT / "models").glob("**/README.md")),
    *sorted((ROOT / "diagrams").glob("*.md")),
]


def prose(page: Path) -> str:
    """A page without its fenced code."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)


def anchors(page: Path) -> set[str]:
    """What a link can point to: the headings, as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.M)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.strip().replace(" ", "-") for heading in plain}


def links(page: Path) -> list[str]:
    text = re.sub(r"`[^`\n]*`", "`", prose(page))
    return re.findall(r"\]\(\s*([^)\s]+)\s*\)", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_relative_link_resolves(page):
    for link in links(page):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert target.is_relative_to(ROOT), link
        if anchor:
            assert anchor in anchors(target), link


def test_the_links_are_seen():
    """The test above looks at something: each page of docs/ is linked from a page."""
    linked = {
        (page.parent / link.partition("#")[0]).resolve()
        for page in PAGES
        for link in links(page)
    }
    assert set((ROOT / "docs").glob("**/*.md")) <= linked
    assert {ROOT / "examples", ROOT / "docs/images/g1_boxing.webp"} <= linked


def test_the_first_page_fits_the_width():
    """Nothing wraps a table; the picture's link may be long, and so a table's row."""
    for line in README.read_text("utf-8").splitlines():
        assert len(line) <= 88 or line.startswith(("![", "|")), line


# --- the program on the first page ------------------------------------------------


def programs(page: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


def test_the_first_pages_program_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    (program,) = programs(README)
    monkeypatch.chdir(tmp_path)
    exec(program, {"__name__": "__main__"})
    # The wrists have gone up: were they still below, they would be off by 100 mm.
    off = re.fullmatch(r"wrists off by at most ([\d.]+) mm\n", capsys.readouterr().out)
    assert float(off[1]) < 2.0


def test_the_first_page_imports_public_names_only():
    (program,) = programs(README)
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom) and "crar_drake" in node.module:
            assert node.module == "crar_drake"
            assert {alias.name for alias in node.names} <= set(crar_drake.__all__)


def test_the_program_on_the_page_about_the_filter_says_what_the_page_says(capsys):
    page = ROOT / "docs" / "guides" / "safety-filter.md"
    (program,) = programs(page)
    exec(program, {})
    said = capsys.readouterr().out
    (shown,) = re.findall(
        r"^    (FilterReport\(.*?), joint", page.read_text("utf-8"), re.M
    )
    assert said.startswith(shown)


def test_the_calls_on_the_page_about_diagrams_work():
    """Each line of code of the page, in its order, in a diagram of the test's own."""
    code = re.findall(
        r"^    (\w+ = .*|plant\..*)$", YOUR_DIAGRAM.read_text("utf-8"), re.M
    )
    assert len(code) == 7
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    known = vars(crar_drake) | {n: getattr(crar_drake, n) for n in crar_drake.__all__}
    known |= {"builder": builder, "plant": plant, "scene_graph": scene_graph}
    known["tasks"] = crar_drake.position_tasks(crar_drake.EXPERIMENTS["wrists"])
    known["parameters"] = crar_drake.CrarParameters()
    for line in code:
        exec(line, known)
        if line.startswith("robot"):
            plant.Finalize()
        elif line.startswith("controller"):
            known["model"] = model = known["controller"].model
            q = known["q"] = model.rest_positions()
            known["v"] = np.zeros_like(q)
            # Wrists 10 cm higher than at rest.
            known["first_tasks"] = model.tasks_at(q)
            known["first_tasks"][[2, 5]] += 0.1
            known["desired_tasks"] = model.tasks_at(q)
            known["desired_prescribed"] = np.r_[q[model.prescribed], np.zeros(6)]
    start = plant.GetPositions(plant.CreateDefaultContext())
    reached = model.tasks_at(start)[:6] - known["first_tasks"][:6]
    assert np.abs(reached).max() < 0.02 and not np.allclose(start, q)
    # Asked to stay where it is, the robot is sent nowhere.
    assert np.abs(known["solution"].acceleration).max() < 1e-6
    # At the state of the step its torque is the step's.
    np.testing.assert_allclose(known["torque"], known["solution"].actuation, atol=1e-9)


def test_the_robot_that_is_in_a_plant_already_on_the_page_works():
    """From its own file, by Drake's parser, beside a ball that falls."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.systems.primitives import ConstantVectorSource

    program = programs(YOUR_DIAGRAM)[0].replace("my_robot", "upper_body")
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    urdf = ROOT / "models" / "upper_body" / "upper_body.urdf"
    (arm,) = Parser(plant).AddModels(str(urdf))
    base = plant.GetFrameByName(crar_drake.load_robot_description("upper_body").base)
    plant.WeldFrames(plant.world_frame(), base)
    plant.Finalize()
    known = {n: getattr(crar_drake, n) for n in crar_drake.__all__}
    known |= {"builder": builder, "plant": plant, "scene_graph": scene_graph}
    known |= {"arm": arm, "tasks": crar_drake.position_tasks(["left_wrist"])}
    exec(program, known)
    controller, model = known["controller"], known["model"]
    q = model.rest_positions()
    for port, value in (
        (controller.get_input_port_desired_tasks(), model.tasks_at(q)),
        (controller.get_input_port_desired_prescribed(), model.prescribed_at(q)),
    ):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), port)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.2)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    np.testing.assert_allclose(plant.GetPositions(context, arm), q, atol=1e-4)
    # The ball has fallen by g t^2 / 2.
    fallen = plant.GetBodyByName("ball").EvalPoseInWorld(context).translation()[2]
    assert abs(fallen + 0.5 * 9.81 * 0.2**2) < 2e-3


def test_the_obstacle_and_the_view_on_the_page_work(tmp_path, monkeypatch):
    """An obstacle before the controller is added, the view after it."""
    from pydrake.geometry import Capsule, ProximityProperties, StartMeshcat
    from pydrake.math import RigidTransform
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.visualization import AddDefaultVisualization

    monkeypatch.chdir(tmp_path)
    _, view, post, watched = programs(YOUR_DIAGRAM)
    live, page = re.split(r"(?m)^# .*AdvanceTo.*\n", view)
    names = (Capsule, ProximityProperties, StartMeshcat, RigidTransform, SpatialInertia)
    known = {thing.__name__: thing for thing in (*names, Path)}
    known |= {"dataclasses": dataclasses}
    known |= {"AddDefaultVisualization": AddDefaultVisualization}
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    known |= {"builder": builder, "plant": plant}
    known["robot"] = crar_drake.AddRobot(plant, "upper_body")
    before = len(known["robot"].pairs)
    exec(post, known)
    exec(watched, known)
    tasks = crar_drake.position_tasks(["left_wrist"])
    controller = crar_drake.AddCrarController(
        builder, plant, scene_graph, known["robot"], tasks
    )
    assert len(controller.model.pairs.names) == before + len(known["links"])
    exec(live, known)
    builder.Build()
    exec(page, known)
    assert (tmp_path / "mine.html").stat().st_size > 100_000


# --- the public names -------------------------------------------------------------


def test_the_list_of_public_names_is_in_order():
    assert sorted(crar_drake.__all__) == list(crar_drake.__all__)
    assert set(crar_drake.__all__) == set(crar_drake._MODULES)
    source = ast.parse(inspect.getsource(crar_drake))
    (types,) = [node for node in source.body if isinstance(node, ast.If)]
    for statement in types.body:  # what type checkers see
        for alias in statement.names:
            module = statement.module.removeprefix("crar_drake.")
            assert crar_drake._MODULES[alias.name] == module
    seen = [alias.name for statement in types.body for alias in statement.names]
    assert sorted(seen) == list(crar_drake.__all__)


@pytest.mark.parametrize("name", crar_drake.__all__)
def test_every_public_name_is_documented(name):
    """In its docstring, with every field and method; and on the page of them all."""
    assert re.search(rf"\b{name}\b", REFERENCE.read_text("utf-8"))
    thing = getattr(crar_drake, name)
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        source = inspect.getsource(
            importlib.import_module(f"crar_drake.{crar_drake._MODULES[name]}")
        )
        assert re.search(rf"^# .+\n{name}\b", source, re.M), "a comment says what it is"
        return
    # A dataclass without a docstring gets its signature for one.
    assert thing.__doc__ and not thing.__doc__.startswith(f"{name}(")
    if inspect.isfunction(thing):
        for parameter in inspect.signature(thing).parameters:
            assert re.search(rf"\b{parameter}\b", thing.__doc__), parameter
        return
    for field in dataclasses.fields(thing) if dataclasses.is_dataclass(thing) else ():
        assert re.search(rf"\b{field.name}\b", thing.__doc__), field.name
    for method, member in vars(thing).items():
        member = getattr(member, "__func__", getattr(member, "fget", None) or member)
        if inspect.isfunction(member) and not method.startswith("_"):
            assert member.__doc__, f"{name}.{method}"


# --- the layers ---------------------------------------------------------------------


@pytest.mark.parametrize("layer", ["law", "motions", "runs"])
def test_a_layers_page_has_its_example_which_is_short(layer):
    example = (ROOT / "examples" / f"{layer}.py").read_text("utf-8")
    (shown,) = programs(ROOT / "docs" / "layers" / f"{layer}.md")
    assert shown == example and len(example.splitlines()) <= 30


def test_the_first_page_and_the_guides_are_short():
    def words(page: Path) -> int:
        return len(re.sub(r"(?m)^(\||    ).*$", "", prose(page)).split())

    assert words(README) <= 700
    for guide in (ROOT / "docs" / "guides").glob("*.md"):
        assert words(guide) <= 1200, guide.name
