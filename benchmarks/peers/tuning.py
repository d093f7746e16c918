"""Which of a controller's settings is taken, and the file that keeps the choice."""

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.peers.judge import Figures
from crar_drake.files import write_whole

SETTINGS = Path(__file__).parent / "settings.json"
LEAVES_BY = 0.5  # [s] a start in penetration is to be left, when the targets move off
AS_GOOD = 1.03  # errors within 3 % count as equal


def holds(figures: Figures, case: str) -> bool:
    """Whether a run keeps its constraints, as far as the case lets it."""
    if case != "start_inside":
        return figures.holds
    kept = not (figures.beyond_limit or figures.failed or figures.frozen)
    return kept and figures.clear_at <= LEAVES_BY


def best(candidates: Sequence[Figures], case: str) -> int:
    """The number of the best candidate.

    Among those that hold it is the one with the least error; of those within 3 % of
    that, the one with the least rms acceleration. Where none holds: the fewest samples
    in violation, then the fewest steps without an answer.
    """
    holding = [i for i, figures in enumerate(candidates) if holds(figures, case)]
    if not holding:
        return min(range(len(candidates)), key=lambda i: _wrongs(candidates[i]))
    least = min(candidates[i].error for i in holding)
    good = [i for i in holding if candidates[i].error <= AS_GOOD * least]
    return min(good, key=lambda i: candidates[i].rms_acceleration)


def choose(
    grid: Sequence[dict], judged: Sequence[Figures], case: str
) -> dict[str, dict | float | int | None]:
    """What `settings.json` keeps of a grid: the best settings, how many were tried and
    held, and the least error [m] and least rms acceleration [rad/s^2] of those that
    held, each with the other figure."""
    holding = [figures for figures in judged if holds(figures, case)]
    exact = min(holding, key=lambda f: f.error, default=None)
    calm = min(holding, key=lambda f: f.rms_acceleration, default=None)

    def pair(figures: Figures | None) -> dict[str, float] | None:
        if figures is None:
            return None
        return {"error": figures.error, "acceleration": figures.rms_acceleration}

    taken = best(judged, case)
    return {
        "settings": grid[taken],
        "taken": pair(judged[taken]),
        "tried": len(grid),
        "held": len(holding),
        "least_error": pair(exact),
        "least_acceleration": pair(calm),
    }


def load_settings() -> dict[str, dict[str, dict]]:
    """Controller to case to what `choose` kept."""
    return json.loads(SETTINGS.read_text()) if SETTINGS.is_file() else {}


def save_settings(settings: dict[str, dict[str, dict]]) -> None:
    """Replaces the file."""
    write_whole(SETTINGS, json.dumps(settings, indent=1) + "\n")


def _wrongs(figures: Figures) -> tuple[float, float]:
    shares = figures.penetrating + figures.beyond_limit
    return shares, float(figures.failed + figures.frozen)
