"""The certificate beside a cleaned motion: what it keeps, of which files it holds.

A JSON file. `make_certificate` measures the file that was written, by the distances
and the bounds of the control law; `check_certificate` reads the same file again and
asks the referee, which shares no code with these.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from crar_drake import __version__
from crar_drake.errors import CrarError
from crar_drake.files import whole_file
from crar_drake.references.margins import Margins
from crar_drake.references.robot_motion import read_motions
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.referee import Referee
from crar_drake.robot.description import (
    LIMIT_TOLERANCE,
    SPEED_TOLERANCE,
    RobotDescription,
)

KIND = "crar-drake certificate of a reference motion"
FORMAT = 1

# By so much less than what is claimed may be found: rounding [m].
DISTANCE_TOLERANCE = 1e-6
# Points on the way to the next frame that the referee looks at.
_BETWEEN = 3

_HOW = ("as wished", "corrected", "scaled")


@dataclass(frozen=True)
class CertifiedClip:
    """What is claimed of one motion of a file.

    Attributes:
        clip: its name; "" in files with one motion.
        rate: frames per second [Hz].
        margins: what it keeps.
        admitted: (T,) how the steps to each frame were admitted, see `Cleaned`; -1
            where it was not followed by the law.
    """

    clip: str
    rate: float
    margins: Margins
    admitted: np.ndarray


def certificate_path(motion: str | os.PathLike[str]) -> Path:
    """Where the certificate of a motion's file is: NAME.certificate.json beside it."""
    path = Path(motion)
    return path.with_name(f"{path.stem}.certificate.json")


def file_hash(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def robot_files(description: RobotDescription) -> dict[str, str]:
    """Name to hash of the files that say what the robot is: description and model."""
    folder = Path(description.folder)
    files = [folder / "robot.yaml", folder / description.model]
    return {path.name: file_hash(path) for path in files if path.is_file()}


def make_certificate(
    motion: Path,
    reference: Path,
    description: RobotDescription,
    clips: Sequence[CertifiedClip],
    floor: float,
) -> dict:
    """The contents of a certificate.

    Args:
        motion: the file that was written.
        reference: the file that it was made from.
        description: of the robot.
        clips: what its motions keep.
        floor: that distances were to keep [m].
    """
    return {
        "kind": KIND,
        "format": FORMAT,
        "version": __version__,
        "motion": {"file": motion.name, "sha256": file_hash(motion)},
        "reference": {"file": reference.name, "sha256": file_hash(reference)},
        "robot": {
            "name": description.name,
            "files": robot_files(description),
            "watched_pairs": len(description.pairs),
        },
        "checked": {
            "distance": "watched pairs by their capsules and spheres [m]; between: a "
            "bound for the straight way in joint space to the next frame",
            "limit": "to the nearest joint limit [rad or m]",
            "speed": "largest share of a joint's speed limit to the next frame",
            "floor": floor,
        },
        "clips": [_clip(each, description.pairs) for each in clips],
    }


def write_certificate(path: Path, certificate: dict) -> None:
    """Writes it, whole or not at all.

    Raises:
        WriteError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(certificate, indent=1) + "\n")


def read_certificate(path: str | os.PathLike[str]) -> dict:
    """Reads it.

    Raises:
        CrarError: it is not there, or not one of this format; the message names it.
    """
    try:
        certificate = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CrarError(
            f"{path}: there is no certificate; crar-drake clean writes it beside the "
            "motion"
        ) from None
    except (OSError, ValueError) as error:
        raise CrarError(f"{path}: is no certificate: {error}") from error
    if not isinstance(certificate, dict) or certificate.get("kind") != KIND:
        raise CrarError(f"{path}: is no certificate of a reference motion")
    if certificate.get("format") != FORMAT:
        raise CrarError(
            f"{path}: has format {certificate.get('format')!r}, and this version "
            f"reads {FORMAT}"
        )
    return certificate


@dataclass
class CertificateCheck:
    """Whether a certificate holds.

    Attributes:
        refuted: what does not, a sentence each; empty if all does.
        frames: that were looked at.
        points: between frames that were looked at.
        distance: the smallest that the referee found [m]; infinite without pairs.
        pair: of which links; None without.
        limit: the smallest margin to a joint limit [rad or m].
        speed: the largest share of a speed limit.
    """

    refuted: list[str] = field(default_factory=list)
    frames: int = 0
    points: int = 0
    distance: float = math.inf
    pair: tuple[str, str] | None = None
    limit: float = math.inf
    speed: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether nothing refutes it."""
        return not self.refuted


def check_certificate(
    motion: Path, certificate: dict, description: RobotDescription
) -> CertificateCheck:
    """Whether a certificate is of this file and this robot, and true.

    Every frame is judged by the referee, and some points on the way to the next. They
    can refute a bound, not prove it. Besides, nothing may be violated: a certificate
    that truly tells of a penetration does not hold.

    Args:
        motion: the file.
        certificate: of it, as it was read.
        description: of the robot.

    Raises:
        MotionError: the file cannot be read, or is of another robot.
        CrarError: the certificate lacks something.
    """
    check = CertificateCheck()
    try:
        if certificate["motion"]["sha256"] != file_hash(motion):
            check.refuted.append(f"it is of another file than {motion}, or of a former")
            return check
        if certificate["robot"]["files"] != robot_files(description):
            check.refuted.append(
                f"robot {description.name} has other files than it was made with"
            )
            return check
        clips = {clip["clip"]: clip for clip in certificate["clips"]}
        robot = WholeBody(description)
        referee = Referee(
            robot.plant,
            robot.scene_graph,
            description.pairs,
            robot.plant_speed_limits(),
        )
        of_file = certificate["motion"]
        motions = read_motions(motion, of_file["layout"], of_file["rate"], robot=robot)
        for each in motions:
            if each.clip not in clips:
                check.refuted.append(f"clip {each.clip!r} is not in it")
                continue
            claimed = clips[each.clip]
            if not math.isclose(each.rate, claimed["rate"], rel_tol=1e-9):
                check.refuted.append(
                    f"the motion is of {each.rate:g} Hz, and it says "
                    f"{claimed['rate']:g}"
                )
            _check_clip(check, claimed, each.joint_positions, robot, referee)
    except (KeyError, TypeError, AttributeError) as error:
        raise CrarError(f"the certificate of {motion} lacks {error}") from error
    return check


def _check_clip(check, claimed, joints, robot: WholeBody, referee: Referee) -> None:
    """Adds what one motion's claims and the referee's findings are."""
    claims = claimed["frames"]
    told = {
        name: np.asarray(claims[name], dtype=float)
        for name in ("distance", "between", "limit", "speed")
    }
    if any(values.shape != (len(joints),) for values in told.values()):
        check.refuted.append(f"it is not of {len(joints)} frames")
        return
    rate, q = claimed["rate"], robot.configurations(joints)
    limit = np.minimum(joints - robot.lower, robot.upper - joints).min(axis=1)
    speed = np.zeros(len(joints))
    steps = np.abs(np.diff(joints, axis=0)) * rate
    speed[:-1] = (steps / robot.speed_limits).max(axis=1)
    for name, found, worse in (
        ("limit", limit, limit < told["limit"] - LIMIT_TOLERANCE),
        ("speed", speed, speed > told["speed"] + SPEED_TOLERANCE),
    ):
        if worse.any():
            k = int(worse.argmax())
            check.refuted.append(
                f"frame {k + 1}: {name} is {found[k]:.6g}, claimed {told[name][k]:.6g}"
            )
    if limit.min() < -LIMIT_TOLERANCE:
        check.refuted.append(f"frame {limit.argmin() + 1} is beyond a joint limit")
    if speed.max() > 1.0 + SPEED_TOLERANCE:
        check.refuted.append(f"frame {speed.argmax() + 1} is beyond a speed limit")
    check.limit = min(check.limit, float(limit.min()))
    check.speed = max(check.speed, float(speed.max()))
    for k in range(len(q)):
        _check_frame(check, k, q[k : k + 2], told, referee)


def _check_frame(check, k: int, ends, told, referee: Referee) -> None:
    """A frame, and points on the way to the next."""
    points = [(0.0, told["distance"][k])]
    if len(ends) > 1:
        inner = np.linspace(0.0, 1.0, _BETWEEN + 2)[1:-1]
        points += [(u, told["between"][k]) for u in inner]
    for u, claim in points:
        q = ends[0] + u * (ends[-1] - ends[0])
        # Nothing beyond the claim, or the nearest so far, is of interest.
        d, pair = referee.nearest(q, max(claim, check.distance, 0.0) + 1e-3)
        check.frames += u == 0.0
        check.points += u > 0.0
        if d < check.distance:
            check.distance, check.pair = d, pair
        if d < claim - DISTANCE_TOLERANCE:
            check.refuted.append(
                f"frame {k + 1}{' and the next' if u else ''}: {pair[0]} - {pair[1]} "
                f"are {1e3 * d:.3f} mm apart, claimed {1e3 * claim:.3f} mm"
            )
        elif d < 0.0:
            check.refuted.append(
                f"frame {k + 1}: {pair[0]} - {pair[1]} penetrate by {-1e3 * d:.3f} mm"
            )


def _clip(each: CertifiedClip, pairs: Sequence[Sequence[str]]) -> dict:
    m = each.margins
    nearest = int(m.distance.argmin())
    admitted = [_HOW[int(how)] if how >= 0 else "unchanged" for how in each.admitted]
    return {
        "clip": each.clip,
        "rate": each.rate,
        "smallest": {
            "distance": float(m.distance.min()),
            "between": float(m.between.min()),
            "pair": list(pairs[int(m.pair[nearest])]),
            "limit": float(m.limit.min()),
            "speed": float(m.speed.max()),
        },
        "steps": {how: admitted.count(how) for how in dict.fromkeys(admitted)},
        "frames": {
            "distance": m.distance.tolist(),
            "pair": m.pair.tolist(),
            "between": m.between.tolist(),
            "limit": m.limit.tolist(),
            "speed": m.speed.tolist(),
            "admitted": [int(how) for how in each.admitted],
        },
    }
