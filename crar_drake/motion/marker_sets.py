"""Joint centres of markers on the skin, by the common full-body marker sets.

Known are Vicon's Plug-in Gait and the 41 markers of the CMU database, which differ at
the waist (LASI, LPSI against LFWT, LBWT). Where each centre comes from:

- hips: regression of M. E. Harrington et al., Prediction of the hip joint centre in
  adults, children, and patients with cerebral palsy based on magnetic resonance
  imaging, J. Biomechanics 40 (2007), from the width and depth of the pelvis. CMU's
  waist markers stand in for the iliac spines.
- shoulders: G. Rab, K. Petuskey and A. Bagley, A method for determination of upper
  extremity kinematics, Gait & Posture 15 (2002): below the marker by 17 % of the
  distance between the shoulder markers.
- knees, ankles, elbows: half the joint's width inwards from the marker at its outer
  side, as Plug-in Gait does: widths of the file, else typical ones of adults. Inwards
  is across shank and foot, or across the plane of the bent arm.
- pelvis, neck, wrists, head: the mean of the markers about them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import across, unit_vectors
from crar_drake.motion.performer import SIDES

_WAISTS = {
    "Plug-in Gait": {"front": "{}ASI", "back": "{}PSI"},
    "CMU's 41 markers": {"front": "{}FWT", "back": "{}BWT"},
}
_SACRUM = ("SACR", "SACRUM")
_NEEDED = ("C7", "CLAV", "STRN", "T10")
_NEEDED_SIDES = ("SHO", "ELB", "WRA", "WRB", "KNE", "ANK", "HEE", "TOE")
_HEAD = ("LFHD", "RFHD", "LBHD", "RBHD")

# Typical of adults, from centre to the marker's: half of joint width and marker [m].
_HALF_WIDTHS = {"Knee": 0.058, "Ankle": 0.042, "Elbow": 0.041}
_MARKER_RADIUS = 0.007  # [m]

# The plane of an arm that is almost straight is that of the time around.
_PLANE_WINDOW = 0.5  # [s]


@dataclass(frozen=True)
class MarkerBody:
    """Joint centres of a body with markers, in metres and the file's axes."""

    positions: dict[str, np.ndarray]  # joint to (T, 3)
    sources: dict[str, str]  # joint to what it is computed of
    pelvis_up: np.ndarray  # (T, 3) normal of the pelvis's plane
    # hand to (to its fingertips, to the thumb's side), (T, 3) each
    hands: dict[str, tuple[np.ndarray, np.ndarray]]


def choose_markers(labels: Sequence[str], name: str) -> tuple[str, str, dict[str, str]]:
    """The marker set, the subject's prefix, and marker to its label.

    Raises:
        MotionError: the labels are of no known set; the message lists them.
    """
    subjects: dict[str, dict[str, str]] = {}
    for label in labels:
        prefix, _, marker = label.rpartition(":")
        subjects.setdefault(prefix, {}).setdefault(marker.upper(), label)
    best = None
    for subject, markers in subjects.items():
        for marker_set, waist in _WAISTS.items():
            missing = _missing(markers, waist)
            if best is None or len(missing) < len(best[0]):
                best = missing, marker_set, subject
    assert best is not None
    missing, marker_set, subject = best
    if missing:
        shown = ", ".join(labels[:60]) + (" ..." if len(labels) > 60 else "")
        raise MotionError(
            f"motion {name}: its markers are of no set that is known "
            f"({', '.join(_WAISTS)}); {marker_set} would need {', '.join(missing)}, "
            f"too. Markers in the file: {shown}"
        )
    return marker_set, subject, subjects[subject]


def _missing(markers: Mapping[str, str], waist: Mapping[str, str]) -> list[str]:
    needed = list(_NEEDED)
    needed += [f"{s}{marker}" for s in "LR" for marker in _NEEDED_SIDES]
    needed += [waist["front"].format(s) for s in "LR"]
    if not any(marker in markers for marker in _SACRUM):
        needed += [waist["back"].format(s) for s in "LR"]
    return [marker for marker in needed if marker not in markers]


def marker_body(
    points: Mapping[str, np.ndarray],
    marker_set: str,
    measures: Mapping[str, float],
    frame_rate: float,
) -> MarkerBody:
    """Returns joint centres.

    Args:
        points: marker without prefix to (T, 3), without gaps [m].
        marker_set: from `choose_markers`.
        measures: of the subject, e.g. "LKneeWidth" [m].
        frame_rate: samples per second [Hz].
    """
    waist = _WAISTS[marker_set]
    front = [points[waist["front"].format(s)] for s in "LR"]
    sacrum = next((points[m] for m in _SACRUM if m in points), None)
    backs = [waist["back"].format(s) for s in "LR"]
    if all(marker in points for marker in backs):
        back = (points[backs[0]] + points[backs[1]]) / 2.0
    else:
        back = sacrum
    middle = (front[0] + front[1]) / 2.0
    y = unit_vectors(front[0] - front[1])
    x = unit_vectors(across(middle - back, y))
    z = np.cross(x, y)
    p = {"pelvis": (middle + back) / 2.0}
    sources = {"pelvis": "mean of the waist's markers"}
    p |= _hips(front, back, middle, (x, y, z))
    down = (points["T10"] + points["STRN"] - points["C7"] - points["CLAV"]) / 2.0
    drop = 0.17 * np.linalg.norm(points["LSHO"] - points["RSHO"], axis=1, keepdims=True)
    p["neck"] = (points["C7"] + points["CLAV"]) / 2.0
    sources["neck"] = "mean of C7, CLAV"
    if all(marker in points for marker in _HEAD):
        p["head"] = np.mean([points[marker] for marker in _HEAD], axis=0)
        sources["head"] = "mean of the head's markers"
    hands = {}
    for side in SIDES:
        s = side[0].upper()
        sources[f"{side}_hip"] = "Harrington's regression"
        sources[f"{side}_shoulder"] = f"Rab's offset from {s}SHO"
        shoulder = points[f"{s}SHO"] + drop * unit_vectors(down)
        wrist = (points[f"{s}WRA"] + points[f"{s}WRB"]) / 2.0
        p[f"{side}_shoulder"], p[f"{side}_wrist"] = shoulder, wrist
        sources[f"{side}_wrist"] = f"mean of {s}WRA, {s}WRB"
        inwards = _across_arm(shoulder, points[f"{s}ELB"], wrist, frame_rate)
        inwards = inwards if side == "left" else -inwards
        p[f"{side}_elbow"] = points[f"{s}ELB"] + _half(measures, s, "Elbow") * inwards
        sources[f"{side}_elbow"] = f"half its width from {s}ELB"
        # Across shank and foot: up x forward = left.
        ahead = points[f"{s}TOE"] - points[f"{s}HEE"]
        inwards = unit_vectors(np.cross(points[f"{s}KNE"] - points[f"{s}ANK"], ahead))
        inwards = -inwards if side == "left" else inwards
        for joint, marker in (("Knee", "KNE"), ("Ankle", "ANK")):
            offset = _half(measures, s, joint) * inwards
            p[f"{side}_{joint.lower()}"] = points[s + marker] + offset
            sources[f"{side}_{joint.lower()}"] = f"half its width from {s}{marker}"
        p[f"{side}_toe"] = points[f"{s}TOE"]
        sources[f"{side}_toe"] = f"{s}TOE"
        fingers = points.get(f"{s}FIN")
        tips = fingers - wrist if fingers is not None else wrist - p[f"{side}_elbow"]
        hands[f"{side}_hand"] = tips, points[f"{s}WRA"] - points[f"{s}WRB"]
    return MarkerBody(p, sources, z, hands)


def _half(measures: Mapping[str, float], side: str, joint: str) -> float:
    """From a marker's centre to the joint's [m]."""
    width = measures.get(f"{side}{joint}Width")
    return _HALF_WIDTHS[joint] if width is None else width / 2.0 + _MARKER_RADIUS


def _hips(front, back, middle, axes) -> dict[str, np.ndarray]:
    """Hip centres by Harrington et al., from the middle between the front markers."""
    x, y, z = axes
    width = float(np.median(np.linalg.norm(front[0] - front[1], axis=1)))
    depth = float(np.median(np.linalg.norm(middle - back, axis=1)))
    ahead = -0.24 * depth - 0.0099
    up = -0.30 * width - 0.0109
    out = 0.33 * width + 0.0073
    inner = middle + ahead * x + up * z
    return {"left_hip": inner + out * y, "right_hip": inner - out * y}


def _across_arm(
    shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, frame_rate: float
) -> np.ndarray:
    """(T, 3) normal of the arm's plane, inwards at the left; 0 if it never bends."""
    # To import it takes a while, which only those wait for who have markers.
    from scipy.ndimage import uniform_filter1d

    along = unit_vectors(elbow - shoulder)
    normal = np.cross(along, unit_vectors(wrist - elbow))
    window = max(1, round(_PLANE_WINDOW * frame_rate))
    smooth = uniform_filter1d(normal, window, axis=0, mode="nearest")
    # Across the upper arm, in case the arm swings within the window.
    smooth = across(smooth, along)
    size = np.linalg.norm(smooth, axis=1, keepdims=True)
    # Fades out for an arm that stays straight to 6 degrees.
    return smooth / np.maximum(size, 0.1)
