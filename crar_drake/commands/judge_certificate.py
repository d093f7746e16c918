"""`crar-drake judge --certificate`: whether a cleaned motion's certificate holds."""

import argparse
from pathlib import Path
from typing import NamedTuple

from crar_drake.commands.output import counted, final_line, tell_failure
from crar_drake.errors import CrarError, MotionError, printable

# Sentences of what refutes a certificate that are reported.
_MOST_LINES = 10


def judge_certificates(arguments: argparse.Namespace) -> int:
    """Checks the certificates beside motions.

    Args:
        arguments: `what`, the motions' files, or folders of them; `robot`, where
            their robot is, or None for the name in the certificate.

    Returns:
        The exit code, as of `final_line`: violated is a certificate that is of another
        file or robot or not true, and what it says is wrong with its motion. One that
        cannot be read is reported, and does not end the check of others.

    Raises:
        CrarError: the only motion or its certificate cannot be read.
    """
    from crar_drake.references.folders import references_in

    motions, found = references_in(arguments.what), []
    for motion in motions:
        try:
            found.append(_judge(motion, arguments.robot))
        except CrarError as error:
            if len(motions) == 1:
                raise
            tell_failure(error)
    refuted, unread = sum(not told.holds for told in found), len(motions) - len(found)
    if len(motions) == 1:
        untrue = ["the certificate does not hold"] * refuted + found[0].faults
    else:
        faulty = sum(bool(told.faults) for told in found)
        untrue = counted(refuted, "certificate", f"of {len(motions)} not true")
        untrue += counted(faulty, "motion", "with faults")
    return final_line(
        untrue,
        guessed=[guess for told in found for guess in told.guessed],
        left=[words for told in found for words in told.left],
        unread=f"{unread} of {len(motions)} cannot be read" if unread else "",
    )


class _Told(NamedTuple):
    """What a certificate says, and whether it holds."""

    holds: bool
    guessed: list[str]  # of the motion's reference
    faults: list[str]  # kinds of what is wrong with it besides
    left: list[str]  # of each clip that which was left as it was, or ""


def _judge(motion: Path, robot: str | None) -> _Told:
    """Whether that of one motion holds, and what it says of it."""
    from crar_drake.references.certificate_files import (
        certificate_path,
        read_certificate,
    )
    from crar_drake.references.motion_certificate import check_certificate
    from crar_drake.robot.description import load_robot_description, whole_body_name

    if not motion.is_file():
        raise MotionError(f"{motion}: there is no such file")
    place = certificate_path(motion)
    certificate = read_certificate(place)
    try:
        description = load_robot_description(
            whole_body_name(robot or certificate["robot"]["name"])
        ).without_ground()
    except CrarError as error:
        if robot:
            raise
        raise CrarError(
            f"{place}: its robot is not to be had ({error}); say where it is (--robot)"
        ) from error
    check = check_certificate(motion, certificate, description)
    if check.frames:
        pair = "" if check.pair is None else f" ({check.pair[0]} - {check.pair[1]})"
        near = f", smallest distance {1e3 * check.distance:.3f} mm{pair}"
        print(
            f"referee, collision shapes, {check.frames} frames and {check.points} "
            f"points between them{near if check.pair else ''}; smallest margin to a "
            f"joint limit {check.limit:.4g}, largest share of a speed limit "
            f"{check.speed:.3f}"
        )
    if check.mesh_frames:
        print(
            f"meshes, {check.mesh_pairs} pairs, {check.mesh_frames} frames and "
            f"{check.mesh_points} points between them"
        )
    if check.why_not:
        print(f"nobody looked at meshes: {check.why_not}")
    if check.uncovered:
        print(f"not covered: {check.uncovered} pairs that can meet, by what it says")
    guessed = certificate["motion"]["guessed"]
    for guess in guessed:
        print(f"guessed: {printable(guess)}")
    faults, left = [], []
    for clip in certificate["clips"]:
        which = f"{printable(clip['clip'])}: " if clip["clip"] else ""
        for fault in clip["faults"]:
            print(f"it says: {which}{printable(': '.join(filter(None, fault)))}")
            faults.append(printable(fault[0]))
        left.append(printable("; ".join(clip["left_as_it_was"])))
    told = _Told(check.holds, guessed, list(dict.fromkeys(faults)), left)
    if check.holds:
        print(f"{place}: nothing refutes it")
        return told
    print(f"{place}: DOES NOT HOLD")
    for line in check.refuted[:_MOST_LINES]:
        print(f"  {printable(line)}")
    if len(check.refuted) > _MOST_LINES:
        print(f"  and {len(check.refuted) - _MOST_LINES} more")
    return told
