"""The certificate beside a cleaned motion: what it keeps, of which files it holds.

A JSON file. `make_certificate` measures the file that was written, by the distances
and the bounds of the control law and of `mesh_clearance`; `check_certificate` reads the
same file again and asks the referee and the judge of meshes, which share no code with
these.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from crar_drake.errors import CrarError, plural
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.judging.referee import Referee
from crar_drake.references.certificate_files import (
    FORMAT,
    KIND,
    certificate_path,
    file_hash,
    robot_files,
)
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.faults import Fault
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.mesh_clearance import MeshClearance
from crar_drake.references.motion_files import read_motions
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.uncovered import Uncovered, shaped_pairs, why_no_meshes
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import (
    LIMIT_TOLERANCE,
    SPEED_TOLERANCE,
    RobotDescription,
)
from crar_drake.trajectory.margins import Margins
from crar_drake.version import __version__

# By so much less than what is claimed may be found: rounding [m].
DISTANCE_TOLERANCE = 1e-6
# Points on the way to the next frame that the referee looks at.
_BETWEEN = 3


def make_certificate(
    motion: Path,
    reference: Path,
    clips: Sequence[dict],
    uncovered: Uncovered,
    parameters: CleaningParameters,
    read: dict,
    options: dict,
) -> dict:
    """The contents of a certificate.

    Args:
        motion: the file that was written.
        reference: the file that it was made from.
        clips: what its motions keep (`certified_clip`).
        uncovered: what it does not cover.
        parameters: what was to be kept.
        read: layout and rate of the file, and what was guessed of its reference.
        options: how it was made.
    """
    description = uncovered.description
    return {
        "kind": KIND,
        "format": FORMAT,
        "version": __version__,
        "motion": {"file": motion.name, "sha256": file_hash(motion), **read},
        "reference": {"file": reference.name, "sha256": file_hash(reference)},
        "robot": {
            "name": description.name,
            "files": robot_files(description),
            "watched_pairs": len(description.pairs),
        },
        "checked": {
            "distance": "watched pairs by their capsules and spheres [m]; between: a "
            "bound for the straight way in joint space to the next frame; of pairs of "
            "mesh_pairs excused at some frames, counted from 0, where meshes decide",
            "limit": "to the nearest joint limit [rad or m]",
            "speed": "largest share of a joint's speed limit to the next frame",
            "floor": parameters.floor,
            "meshes": "of each of mesh_pairs [m]: at_frames, no distance at a frame is "
            "smaller; on_ways, none on a straight way in joint space to the next frame",
        },
        "mesh_pairs": uncovered.mesh_pairs,
        "not_covered": uncovered.listed,
        "clips": list(clips),
        "parameters": asdict(parameters),
        "options": options,
    }


def certified_clip(
    motion: RobotMotion,
    margins: Margins,
    meshes: MeshClearance | None,
    excused: np.ndarray,
    faults: Sequence[Fault],
    left: Sequence[Fault],
    pairs: Sequence[Sequence[str]],
) -> dict:
    """What is claimed of one motion of a file.

    Args:
        motion: as it stands in the file.
        margins, meshes: what it keeps, by shapes, and by meshes where there are some.
        excused: (T,) frames, or ways from them, at which shapes about links that are
            too near do not matter: their meshes are not.
        faults, left: what else is wrong with it, and what was so before and was left.
        pairs: that are watched.
    """
    frames = {key: values.tolist() for key, values in asdict(margins).items()}
    return {
        "clip": motion.clip,
        "rate": motion.rate,
        "meshes": None if meshes is None else _meshes(meshes),
        "faults": [list(fault) for fault in faults],
        "left_as_it_was": [fault.kind for fault in left],
        "excused": np.flatnonzero(excused).tolist(),
        "smallest": _smallest(frames, pairs),
        "frames": frames,
    }


@dataclass
class CertificateCheck:
    """Whether a certificate holds."""

    # what does not, a sentence each; empty if all does
    refuted: list[str] = field(default_factory=list)
    frames: int = 0  # that were looked at
    points: int = 0  # between frames that were looked at
    mesh_frames: int = 0  # the same, by meshes
    mesh_points: int = 0  # and between frames
    mesh_pairs: int = 0  # pairs of links that were looked at by their meshes
    uncovered: int = 0  # pairs of links that it is not of
    why_not: str = ""  # why no meshes were looked at; "" if they were
    # the smallest that the referee found [m]; infinite without pairs
    distance: float = math.inf
    pair: tuple[str, str] | None = None  # of which links; None without
    limit: float = math.inf  # the smallest margin to a joint limit [rad or m]
    speed: float = 0.0  # the largest share of a speed limit

    @property
    def holds(self) -> bool:
        """Whether nothing refutes it."""
        return not self.refuted


def check_certificate(
    motion: Path, certificate: dict, description: RobotDescription
) -> CertificateCheck:
    """Whether a certificate is of this file and this robot, and true.

    Every frame is judged by the referee and by the meshes, and some points on the way
    to the next. They can refute a bound, not prove it. Besides, nothing may be
    violated: a certificate that truly tells of a penetration does not hold, nor one
    with a way between frames that is not shown to be clear, nor one of a motion whose
    meshes penetrate where they are looked at, whether it is of that pair or not.

    Not examined is what nothing here could refute: of which reference, by which version
    and parameters the motion was made, which pair is the nearest at a frame, and the
    rate of a CSV, which does not say it.

    Args:
        motion: the file.
        certificate: of it, as it was read.
        description: of the robot.

    Raises:
        MotionError: the file cannot be read, or is of another robot.
        CrarError: its frames are of other pairs, or the referee cannot judge it.
    """
    check = CertificateCheck()
    try:
        check.refuted.extend(_refuted(check, motion, certificate, description))
    except CrarError:
        raise
    except ValueError as error:  # of the referee, or of a pair that is none
        raise CrarError(f"{certificate_path(motion)}: {error}") from error
    return check


def _refuted(
    check: CertificateCheck,
    motion: Path,
    certificate: dict,
    description: RobotDescription,
) -> Iterator[str]:
    """Yields what does not hold; counts in `check` what is looked at. Arguments, of
    all that follow, are as of `check_certificate`."""
    name, said = description.name, certificate["robot"]
    if certificate["motion"]["sha256"] != file_hash(motion):
        yield f"it is of another file than {motion}, or of a former"
        return
    if said["files"] != robot_files(description):
        yield f"robot {name} has other files than it was made with"
        return
    if said["watched_pairs"] != len(description.pairs):
        yield (
            f"robot {name} watches {len(description.pairs)} pairs, and it says "
            f"{said['watched_pairs']}"
        )
    clips = {clip["clip"]: clip for clip in certificate["clips"]}
    if len(clips) < len(certificate["clips"]):
        yield "a clip is in it more than once"
    robot = WholeBody(description)
    check.why_not = why_no_meshes(robot)
    judge = None if check.why_not else MeshJudge(description)
    yield from _check_pairs(check, certificate, robot, judge)
    referee = robot.referee()
    of_file = certificate["motion"]
    layout = of_file["layout"]
    # A rate that the file says cannot be found by what is examined.
    rate_given = None if LAYOUTS[layout].has_rate else of_file["rate"]
    motions = read_motions(motion, layout, rate_given, robot=robot)
    there = {each.clip for each in motions}
    yield from (f"clip {x!r} is not in the motion" for x in clips if x not in there)
    for each in motions:
        if each.clip not in clips:
            yield f"clip {each.clip!r} is not in it"
            continue
        claimed, pairs = clips[each.clip], certificate["mesh_pairs"]
        if not math.isclose(each.rate, claimed["rate"], rel_tol=1e-9):
            yield f"the motion is of {each.rate:g} Hz, and it says {claimed['rate']:g}"
        covered = {frozenset(pair) for pair in pairs if judge is not None}
        yield from _check_clip(check, claimed, each, robot, referee, covered)
        if judge is not None:
            yield from _check_meshes(
                check, claimed["meshes"], pairs, each, robot, judge
            )


def _check_pairs(
    check: CertificateCheck,
    certificate: dict,
    robot: WholeBody,
    judge: MeshJudge | None,
) -> Iterator[str]:
    """Whether it tells of each pair that can meet that it is of it, or that it is not.

    Where nobody looks at meshes here, pairs that only these cover count as uncovered.
    """
    listed = {frozenset(pair) for pair in certificate["not_covered"]["pairs"]}
    watched = {frozenset(pair) for pair in robot.description.pairs}
    of_meshes = {frozenset(pair) for pair in certificate["mesh_pairs"]}
    told = listed | watched | of_meshes
    if judge is None:
        check.uncovered = len(listed | (of_meshes - watched))
        pairs = shaped_pairs(robot)
    else:
        check.uncovered, check.mesh_pairs = len(listed), len(of_meshes)
        pairs = judge.pairs + judge.left_out
        unknown = of_meshes - {frozenset(pair) for pair in judge.pairs}
        if unknown:
            pair = " - ".join(sorted(next(iter(unknown))))
            yield f"it is of {pair}, which is no pair that is judged"
    untold = [pair for pair in pairs if frozenset(pair) not in told]
    if untold:
        a, b = untold[0]
        more = f", and of {len(untold) - 1} more" if len(untold) > 1 else ""
        yield f"it does not say that it is not of {a} - {b}, which nobody watches{more}"


def _check_meshes(
    check: CertificateCheck,
    claims: dict | None,
    said: list,
    motion: RobotMotion,
    robot: WholeBody,
    judge: MeshJudge,
) -> Iterator[str]:
    """What the judge of meshes finds of one motion.

    Args:
        claims: of the motion; None where there are none.
        said: the pairs that they are of.
    """
    name = f"{motion.clip}: " if motion.clip else ""
    # What is not claimed may be anything but a penetration.
    least = {key: np.zeros(len(judge.pairs)) for key in ("at_frames", "on_ways")}
    if claims is None and said:
        yield f"{name}it has no bounds of meshes"
    elif claims is not None:
        row = {frozenset(pair): k for k, pair in enumerate(judge.pairs)}
        rows = [row.get(frozenset(pair)) for pair in said]
        for key, values in least.items():
            claimed = np.asarray(claims[key], dtype=float)
            if claimed.shape != (len(said),) or np.isnan(claimed).any():
                yield f"{name}meshes, {key}: not a number for each pair"
                return
            for k, value in zip(rows, claimed, strict=True):
                if k is not None:
                    values[k] = max(0.0, value - DISTANCE_TOLERANCE)
            unclear = np.flatnonzero(claimed <= 0.0)
            if len(unclear):
                a, b = said[unclear[0]]
                more = f", and {len(unclear) - 1} more" if len(unclear) > 1 else ""
                where = "at a frame" if key == "at_frames" else "between frames"
                yield (
                    f"{name}the meshes of {a} - {b}{more} are not shown to be clear "
                    f"{where}"
                )
    q = robot.configurations(motion.joint_positions)
    parts = np.linspace(0.0, 1.0, _BETWEEN + 2)[:-1]
    at = [(k, u) for k in range(len(q)) for u in (parts if k < len(q) - 1 else [0.0])]
    samples = (
        (
            q[k] + u * (q[k + 1] - q[k]) if u else q[k],
            least["on_ways" if u else "at_frames"],
        )
        for k, u in at
    )
    check.mesh_frames += len(q)
    check.mesh_points += len(at) - len(q)
    penetrating: dict[int, set] = {}
    for index, row, d in judge.nearer(samples):
        k, u = at[index]
        a, b = judge.pairs[row]
        if d == 0.0:
            penetrating.setdefault(row, set()).add(k)
            continue
        claim = least["on_ways" if u else "at_frames"][row]
        yield (
            f"{name}frame {k + 1}{' and the next' if u else ''}: the meshes of {a} - "
            f"{b} are {1e3 * d:.3f} mm apart, claimed {1e3 * claim:.3f} mm"
        )
    for row, frames in penetrating.items():
        a, b = judge.pairs[row]
        yield (
            f"{name}the meshes of {a} - {b} penetrate in {plural(len(frames), 'frame')}"
            f", or on the ways from there, first {min(frames) + 1}"
        )


def _check_clip(
    check: CertificateCheck,
    claimed: dict,
    motion: RobotMotion,
    robot: WholeBody,
    referee: Referee,
    covered: Collection[frozenset[str]],
) -> Iterator[str]:
    """What of one motion's claims the referee refutes.

    Args:
        claimed: of the motion.
        covered: pairs whose meshes are looked at, and decide where that is claimed.
    """
    claims, joints = claimed["frames"], motion.joint_positions
    bounds = {
        name: np.asarray(claims[name], dtype=float)
        for name in ("distance", "between", "limit", "speed")
    }
    if any(values.shape != (len(joints),) for values in bounds.values()):
        yield f"it is not of {len(joints)} frames"
        return
    # What is no number is smaller than nothing, and would hold of all.
    numbers = np.isfinite(bounds["distance"]) & np.isfinite(bounds["between"])
    numbers &= ~np.isnan(bounds["limit"]) & ~np.isnan(bounds["speed"])
    if not numbers.all():
        yield f"frame {numbers.argmin() + 1}: a claim is no number"
        return
    excused = np.isin(np.arange(len(joints)), claimed["excused"])
    unclear = np.where(excused, np.inf, bounds["between"])
    if unclear.min() < 0.0:
        frame = unclear.argmin() + 1
        yield f"the way from frame {frame} to the next is not shown to be clear"
    q = robot.configurations(joints)
    limit = np.minimum(joints - robot.lower, robot.upper - joints).min(axis=1)
    speed = np.zeros(len(joints))
    steps = np.abs(np.diff(joints, axis=0)) * motion.rate
    speed[:-1] = (steps / robot.speed_limits).max(axis=1)
    for name, found, worse in (
        ("limit", limit, limit < bounds["limit"] - LIMIT_TOLERANCE),
        ("speed", speed, speed > bounds["speed"] + SPEED_TOLERANCE),
    ):
        if worse.any():
            k = int(worse.argmax())
            claim = bounds[name][k]
            yield f"frame {k + 1}: {name} is {found[k]:.6g}, claimed {claim:.6g}"
    if limit.min() < -LIMIT_TOLERANCE:
        yield f"frame {limit.argmin() + 1} is beyond a joint limit"
    if speed.max() > 1.0 + SPEED_TOLERANCE:
        yield f"frame {speed.argmax() + 1} is beyond a speed limit"
    check.limit = min(check.limit, float(limit.min()))
    check.speed = max(check.speed, float(speed.max()))
    for k in range(len(q)):
        decide = covered if excused[k] else ()
        yield from _check_frame(check, k, q[k : k + 2], bounds, referee, decide)
    if claimed["smallest"] != _smallest(claims, referee.pairs):
        yield "'smallest' is not what its frames say"


def _check_frame(check, k: int, ends, bounds, referee: Referee, decide):
    """A frame, and points on the way to the next; of some pairs meshes decide."""
    points = [(0.0, bounds["distance"][k])]
    if len(ends) > 1:
        inner = np.linspace(0.0, 1.0, _BETWEEN + 2)[1:-1]
        points += [(u, bounds["between"][k]) for u in inner]
    for u, claim in points:
        q = ends[0] + u * (ends[-1] - ends[0])
        # Nothing beyond the claim, or the nearest so far, is of interest.
        d, pair = referee.nearest(q, max(claim, check.distance, 0.0) + 1e-3)
        check.frames += u == 0.0
        check.points += u > 0.0
        if d < check.distance:
            check.distance, check.pair = d, pair
        if d < claim - DISTANCE_TOLERANCE:
            yield (
                f"frame {k + 1}{' and the next' if u else ''}: {pair[0]} - {pair[1]} "
                f"are {1e3 * d:.3f} mm apart, claimed {1e3 * claim:.3f} mm"
            )
        elif d < 0.0 and frozenset(pair) in decide:
            below = referee.distances_below(q, 0.0).items()
            others = {frozenset(referee.pairs[i]) for i, apart in below if apart < 0.0}
            for a, b in map(sorted, others.difference(decide)):
                yield f"frame {k + 1}: {a} - {b} penetrate"
        elif d < 0.0:
            a, b = pair
            yield f"frame {k + 1}: {a} - {b} penetrate by {-1e3 * d:.3f} mm"


def _meshes(found: MeshClearance) -> dict:
    """Of each pair its smallest bounds, rounded down; and where something is not shown:
    the pair's index in mesh_pairs, with the frames, or the frames that ways begin at,
    counted from 0."""
    order = np.argsort(found.near)

    def where(mask: np.ndarray) -> list:
        some = (k for k in order if mask[k].any())
        return [[int(found.near[k]), np.flatnonzero(mask[k]).tolist()] for k in some]

    def rounded_down(values: np.ndarray) -> list:
        return (np.floor(values * 1e9) / 1e9).tolist()

    return {
        "at_frames": rounded_down(found.least_at),
        # Of a single frame there are no ways.
        "on_ways": rounded_down(np.minimum(found.least_on, found.least_at)),
        "touch_at": where(found.touch_at),
        "touch_on": where(found.touch_on),
        "not_shown": where(found.not_shown),
    }


def _smallest(frames: dict, pairs: Sequence[Sequence[str]]) -> dict:
    """What a motion's frames keep at least.

    Raises:
        ValueError: lists of frames are of different lengths, or there is no such pair.
    """
    distance, pair = frames["distance"], frames["pair"]
    if len(distance) != len(pair):
        raise ValueError("its pairs are of another number of frames")
    if not all(0 <= k < len(pairs) for k in pair):
        raise ValueError("a frame's pair is none that is watched")
    return {
        "distance": min(distance),
        "between": min(frames["between"]),
        "pair": list(pairs[pair[distance.index(min(distance))]]),
        "limit": min(frames["limit"]),
        "speed": max(frames["speed"]),
    }
