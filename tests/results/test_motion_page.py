"""The page of a reference before and after cleaning: what is coloured when."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from recorded_pages import look, read_data
from scipy.spatial.transform import Rotation
from small_reference_robots import BASE_SHAPE, reaching, write_csv, write_robot
from small_robots import LINK

from crar_drake.commands import main
from crar_drake.errors import CrarError, MotionError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.performer import PARENTS
from crar_drake.references.clean_file import clean_file
from crar_drake.references.motion_files import read_motion, write_motions
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.motion_page import compare_files
from crar_drake.robot.description import load_robot_description
from docs.headless_browser import HeadlessBrowser, find_browser

FRAMES, RATE = 24, 30.0
POST, BASE = np.array([0.2, 0.5, 0.1]), np.zeros(3)  # centres of balls
PAIRS = {("post", "l1"), ("post", "l2"), ("base_shape", "l2")}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The robot, a reference through the ball, and what cleaning makes of it."""
    folder = tmp_path_factory.mktemp("page")
    write_robot(folder)
    reference = write_csv(folder / "reach.csv", reaching(FRAMES, RATE, 1.0))
    out = folder / "clean" / "reach.csv"
    clean_file(reference, out, str(folder))
    page = folder / "reach.html"
    compare_files([reference, out], page, str(folder), labels=["before", "after"])
    return folder, reference, out, page


def joints_of(csv: Path) -> np.ndarray:
    return np.loadtxt(csv, delimiter=",")[:, 7:]


def link_ends(joints: np.ndarray) -> np.ndarray:
    """(T, 4, 3) both ends of l0, l1 and l2, all turning about z."""
    angles = np.cumsum(joints, axis=1)
    ways = LINK * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=2)
    return np.concatenate([np.zeros((len(joints), 1, 3)), np.cumsum(ways, 1)], axis=1)


def to_segment(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.linalg.norm(point - a - share * (b - a)))


def penetrating_links(joints: np.ndarray) -> list[set[str]]:
    """Links inside another in each frame, from the arm's geometry alone.

    Capsules have radius 0.04 and are 0.2 long, in the middle of links of 0.3; the post
    is a ball of 0.1, the base's shape one of 0.05.
    """
    found = []
    for ends in link_ends(joints):
        links = set()
        for ball, link in PAIRS:
            start, end = ends[int(link[1])], ends[int(link[1]) + 1]
            inset = (end - start) / 6.0
            centre, radius = (POST, 0.1) if ball == "post" else (BASE, 0.05)
            if to_segment(centre, start + inset, end - inset) < radius + 0.04:
                links |= {ball, link}
        found.append(links)
    return found


def shown_links(data: dict, run: dict) -> list[set[str]]:
    """Links that the page colours in each frame."""
    names = [path.rpartition("/")[2] for path in data["robots"][run["robot"]]["paths"]]
    found: list[set[str]] = [set() for _ in range(run["frames"])]
    for link, spans in run["penetrating"].items():
        for first, last in spans:
            for frame in range(first, last + 1):
                found[frame].add(names[int(link)])
    return found


def test_links_are_coloured_in_the_frames_in_which_they_penetrate(made):
    _, reference, out, page = made
    data = read_data(page)
    before, after = data["runs"]
    expected = penetrating_links(joints_of(reference))
    assert {"post", "l1"} <= set.union(*expected) and set() in expected
    assert shown_links(data, before) == expected
    assert shown_links(data, after) == penetrating_links(joints_of(out))
    assert after["penetrating"] == {}


def test_both_robots_are_where_the_files_have_them(made):
    _, reference, out, page = made
    data = read_data(page)
    names = [path.rpartition("/")[2] for path in data["robots"][0]["paths"]]
    for run, path in zip(data["runs"], (reference, out), strict=True):
        table = np.loadtxt(path, delimiter=",")
        assert (run["rate"], run["frames"]) == (RATE, len(table))
        poses = run["poses"].reshape(len(table), -1, 7)
        # The root turns about z; link l2 begins where l1 ends.
        yaw = 2.0 * np.arctan2(table[:, 6], table[:, 3])
        start = link_ends(table[:, 7:])[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        expected = table[:, :3] + np.column_stack(
            [
                c * start[:, 0] - s * start[:, 1],
                s * start[:, 0] + c * start[:, 1],
                0 * c,
            ]
        )
        np.testing.assert_allclose(poses[:, names.index("l2"), :3], expected, atol=1e-4)
    # Nothing of the robot stands still while its root turns.
    assert "post" in names and np.ptp(poses[:, names.index("post"), 5]) > 0.1


def test_the_time_line_and_the_caption_say_the_same(made):
    _, reference, out, page = made
    data = read_data(page)
    inside = [bool(links) for links in penetrating_links(joints_of(reference))]
    before, after = data["runs"]
    marked = np.zeros(FRAMES, dtype=bool)
    for start, end in before["spans"]["capsules penetrate"]:
        marked |= (np.arange(FRAMES) / RATE >= start) & (
            np.arange(FRAMES) / RATE <= end
        )
    assert marked.tolist() == inside
    assert not any(after["spans"].values())
    assert np.flatnonzero(np.array(before["curve"]["distance"], float) < 0.0).tolist() \
        == np.flatnonzero(inside).tolist()  # fmt: skip
    figures = [{f["name"]: f["value"] for f in run["figures"]} for run in data["runs"]]
    frames = f"{sum(inside)} of {FRAMES} frames"
    assert figures[0]["capsules penetrate in"] == frames
    assert figures[1]["capsules penetrate in"] == "none"
    change = np.abs(joints_of(out) - joints_of(reference))
    np.testing.assert_allclose(after["curve"]["error"], change.max(axis=1), atol=6e-6)
    rms = np.degrees(np.sqrt((change**2).mean()))
    assert figures[1]["joints changed by"] == f"{rms:.2f}° rms"
    assert before["curve"]["error"] == [] and data["title"] == "reach.csv"
    assert "capsules" in data["texts"]["inside"]


def test_labels_end_on_the_pair_that_penetrates(made):
    _, reference, _, page = made
    run = read_data(page)["runs"][0]
    near = run["near"].reshape(FRAMES, -1, 8)
    inside = [bool(links) for links in penetrating_links(joints_of(reference))]
    assert np.isfinite(near[:, 0, 0]).tolist() == inside
    frame = int(np.nanargmin(near[:, 0, 1]))
    _, d, *points = near[frame, 0]
    depth = np.linalg.norm(np.subtract(points[:3], points[3:]))
    assert depth == pytest.approx(-d, abs=1e-4)
    curve = [value for value in run["curve"]["distance"] if value is not None]
    assert d == pytest.approx(min(curve), abs=2e-5)
    assert run["pairNames"][int(near[frame, 0, 0])] == "post – l1"


def test_meshes_decide_where_there_are_any(tmp_path):
    """Balls of 3 cm are all that is seen of the links, and are nearer to the post than
    that in fewer frames than the links' capsules."""
    write_robot(tmp_path)
    ball = trimesh.creation.icosphere(4, radius=0.03)
    ball.export(tmp_path / "ball.obj")
    look_of = (
        f'<visual><origin xyz="{0.75 * LINK} 0 0"/>'
        '<geometry><mesh filename="ball.obj"/></geometry></visual>'
    )
    urdf = tmp_path / "chain.urdf"
    text = urdf.read_text()
    for link in ("l1", "l2"):
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{look_of}')
    assert text.count("ball.obj") == 2 and BASE_SHAPE.strip()[:20] in text
    urdf.write_text(text)
    reference = write_csv(tmp_path / "reach.csv", reaching(FRAMES, RATE, 1.0))
    still = write_csv(tmp_path / "still.csv", 0.2 * np.ones((FRAMES, 3)))
    page = tmp_path / "page.html"
    verdicts = compare_files([reference, still], page, str(tmp_path), labels=["a", "b"])
    data = read_data(page)
    ends = link_ends(joints_of(reference))
    centres = 0.25 * ends[:, 1:3] + 0.75 * ends[:, 2:4]
    gaps = np.linalg.norm(centres - POST, axis=2).T - 0.13
    shown = shown_links(data, data["runs"][0])
    assert sum(map(bool, shown)) == len(verdicts[0].penetrating_frames) > 0
    for link, gap in zip(("l1", "l2"), gaps, strict=True):
        for frame, links in enumerate(shown):
            if abs(gap[frame]) > 1e-3:  # the balls are made of triangles
                assert (link in links) == (gap[frame] < 0.0), (link, frame)
    # The capsules have another opinion, which is marked beside.
    assert [bool(x) for x in shown] != [
        bool(x) for x in penetrating_links(joints_of(reference))
    ]
    names = [f["name"] for f in data["runs"][0]["figures"]]
    assert names[:3] == ["meshes penetrate in", "by", "capsules in"]
    assert shown_links(data, data["runs"][1]) == [set()] * FRAMES
    compare_files(
        [reference, still], page, str(tmp_path), labels=["a", "b"], meshes=False
    )
    again = read_data(page)
    # The post has no looks, and what is not drawn has no colour.
    assert shown_links(again, again["runs"][0]) == [
        links - {"post", "base_shape"}
        for links in penetrating_links(joints_of(reference))
    ]


def crimson(image: np.ndarray) -> list[int]:
    """Red pixels of the left and the right half."""
    r, g, b = np.moveaxis(image, 2, 0)
    red = (r > 0.4) & (g < 0.55 * r) & (b < 0.6 * r)
    return [int(half.sum()) for half in np.split(red, 2, axis=1)]


def test_the_browser_shows_red_links_and_gives_them_their_colour_back(made):
    if find_browser() is None:
        pytest.skip("there is no Chromium to open the page in")
    _, reference, _, page = made
    inside = [bool(links) for links in penetrating_links(joints_of(reference))]
    worst, clear = inside.index(True) + sum(inside) // 2, 0

    with HeadlessBrowser(640, 480) as browser:
        browser.open(page, f"#t={clear / RATE}")
        # Marks over the robots are red as well.
        browser.evaluate("document.getElementById('crar-marks').style.opacity = 0")
        assert crimson(look(browser, clear / RATE)) == [0, 0]
        left, right = crimson(look(browser, worst / RATE))
        assert left > 200 and right == 0
        assert crimson(look(browser, clear / RATE)) == [0, 0]
        legend = browser.evaluate("document.getElementById('crar-legend').textContent")
        assert "a link inside another, by capsules" in legend
        assert browser.complaints == []


def test_marks_go_where_nothing_is_marked(made):
    if find_browser() is None:
        pytest.skip("there is no Chromium to open the page in")
    _, reference, _, page = made
    inside = [bool(links) for links in penetrating_links(joints_of(reference))]
    first = inside.index(True)
    worst = first + sum(inside) // 2
    with HeadlessBrowser(640, 480) as browser:
        browser.open(page, "#t=0")
        # Seen as the user does: of a canvas that is asked for its pixels all is drawn.
        for frame, marked in ((worst, True), (0, False), (first // 2, False)) * 3:
            left, _ = crimson(look(browser, frame / RATE))
            assert (left > 0) == marked


def test_clean_leaves_a_page_beside_the_certificate(made, tmp_path, capsys):
    folder, reference, _, _ = made
    out = tmp_path / "reach.csv"
    command = ["clean", str(reference), "--robot", str(folder), "--out", str(out)]
    assert main([*command, "--no-page"]) == 0
    assert not out.with_suffix(".html").exists()
    assert main(command) == 0
    assert str(out.with_suffix(".html")) in capsys.readouterr().out.splitlines()
    data = read_data(out.with_suffix(".html"))
    assert [run["label"] for run in data["runs"]] == ["before", "after"]
    assert shown_links(data, data["runs"][0]) == penetrating_links(joints_of(reference))
    # Of the frames that are kept both show the same.
    assert main([*command, "--frames", "3:12"]) == 0
    data = read_data(out.with_suffix(".html"))
    assert [run["frames"] for run in data["runs"]] == [10, 10]
    part = joints_of(reference)[2:12]
    assert shown_links(data, data["runs"][0]) == penetrating_links(part)


def test_of_several_motions_that_is_shown_which_changed_most(made, tmp_path, capsys):
    folder, _, _, _ = made
    robot = WholeBody(load_robot_description(folder))
    motions = []
    for name, reach in (("calm", 0.1), ("wild", 1.0)):
        csv = write_csv(tmp_path / f"{name}.csv", reaching(FRAMES, RATE, reach))
        (tmp_path / "x").mkdir(exist_ok=True)
        motion = read_motion(csv, robot=robot)
        motions.append(type(motion)(
            motion.joint_names, motion.root_positions, motion.root_quaternions,
            motion.joint_positions, motion.rate, clip=name,
        ))  # fmt: skip
    both = tmp_path / "both.pkl"
    write_motions(both, motions, "motion-lib-pkl", robot)
    out = tmp_path / "x" / "both.pkl"
    assert main(["clean", str(both), "--robot", str(folder), "--out", str(out)]) == 0
    assert "the page is of wild" in capsys.readouterr().out
    page = out.with_suffix(".html")
    assert read_data(page)["title"] == "both.pkl, wild"
    command = ["show", str(both), str(out), "--robot", str(folder), "--out"]
    assert main([*command, str(page), "--clip", "calm"]) == 0
    data = read_data(page)
    assert data["title"] == "both.pkl, calm"
    assert [run["label"] for run in data["runs"]] == [tmp_path.name, "x"]
    assert main([*command, str(page)]) == 2
    assert "holds 2 motions; name one of them" in capsys.readouterr().err


def test_mistakes_are_told(made, tmp_path, capsys):
    folder, reference, out, page = made
    files = [str(reference), str(out)]
    assert main(["show", *files, "--out", str(tmp_path / "p.html")]) == 2
    assert "--robot" in capsys.readouterr().err
    log = tmp_path / "log.npz"
    np.savez(log, time=np.zeros(1))
    command = ["show", files[0], str(log), "--robot", str(folder)]
    assert main([*command, "--out", str(tmp_path / "p.html")]) == 2
    assert f"{log} is no reference motion" in capsys.readouterr().err
    other = write_csv(tmp_path / "other.csv", np.zeros((5, 2)))
    with pytest.raises(MotionError, match="other.csv"):
        compare_files([reference, other], tmp_path / "p.html", str(folder), labels="ab")
    with pytest.raises(CrarError, match="1 motions cannot be compared"):
        compare_files([reference], tmp_path / "p.html", str(folder), labels="a")
    assert not (tmp_path / "p.html").exists()
    place = tmp_path / "reach.html"
    place.mkdir()
    command = ["clean", files[0], "--robot", str(folder), "--out"]
    assert main([*command, str(tmp_path / "reach.csv")]) == 2
    assert "reach.html" in capsys.readouterr().err
    assert not (tmp_path / "reach.csv").exists(), "told before, not after"


def test_names_are_text(made, tmp_path):
    folder, reference, out, _ = made
    evil = tmp_path / "<script>alert(1)<.csv"
    evil.write_bytes(reference.read_bytes())
    page = tmp_path / "page.html"
    compare_files([evil, out], page, str(folder), labels=["</script>", "b"])
    text = re.sub(r"<script.*?</script>", "", page.read_text(), flags=re.DOTALL)
    assert "<title>&lt;script&gt;alert(1)&lt;.csv</title>" in text


def test_a_person_is_shown_beside_the_motion(made, tmp_path, monkeypatch):
    """Bones are between the person's joints, as large as the robot's root is high."""
    folder, reference, _, _ = made
    (tmp_path / "dance").mkdir()  # which is no log for that
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "beside.html"
    main(["show", "dance", str(reference), "--robot", str(folder), "--out", str(page)])
    data = read_data(page)
    person, robot = data["runs"]
    assert [person["label"], robot["label"]] == ["dance", reference.name]
    performer, root = (
        load_performer("dance"),
        np.loadtxt(reference, delimiter=",")[:, :3],
    )
    places, hips = performer.positions, performer.positions["pelvis"]
    scale = np.median(root[:, 2]) / np.median(hips[:, 2])
    start = [*(root[0, :2] - scale * hips[0, :2]), 0.0]
    poses = person["poses"].reshape(person["frames"], -1, 7)
    assert person["frames"] == int(performer.duration * RATE) + 1
    bones = [(a, b) for b, a in PARENTS.items() if {a, b} <= set(places)]
    paths = data["robots"][person["robot"]]["paths"]
    assert len(bones) == poses.shape[1] == len(paths)
    for k in (0, 40, person["frames"] - 1):
        at = round(k / RATE * performer.frame_rate)
        for (a, b), pose in zip(bones, poses[k], strict=True):
            middle = 0.5 * scale * (places[a][at] + places[b][at]) + start
            np.testing.assert_allclose(pose[:3], middle, atol=1e-4)
            along = Rotation.from_quat(pose[3:]).apply([0.0, 0.0, 1.0])
            way = places[b][at] - places[a][at]
            assert along @ way > 0.9999 * np.linalg.norm(way)


def test_only_one_person_is_shown_beside_motions(made, capsys):
    folder, reference, _, _ = made
    files = ["dance", "boxing", str(reference)]
    assert main(["show", *files, "--robot", str(folder)]) == 2
    assert "beside one person" in capsys.readouterr().err
