"""What is in a motion file, and what in it looks bad."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF, MIN_FRAMES, low_pass
from crar_drake.motion.leaps import leaps
from crar_drake.motion.performer import Performer, file_joint, pinned_pelvis
from crar_drake.motion.planted_feet import runs

# A bone turns by more than this against its parent in one frame: a flip. In the CMU
# files the fastest limbs of dances and karate turn by 20 to 50 degrees in 1/120 s
# and flips by 60 to 180. At lower rates honest motion turns further in one frame.
_FLIP_ANGLE, _FLIP_RATE = 60.0, 120.0  # [deg], [Hz]
_FLIP_ANGLES = (60.0, 120.0)  # at higher rates, and at the lowest [deg]

# One step differs by more than this speed from both its neighbours: a jump. That is
# 25 mm in 1/120 s; the waist of honest CMU clips stays below 2 m/s.
_JUMP_SPEED = 3.0  # [m/s]

# All values equal for longer than this: a gap somebody filled by holding.
_FROZEN_TIME = 0.05  # [s]

# A joint centre is faster than this for a hundredth of the time: the frame rate is in
# doubt. Of 25 CMU trials (dances, runs, kicks, boxing, karate, dives) none comes
# beyond 6.8 m/s at its own rate, eight come beyond 9 m/s at twice that and all but
# six at four times. What is slow at the wrong rate, too, cannot be seen.
_IMPLAUSIBLE_SPEED = 9.0  # [m/s]
_SPEED_QUANTILE = 0.99
_FLIP_VICINITY = 0.1  # that the low-pass smears a flip over, on each side [s]
_USUAL_RATES = (120.0, 60.0, 30.0)  # [Hz]


@dataclass(frozen=True)
class Break:
    """A step from one frame to the next that is none of a person's."""

    of: str  # the bone that flips against its parent, or the joint centre that jumps
    frame: int  # number in the file of the frame after it
    # of the rotation [rad]; or by which the step departs from the steps beside it [m]
    size: float


@dataclass(frozen=True)
class MotionReport:
    """What a motion file holds."""

    performer: Performer  # whom the file shows
    # joint centre to its largest speed in the raw data [m/s]; empty if the skeleton has
    # no joint centres
    peak_speeds: dict[str, float]
    flips: tuple[Break, ...] = ()  # of bones, in frame order
    jumps: tuple[Break, ...] = ()  # of joint centres, or of the root, in frame order
    # first and last frame, by their numbers in the file, of frames that are all alike
    frozen: tuple[tuple[int, int], ...] = ()
    # what is implausible as a whole (unit of the angles, the performer's height, the
    # frame rate), each with what would explain it
    doubts: tuple[str, ...] = ()
    obstacle: str = ""  # why the motion cannot drive a robot, or ""

    @property
    def findings(self) -> tuple[str, ...]:
        """What looks bad, in few words each; `describe` says more."""
        return tuple(short for short, _ in _findings(self))

    @property
    def remarks(self) -> tuple[str, ...]:
        """How the file was read, and what looks bad, in few words each."""
        return (*_reading(self.performer), *self.findings)


def inspect(performer: Performer) -> MotionReport:
    """Returns a report of the motion. Nothing that it finds is an error."""
    obstacle, points, rate = performer.obstacle, {}, performer.frame_rate
    try:
        points = performer.centres()
    except MotionError as error:
        obstacle = str(error)
    flip = np.radians(np.clip(_FLIP_ANGLE * _FLIP_RATE / rate, *_FLIP_ANGLES))
    flips = [
        Break(name, int(step) + 2, float(angle[step]))
        for name, angle in performer.turns.items()
        for step in np.flatnonzero(angle > flip)
    ]
    watched = points or {"waist": performer.positions["pelvis"]}
    jumps = [
        Break(name, frame + 1, size)
        for name, samples in watched.items()
        for frame, size in leaps(np.diff(samples, axis=0), _JUMP_SPEED / rate)
    ]
    doubts = list(performer.doubts)
    if pinned := pinned_pelvis(performer):
        doubts.append(f"{pinned}; feet slide, and a whole body cannot follow it")
    elif not doubts:  # else speeds say nothing of the rate
        doubts += _doubt_rate(performer, points, flips)
    return MotionReport(
        performer=performer,
        peak_speeds={
            name: float(_steps(samples).max() * rate)
            for name, samples in points.items()
        },
        flips=tuple(sorted(flips, key=lambda flip: (flip.frame, flip.of))),
        jumps=tuple(sorted(jumps, key=lambda jump: (jump.frame, jump.of))),
        frozen=tuple(
            (begin + 1, end + 1)
            for begin, end in runs(performer.same)
            if (end - begin) / rate > _FROZEN_TIME
        ),
        doubts=tuple(doubts),
        obstacle=obstacle,
    )


def _steps(samples: np.ndarray) -> np.ndarray:
    """Returns the (T - 1,) distances from each sample to the next."""
    return np.linalg.norm(np.diff(samples, axis=0), axis=1)


# --- implausible as a whole -------------------------------------------------------


def _doubt_rate(
    performer: Performer, points: dict[str, np.ndarray], flips: Sequence[Break]
) -> Iterator[str]:
    def top_speeds(rate: float) -> dict[str, float]:
        return {
            name: _usual_top_speed(performer, name, samples, flips, rate)
            for name, samples in points.items()
        }

    speeds = top_speeds(performer.frame_rate)
    fastest = max(speeds, key=speeds.get, default="")
    if not fastest or speeds[fastest] <= _IMPLAUSIBLE_SPEED:
        return
    text = f"{fastest.replace('_', ' ')} reaches {speeds[fastest]:.1f} m/s"
    for rate in _USUAL_RATES:
        if rate < performer.frame_rate:
            # Of all points: the low-pass leaves less of some than of others.
            slower = max(top_speeds(rate).values())
            if slower <= _IMPLAUSIBLE_SPEED:
                yield (
                    f"{text}; at {rate:g} Hz it would be {slower:.1f} m/s: is the rate "
                    f"{rate:g} Hz? --frame-rate {rate:g}"
                )
                return
    yield f"{text}, which no usual frame rate explains"


def _usual_top_speed(
    performer: Performer,
    name: str,
    samples: np.ndarray,
    flips: Sequence[Break],
    rate: float,
) -> float:
    """What a joint centre's speed exceeds for a hundredth of the time [m/s].

    It is that of filtered positions, so that neither noise nor a single bad frame
    counts, and away from flips of what carries the point, where it leaps.
    """
    if len(samples) < MIN_FRAMES:
        return 0.0
    smooth = low_pass(samples, rate, min(DEFAULT_CUTOFF, rate / 4.0))
    speed = _steps(smooth) * rate
    honest = np.ones(len(speed), dtype=bool)
    carriers = performer.carriers.get(file_joint(name), frozenset())
    vicinity = int(np.ceil(_FLIP_VICINITY * rate))
    for flip in flips:
        if flip.of in carriers:
            step = flip.frame - 2
            honest[max(step - vicinity, 0) : step + vicinity + 1] = False
    return float(np.quantile(speed[honest], _SPEED_QUANTILE)) if honest.any() else 0.0


# --- for people -------------------------------------------------------------------


def rate_text(frame_rate: float, rate_source: str) -> str:
    """A frame rate [Hz], and whether it is assumed."""
    return f"{frame_rate:g} Hz" + (", assumed" if rate_source == "assumed" else "")


def describe(report: MotionReport) -> Iterator[str]:
    """Yields the report as lines for a person to read."""
    person = report.performer
    yield (
        f"{person.name}: {person.num_frames} frames at "
        f"{rate_text(person.frame_rate, person.rate_source)}, "
        f"{person.duration:.2f} s, {person.bones} {person.bones_called}, "
        f"{person.height:.2f} m tall"
    )
    yield from _reading(person)
    yield "joints: " + ", ".join(person.matches())
    if report.peak_speeds:
        yield "largest speeds: " + ", ".join(
            f"{name} {speed:.1f} m/s" for name, speed in report.peak_speeds.items()
        )
    if person.hands_obstacle and not report.obstacle:
        yield f"no orientations of hands: {person.hands_obstacle}"
    yield from person.notes
    for _, line in _findings(report):
        yield line
    if not report.findings:
        yield "nothing looks bad"


def _reading(person: Performer) -> Iterator[str]:
    """Yields what the file says of itself, or what was taken for it."""
    if person.facts:
        facts = "; ".join(str(fact) for fact in person.facts)
        yield f"{person.format}: {facts}"
    if person.rate_source == "assumed":
        yield "the file states no frame rate; give --frame-rate HZ if it is another"


def _findings(report: MotionReport) -> Iterator[tuple[str, str]]:
    """Yields what looks bad, the worst first: in few words, and as a whole line."""

    def at(frame: int) -> str:
        return f"frame {frame} ({(frame - 1) / report.performer.frame_rate:.2f} s)"

    for doubt in report.doubts:
        yield doubt, doubt
    if report.obstacle:
        text = f"no robot can follow it: {report.obstacle}"
        yield text, text
    for verb, breaks, scale, unit in (
        ("flips", report.flips, np.degrees(1.0), "degrees"),
        ("jumps", report.jumps, 100.0, "cm"),
    ):
        for name in dict.fromkeys(found.of for found in breaks):
            those = [found for found in breaks if found.of == name]
            worst = max(those, key=lambda found: found.size)
            times = "once" if len(those) == 1 else f"{len(those)} times"
            short = f"{name} {verb} {times}"
            yield (
                short,
                f"{short}, first in {at(those[0].frame)}, by up to "
                f"{scale * worst.size:.0f} {unit} in {at(worst.frame)}",
            )
    for first, last in report.frozen:
        text = f"nothing moves from {at(first)} to {at(last)}"
        yield text, text
