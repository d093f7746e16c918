"""A reference motion's verdict: in words, as a row of a table, as data, and drawn."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np

from crar_drake.errors import plural
from crar_drake.judging.mesh_judge import PairContact
from crar_drake.references.faults import spans
from crar_drake.references.reference_judge import (
    Beyond,
    ReferenceVerdict,
    frames_of,
)

# Pairs and joints that are reported one by one.
_MOST = 5

HEADER = (
    "motion",
    "frames",
    "meshes",
    "deepest",
    "capsules",
    "limits",
    "speeds",
    "ground",
    "jumps",
    "slip",
    "root, m/s²",
    "verdict",
)


def verdict_row(verdict: ReferenceVerdict) -> tuple[str, ...]:
    """A row of the table with `HEADER`: shares of frames, millimetres, numbers."""
    motion = verdict.motion
    judged, deepest = "-", "-"
    if verdict.meshes is not None:
        judged = _percent(len(verdict.penetrating_frames), len(verdict.meshes.frames))
        deepest = _millimetres(max((p.depth for p in verdict.mesh_pairs), default=0.0))
    capsules = "-"
    if verdict.capsules is not None:
        capsules = _percent(len(verdict.capsule_frames), motion.num_frames)
    slip = max((foot.worst for foot in verdict.ground.feet), default=np.nan)
    return (
        name_of(verdict),
        str(motion.num_frames),
        judged,
        deepest,
        capsules,
        _percent(len(frames_of(verdict.limits)), motion.num_frames),
        _percent(len(frames_of(verdict.speeds)), max(1, motion.num_frames - 1)),
        _millimetres(verdict.ground.lowest.min()),
        str(len(verdict.jumps)),
        "-" if np.isnan(slip) else _millimetres(slip),
        "{:.1f} / {:.1f}".format(*verdict.root_acceleration),
        "; ".join(verdict.violations) or "clean",
    )


def name_of(verdict: ReferenceVerdict) -> str:
    """The file's name, and the clip's if it has several."""
    name = verdict.motion.source.rpartition("/")[2]
    return f"{name}:{verdict.motion.clip}" if verdict.motion.clip else name


def verdict_lines(verdict: ReferenceVerdict) -> Iterator[str]:
    """Yields lines for a person to read."""
    motion = verdict.motion
    clip = f", clip {motion.clip}" if motion.clip else ""
    yield (
        f"{motion.source}{clip}: {motion.layout}, {motion.num_frames} frames at "
        f"{motion.rate:g} Hz, {motion.num_joints} joints"
    )
    for guess in motion.guesses:
        yield f"  guessed: {guess}"
    yield from _mesh_lines(verdict)
    if verdict.capsules is None:
        yield f"  capsules: not judged: {verdict.why_no_capsules}"
    else:
        yield (
            f"  capsules: {_of(len(verdict.capsule_frames), motion.num_frames)} in "
            "penetration" + _smallest(verdict.capsule_distances, motion.rate)
        )
        yield from _pair_lines(verdict.capsules, motion.rate)
    yield from _beyond_lines("joint limits", verdict.limits, "rad", motion.rate)
    yield from _beyond_lines("speed limits", verdict.speeds, "rad/s", motion.rate)
    ground = verdict.ground
    lowest = int(ground.lowest.argmin())
    yield (
        f"  ground: lowest {1e3 * ground.lowest[lowest]:z.1f} mm "
        f"({ground.lowest_links[lowest]}) at {lowest / motion.rate:.2f} s; feet stand "
        f"at {1e3 * ground.floor:z.1f} mm"
    )
    for foot in ground.feet:
        text = (
            f"  {foot.foot}: planted {100 * foot.planted.mean():.0f} % of the time, "
            f"{foot.num_contacts} contacts; slips {1e3 * foot.total:.0f} mm in all"
        )
        if foot.worst_start is not None:
            text += (
                f", {1e3 * foot.worst:.0f} mm at most in one, from "
                f"{foot.worst_start / motion.rate:.2f} to "
                f"{foot.worst_end / motion.rate:.2f} s, at up to "
                f"{foot.top_speed:.2f} m/s"
            )
        yield text
    if not ground.feet:
        yield "  feet: the robot has no frames left_foot and right_foot"
    rms, peak = verdict.root_acceleration
    yield f"  root: accelerates by rms {rms:.1f}, peak {peak:.1f} m/s²"
    yield (
        f"  jerk: rms {verdict.rms_jerk:.0f}, peak {verdict.peak_jerk:.0f} rad/s³ "
        f"({verdict.peak_jerk_joint})"
    )
    for jump in verdict.jumps[:_MOST]:
        yield (
            f"  jump: {jump.what} by {jump.size:.3g} {jump.unit} to frame "
            f"{jump.frame + 1} ({jump.frame / motion.rate:.2f} s)"
        )
    yield from _more(len(verdict.jumps))
    for fault in verdict.faults:
        was = ", left as it was" if fault.kind in verdict.left else ""
        yield f"  {fault}{was}"
    violated = ", ".join(verdict.violations)
    yield f"  VIOLATED: {violated}" if violated else "  clean"


def verdict_data(verdict: ReferenceVerdict) -> dict:
    """The verdict for JSON: SI units; frames are counted from 0."""
    motion, meshes, ground = verdict.motion, verdict.meshes, verdict.ground
    lowest = int(ground.lowest.argmin())
    data = {
        "file": motion.source,
        "clip": motion.clip,
        "layout": motion.layout,
        "rate": motion.rate,
        "frames": motion.num_frames,
        "joints": list(motion.joint_names),
        "guesses": list(motion.guesses),
        "violations": list(verdict.violations),
        "left_as_it_was": list(verdict.left_as_it_was),
        "meshes": None,
        "capsules": None,
        "limits": [asdict(beyond) for beyond in verdict.limits],
        "speeds": [asdict(beyond) for beyond in verdict.speeds],
        "ground": {
            "lowest": float(ground.lowest[lowest]),
            "frame": lowest,
            "link": ground.lowest_links[lowest],
            "floor": ground.floor,
        },
        "feet": [
            {
                "foot": foot.foot,
                "planted": float(foot.planted.mean()),
                "contacts": foot.num_contacts,
                "slip": foot.total,
                "worst_slip": foot.worst,
                "worst_frames": [foot.worst_start, foot.worst_end],
                "top_speed": foot.top_speed,
            }
            for foot in verdict.ground.feet
        ],
        "jumps": [asdict(jump) for jump in verdict.jumps],
        "root_acceleration": dict(
            zip(("rms", "peak"), verdict.root_acceleration, strict=True)
        ),
        "jerk": {
            "rms": verdict.rms_jerk,
            "peak": verdict.peak_jerk,
            "joint": verdict.peak_jerk_joint,
        },
    }
    if meshes is not None:
        nearest = meshes.nearest.distance
        data["meshes"] = {
            "judged_frames": len(meshes.frames),
            "judged_pairs": meshes.num_pairs,
            "penetrating_frames": list(verdict.penetrating_frames),
            "smallest_distance": nearest if np.isfinite(nearest) else None,
            "pairs": [_pair_data(pair) for pair in verdict.mesh_pairs],
            "left_out": [list(pair) for pair in meshes.left_out],
        }
    if verdict.capsules is not None:
        data["capsules"] = {
            "penetrating_frames": list(verdict.capsule_frames),
            "pairs": [_pair_data(pair) for pair in verdict.capsules],
        }
    return data


def plot_verdict(verdict: ReferenceVerdict, path: str | os.PathLike[str]) -> None:
    """Draws distances, limits, speeds and heights over time.

    Args:
        verdict: of the motion.
        path: the figure's file; its suffix (.png, .pdf, .svg) chooses the format.

    Raises:
        CrarError: there is no such format, or the file cannot be written.
    """
    from matplotlib.figure import Figure

    from crar_drake.figures import save_figure

    motion = verdict.motion
    times = motion.times
    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    pairs, limits, speeds, ground = figure.subplots(4, 1, sharex=True)
    found = ", ".join(verdict.violations) or "clean"
    figure.suptitle(f"{name_of(verdict)}: {found}", fontsize="medium", wrap=True)
    pairs.plot(times, 1e3 * verdict.capsule_distances, label="capsules", linewidth=0.8)
    if verdict.meshes is not None:
        depths = -1e3 * verdict.mesh_depths()
        pairs.plot(
            times[verdict.meshes.frames],
            np.where(depths < 0.0, depths, np.nan),
            "r.",
            markersize=3.0,
            label="meshes, where they penetrate",
        )
    pairs.axhline(0.0, color="black", linewidth=0.6)
    pairs.set_ylabel("smallest distance [mm]")
    pairs.legend(fontsize="x-small")
    limits.plot(times, verdict.limit_excess, linewidth=0.8)
    limits.axhline(0.0, color="black", linewidth=0.6)
    limits.set_ylabel("beyond a joint limit [rad]")
    speeds.plot(times[1:], verdict.speed_ratio, linewidth=0.8)
    speeds.axhline(1.0, color="black", linewidth=0.6)
    speeds.set_ylabel("share of a speed limit")
    ground.plot(times, 1e3 * verdict.ground.lowest, color="black", linewidth=0.8)
    ground.axhline(0.0, color="black", linewidth=0.6)
    low, high = ground.get_ylim()
    for row, foot in enumerate(verdict.ground.feet):
        bottom = low - (0.06 * (row + 1)) * (high - low)
        ground.fill_between(
            times,
            bottom,
            bottom + 0.04 * (high - low),
            where=foot.planted,
            color=("tab:blue", "tab:orange")[row % 2],
            label=f"{foot.foot} planted",
        )
    ground.set_ylabel("lowest point [mm]")
    ground.set_xlabel("time [s]")
    if verdict.ground.feet:
        ground.legend(fontsize="x-small")
    for jump in verdict.jumps:
        for axes in (pairs, limits, speeds, ground):
            axes.axvline(
                jump.frame / motion.rate, color="tab:red", linewidth=0.6, alpha=0.6
            )
    pairs.margins(x=0.0)
    save_figure(figure, path)


def _mesh_lines(verdict: ReferenceVerdict) -> Iterator[str]:
    meshes, rate = verdict.meshes, verdict.motion.rate
    if meshes is None:
        yield "  meshes: not judged"
        return
    penetrating = _of(len(verdict.penetrating_frames), len(verdict.meshes.frames))
    text = (
        f"  meshes: {penetrating} in penetration, {meshes.num_pairs} pairs more than "
        "one joint apart"
    )
    if meshes.nearest.pair is not None and not verdict.mesh_pairs:
        a, b = meshes.nearest.pair
        nearest = _millimetres(meshes.nearest.distance)
        text += f", smallest distance {nearest} ({a} - {b})"
    yield text
    yield from _pair_lines(verdict.mesh_pairs, rate)
    if meshes.left_out:
        pairs = ", ".join(f"{a} - {b}" for a, b in meshes.left_out)
        yield f"  left out, since their meshes meet at zero and at rest: {pairs}"


def _pair_lines(pairs: Sequence[PairContact], rate: float) -> Iterator[str]:
    for pair in pairs[:_MOST]:
        yield (
            f"    {pair.pair[0]} - {pair.pair[1]}: {plural(len(pair.frames), 'frame')} "
            f"({spans(pair.frames)}), deepest {1e3 * pair.depth:.1f} mm at "
            f"{pair.frame / rate:.2f} s"
        )
    yield from _more(len(pairs))


def _beyond_lines(
    what: str, beyond: tuple[Beyond, ...], unit: str, rate: float
) -> Iterator[str]:
    yield f"  {what}: " + (
        f"{plural(len(frames_of(beyond)), 'frame')} beyond" if beyond else "none beyond"
    )
    for joint in beyond[:_MOST]:
        yield (
            f"    {joint.joint}: {plural(len(joint.frames), 'frame')} "
            f"({spans(joint.frames)}), by up to {joint.excess:.3g} {unit} at "
            f"{joint.frame / rate:.2f} s"
        )
    yield from _more(len(beyond))


def _more(number: int) -> Iterator[str]:
    if number > _MOST:
        yield f"    and {number - _MOST} more"


def _smallest(distances: np.ndarray, rate: float) -> str:
    if np.isnan(distances).all():
        return ""
    frame = int(np.nanargmin(distances))
    least = _millimetres(distances[frame])
    return f", smallest distance {least} at {frame / rate:.2f} s"


def _of(number: int, total: int) -> str:
    return f"{number} of {total} frames ({_percent(number, total)})"


def _percent(number: int, total: int) -> str:
    return f"{100.0 * number / total:.1f} %"


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.1f} mm"


def _pair_data(pair: PairContact) -> dict:
    return {**asdict(pair), "deepest": pair.depth, "deepest_frame": pair.frame}
