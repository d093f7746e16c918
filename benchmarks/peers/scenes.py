"""A G1 among spheres that move: the safety filter beside barriers and mink.

    python -m benchmarks.peers.scenes --seeds 4 [--page docs/measurements/scenes.md]

Scenes as SPARK has them (https://github.com/intelligent-control-lab/spark), written
anew after its description: the upper body of a G1 of 17 joints on a fixed base, or of
20 on one that slides and turns; spheres of 5 cm, one or ten, that go about where its
arms are at a stated speed; 10 ms a step. The robot is asked to go from posture to
posture, each for two seconds, straight through itself where that is the way; all
filters are given the same wanted velocities of joints. A sphere does not avoid the
robot, so that one on a fixed base may be hit.

    python -m benchmarks.peers.scenes --tune --seeds 2

tries the grids on other scenes with a fixed base and keeps `scene_settings.json`: of
each filter that one is taken by which links are touched, in each other or beyond a
limit in the fewest samples; of several the one that reaches the most.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.page import Benchmark, Table, run
from benchmarks.peers.attacked import slow_down
from benchmarks.peers.peers import MARGIN, Peer, every
from benchmarks.peers.problem import describe, write_problem
from benchmarks.peers.runs import add_peer_options, drive, job, only
from crar_drake import load_robot_description
from crar_drake.commands.options import count
from crar_drake.files import whole_file, write_whole
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import SafetyParameters
from crar_drake.law.safety_filter import SafetyFilter

ROBOT = "g1"
PERIOD = 0.01  # [s]
RADIUS = 0.05  # of a sphere [m]
STAY = 2.0  # [s] for a posture
POSTURES = 4  # of a scene
REACH = 0.6  # share of the way to the limits of the joints
BASE_REACH = 0.4  # [m] and [rad] that the base is asked to go
FASTEST = 2.0  # that is wanted of a joint [rad/s]
LIMIT = 5.0  # of every joint's speed [rad/s]
CLEAR = 0.15  # [m] from the robot at the start
REACHED = 0.05  # [m] of a hand from where it was asked to be
HARMLESS = SafetyParameters().contact_speed  # [m/s]
HANDS = ("left_wrist", "right_wrist")
SETTINGS = Path(__file__).parent / "scene_settings.json"
TUNED_ON = 1000  # the first seed of the scenes that settings are chosen on
# Where the spheres go, relative to the middle of the hands at rest [m].
BOX = np.array([[-0.15, 0.35], [-0.45, 0.45], [-0.3, 0.4]])
SCENES = {
    "fixed base, one sphere, 1 m/s": (False, 1, 1.0),
    "fixed base, ten spheres, 0.25 m/s": (False, 10, 0.25),
    "moving base, one sphere, 0.25 m/s": (True, 1, 0.25),
    "moving base, ten spheres, 0.25 m/s": (True, 10, 0.25),
}  # base moves, spheres, their speed [m/s]


_BARRIERS = {
    "alpha": (1.0, 4.0, 16.0, 64.0),
    "keep": (MARGIN, 0.03),
    "margin": MARGIN,
    "nearest": 12,
    "damping": 1.0,
    "penalty": 1e6,
    "tolerance": 1e-3,
}
_BOUNDS = {
    "collision_gain": (0.01, 0.05, 0.25, 0.85),
    "detection_distance": 0.2,
    "relaxation": 0.0,
}
_FILTER, _MINK = ("guard_crar", ""), ("guard_mink", "mink")
_OSCBF = ("guard_oscbf", "oscbf")
GUARDS = (
    Peer("safety filter", *_FILTER, every({"braking_time": (0.04, 0.0833, 0.15)})),
    Peer(
        "safety filter, evading",
        *_FILTER,
        every({"braking_time": 0.04, "evade": True}),
    ),
    Peer("OSCBF, spheres' speeds told", *_OSCBF, every(_BARRIERS | {"told": True})),
    Peer("OSCBF, as if they stood", *_OSCBF, every(_BARRIERS | {"told": False})),
    Peer("mink", *_MINK, every(_BOUNDS | {"collision_distance": (MARGIN, 0.03)})),
    Peer("mink, 5 mm", *_MINK, every(_BOUNDS | {"collision_distance": MARGIN})),
)
HEADER = (
    "filter",
    "samples with a sphere in a link",
    "of them with the link faster than 50 mm/s",
    "fastest link in a contact",
    "smallest distance",
    "samples with links in each other",
    "beyond a limit",
    "without an answer",
    "postures reached",
    "hands off, median",
    "most acceleration",
    "step",
)


@dataclass
class Harm:
    """What happened in scenes: counts of samples, and of postures.

    Attributes:
        samples: all.
        touched, harmed: with a sphere in a link, and in one faster than HARMLESS.
        fastest: of a link where it was touched [m/s].
        distance: the smallest of a sphere [m].
        inside, beyond: with watched links in each other; a joint beyond its limit.
        no_answer: steps.
        reached, asked: postures.
        off: (P,) of the hands from each posture, the farther one [m].
        acceleration: the largest of a joint [rad/s^2 or m/s^2].
        step: median [s].
    """

    samples: int
    touched: int
    harmed: int
    fastest: float
    distance: float
    inside: int
    beyond: int
    no_answer: int
    reached: int
    asked: int
    off: list[float]
    acceleration: float
    step: float

    @property
    def rank(self) -> tuple[float, ...]:
        """The less, the better."""
        return self.touched + self.inside + self.beyond, -self.reached


def together(each: Sequence[Harm]) -> Harm:
    """Of several scenes."""
    rows = [asdict(harm) for harm in each]
    made = {key: sum((row[key] for row in rows[1:]), rows[0][key]) for key in rows[0]}
    for key in ("fastest", "acceleration"):
        made[key] = max(row[key] for row in rows)
    made["distance"] = min(row["distance"] for row in rows)
    made["step"] = float(np.median([row["step"] for row in rows]))
    return Harm(**made)


class Stage:
    """A G1, its scenes and its judge.

    Args:
        folder: is made, for the problem.
        on_a_base: whether the base moves.
    """

    def __init__(self, folder: Path, on_a_base: bool) -> None:
        self.folder, self.on_a_base = folder, on_a_base
        write_problem(folder, ROBOT, on_a_base)
        slow_down(folder, LIMIT)
        path = folder / "problem.json"
        problem = json.loads(path.read_text())
        shipped = load_robot_description(ROBOT)
        description = describe(folder, shipped)
        filter = SafetyFilter(description, PERIOD)
        self.model = model = filter.model
        self.limits = np.array(problem["velocity_limits"])
        problem["guarded"] = list(filter.links)
        write_whole(path, json.dumps(problem, indent=1))
        self.lower, self.upper = model.lower, model.upper
        self.rest = model.rest_positions()
        self.base = 3 if on_a_base else 0
        self.judge = ObstacleJudge(model.plant, model.scene_graph, filter.links)
        self.referee = Referee(model.plant, model.scene_graph, description.pairs)
        self.context = model.plant.CreateDefaultContext()
        self.hands = [
            model.plant.GetFrameByName(description.task_frames[hand]) for hand in HANDS
        ]

    def hands_at(self, q: np.ndarray) -> np.ndarray:
        """(2, 3) in the world [m]."""
        self.model.plant.SetPositions(self.context, q)
        return np.array(
            [f.CalcPoseInWorld(self.context).translation() for f in self.hands]
        )

    def write(self, name: str, spheres: int, speed: float, seed: int) -> None:
        """Writes a scene.

        Args:
            name: of its case.
            spheres: how many.
            speed: of each [m/s].
            seed: of the dice.
        """
        rng = np.random.default_rng([seed, spheres, self.on_a_base])
        n, rest = len(self.rest), self.rest
        lower, upper = (
            np.maximum(self.lower, rest - 1.5),
            np.minimum(self.upper, rest + 1.5),
        )
        postures = []
        while len(postures) < POSTURES:
            q = rest + REACH * (rng.uniform(lower, upper) - rest)
            q[: self.base] = rng.uniform(-BASE_REACH, BASE_REACH, self.base)
            if self.model.signed_distances(q).min() > MARGIN + 1e-3:
                postures.append(q)
        postures = np.array(postures)
        each = round(STAY / PERIOD)
        steps = POSTURES * each
        middle = self.hands_at(rest).mean(axis=0)
        low, high = middle + BOX.T
        centres = np.empty((steps + 1, spheres, 3))
        for i in range(spheres):
            where = rng.uniform(low, high)
            while self.distance(rest, where) < CLEAR:
                where = rng.uniform(low, high)
            goal = rng.uniform(low, high)
            for k in range(steps + 1):
                centres[k, i] = where
                way = goal - where
                if np.linalg.norm(way) <= speed * PERIOD:
                    goal = rng.uniform(low, high)
                    way = goal - where
                where = where + speed * PERIOD * way / np.linalg.norm(way)
        fastest = np.full(n, FASTEST)
        fastest[: self.base] = self.limits[: self.base]
        with whole_file(self.folder / f"{name}.npz") as temporary:
            np.savez(
                temporary,
                time=PERIOD * np.arange(steps + 1),
                q_start=rest,
                q=np.vstack([np.repeat(postures, each, axis=0), postures[-1:]]),
                fastest=fastest,
                centres=centres,
                radii=np.full(spheres, RADIUS),
                speeds=np.full(spheres, speed),
            )

    def distance(self, q: np.ndarray, centre: np.ndarray) -> float:
        """Of a sphere from the links [m]."""
        still = np.zeros(self.model.plant.num_velocities())
        d, _ = self.judge.look(q, still, centre[None], np.array([RADIUS]))
        return float(d.min())

    def harm(self, name: str, result: dict[str, np.ndarray]) -> Harm:
        """Judges what a driver recorded, see `driver.Guard`."""
        case = np.load(self.folder / f"{name}.npz")
        q, v = result["q"], result["v"]
        radii, asked = case["radii"], case["q"]
        touched = harmed = 0
        fastest, distance = 0.0, np.inf
        for k in range(1, len(q)):
            d, speed = self.judge.look(q[k], v[k], case["centres"][k], radii)
            into = d <= 0.0
            distance = min(distance, float(d.min()))
            if into.any():
                touched += 1
                fastest = max(fastest, float(speed[into].max()))
                harmed += bool((speed[into] > HARMLESS * (1.0 + 1e-9)).any())
        found = self.referee.violations(q)
        each = round(STAY / PERIOD)
        ends = [each * (i + 1) for i in range(POSTURES)]
        off = [
            np.linalg.norm(self.hands_at(q[k]) - self.hands_at(asked[k - 1]), axis=1)
            for k in ends
        ]
        farther = [float(pair.max()) for pair in off]
        return Harm(
            samples=len(q) - 1,
            touched=touched,
            harmed=harmed,
            fastest=fastest,
            distance=distance,
            inside=found.num_penetrating,
            beyond=found.num_beyond_limit,
            no_answer=int(result["no_answer"].sum()),
            reached=sum(far <= REACHED for far in farther),
            asked=POSTURES,
            off=farther,
            acceleration=float(np.abs(np.diff(v, axis=0)).max() / PERIOD),
            step=float(np.median(result["step_time"][5:])),
        )


def cells(name: str, harm: Harm) -> list[str]:
    """A row as text, in the order of HEADER."""
    share = 100.0 / harm.samples
    return [
        name,
        f"{share * harm.touched:.1f} %",
        f"{harm.harmed}",
        f"{1e3 * harm.fastest:.0f} mm/s" if harm.touched else "–",
        f"{1e3 * harm.distance:.1f} mm",
        f"{harm.inside}",
        f"{harm.beyond}",
        f"{harm.no_answer}",
        f"{harm.reached} of {harm.asked}",
        f"{1e3 * np.median(harm.off):.0f} mm",
        f"{harm.acceleration:,.0f} rad/s²",
        f"{1e3 * harm.step:.2f} ms",
    ]


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.scenes", __doc__, "scenes")
    parser = benchmark.parser
    add_peer_options(benchmark, "out/scenes")
    parser.add_argument("--seeds", type=count, default=4, help="of each kind of scene")
    parser.add_argument("--tune", action="store_true", help="choose settings anew")
    arguments = benchmark.parse(
        argv, lambda given: "scenes, some" if given.only else "scenes"
    )
    guards, out = only(GUARDS, arguments, benchmark), arguments.out
    stages = {
        moves: Stage(out / f"problem {moves:d}", moves) for moves in (False, True)
    }
    first = TUNED_ON if arguments.tune else 0
    cases: dict[str, list[str]] = {}
    for scene, (moves, spheres, speed) in SCENES.items():
        kind = f"{'moving' if moves else 'fixed'}_{spheres}_{speed:g}"
        cases[scene] = [f"{kind}_{first + i}" for i in range(arguments.seeds)]
        for i, name in enumerate(cases[scene]):
            stages[moves].write(name, spheres, speed, first + i)
    settings = json.loads(SETTINGS.read_text()) if SETTINGS.is_file() else {}
    if arguments.tune:
        for guard in track(guards, "filters"):
            found = judged(guard, guard.grid, stages, cases, arguments)
            ranks = [together(list(of.values())).rank for of in found]
            best = min(range(len(ranks)), key=ranks.__getitem__)
            for i, rank in enumerate(ranks):
                print(guard.name, guard.grid[i], rank, "taken" if i == best else "")
            settings[guard.name] = guard.grid[best]
            write_whole(SETTINGS, json.dumps(settings, indent=1) + "\n")
        return
    found = {
        guard.name: judged(guard, [settings[guard.name]], stages, cases, arguments)[0]
        for guard in track(guards, "filters")
    }
    tables = [
        Table(
            HEADER,
            [cells(name, of[scene]) for name, of in found.items()],
            scene[0].upper() + scene[1:],
        )
        for scene in SCENES
    ]
    used = [[name, f"`{json.dumps(settings[name])}`"] for name in found]
    tables.append(Table(("filter", "settings"), used, "Settings"))
    benchmark.report(tables)


def judged(
    guard: Peer,
    grid: Sequence[dict],
    stages: Mapping[bool, Stage],
    cases: Mapping[str, Sequence[str]],
    arguments: argparse.Namespace,
) -> list[dict[str, Harm]]:
    """What happened with each of a filter's settings, scene by scene.

    Args:
        guard: the filter.
        grid: its settings.
        stages: by whether their bases move.
        cases: scene to the names of its cases.
        arguments: with those of `add_peer_options`.
    """
    runs = arguments.out / "runs"
    found: list[dict[str, Harm]] = [{} for _ in grid]
    for moves, stage in stages.items():
        of = {scene: each for scene, each in cases.items() if SCENES[scene][0] == moves}
        # In one process, so that what is compiled is so once.
        jobs = {
            (name, i): job(name, one, runs / f"{guard.name} {i} {name}.npz", PERIOD)
            for each in of.values()
            for name in each
            for i, one in enumerate(grid)
        }
        results = drive(guard, arguments.environments, stage.folder, jobs)
        for scene, each in of.items():
            for i in range(len(grid)):
                harms = [stage.harm(name, results[name, i]) for name in each]
                found[i][scene] = together(harms)
    return found


if __name__ == "__main__":
    run(main)
