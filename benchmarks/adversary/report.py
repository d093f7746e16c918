"""Tables of what the adversary found."""

from collections.abc import Sequence

from benchmarks.adversary.cases import Result, Tally
from benchmarks.page import Table

HEADER = (
    "steps",
    "episodes violated",
    "below the floor, penetrating",
    "beyond limits",
    "path not clear",
    "too fast",
    "smallest distance",
    "worst excess",
    "speed / limit",
    "nominal / corrected / scaled",
)


def _figures(results: Sequence[Result]) -> list[str]:
    """Sums and worst values of some cases."""
    total = Tally()
    for result in results:
        total.add(result)
    episodes = f"{total.violated} of {total.episodes}"
    for what in ("diverged", "refused"):
        episodes += f", {n} {what}" if (n := getattr(total, what)) else ""
    nearest = min(total.clearance, total.path_clearance)
    admitted = " / ".join(f"{n:,}" for n in total.admitted)
    return [
        f"{total.steps:,}",
        episodes,
        f"{total.below:,}, {total.penetrating:,}",
        f"{total.beyond_limit:,}",
        f"{total.ahead:,} / {total.blocked:,} of {total.paths:,}",
        f"{total.too_fast:,}",
        f"{1e3 * nearest:.1f} mm",
        f"{total.excess:.3g} rad" if total.excess > 1e-6 else "none",
        f"{total.overspeed:.3g}",
        admitted if any(total.admitted) else "not told",
    ]


def grouped(results: Sequence[Result], what: str) -> Table:
    """A table with a line for each value of a case's field, and their sum.

    Args:
        results: of one plant.
        what: "attack", "robot" or "period".
    """
    good = [r for r in results if not r.error and r.episodes + r.refused]
    values = list(dict.fromkeys(getattr(r.case, what) for r in good))
    rows = []
    for value in values:
        text = f"{1e3 * value:g} ms" if what == "period" else str(value)
        same = [r for r in good if getattr(r.case, what) == value]
        rows.append([text, *_figures(same)])
    if len(values) > 1:
        rows.append(["all", *_figures(good)])
    return Table([what, *HEADER], rows)


def explained(results: Sequence[Result]) -> Table:
    """A table of why episodes of the whole diagram violate."""
    rows = []
    for r in results:
        if r.by_law + r.by_plant:
            rows.append(
                [
                    r.case.attack,
                    r.case.robot,
                    f"{1e3 * r.case.period:g} ms",
                    f"{r.by_law}",
                    f"{r.by_plant}",
                    f"{r.slip:.0f} rad/s²" if r.by_plant else "–",
                ]
            )
    return Table(
        [
            "attack",
            "robot",
            "period",
            "the exact model violates, too",
            "only the plant under torque does",
            "which then accelerates otherwise than commanded by up to",
        ],
        rows,
    )


def tables(results: Sequence[Result]) -> list[Table]:
    """By attack, robot and period, of each plant."""
    found = []
    for plant in dict.fromkeys(r.case.plant for r in results):
        same = [r for r in results if r.case.plant == plant]
        found += [grouped(same, what) for what in ("attack", "robot", "period")]
        if plant == "torque":
            found.append(explained(same))
    return found


def told(results: Sequence[Result]) -> str:
    """The verdict, and the cases that failed."""
    failed = [
        f"{r.case.attack}, {r.case.robot}, {1e3 * r.case.period:g} ms, "
        f"{r.case.plant}: {r.error}"
        for r in results
        if r.error
    ]
    text = f"{verdict_line(results).capitalize()}."
    return text + (f" Not run: {'; '.join(failed)}." if failed else "")


def verdict_line(results: Sequence[Result]) -> str:
    """One line that says it all."""
    exact = [r for r in results if r.case.plant != "torque" and not r.error]
    steps = sum(r.steps for r in exact)
    if not exact:
        return "nothing was run with the exact model"
    filtered = all(r.case.plant == "filter" for r in exact)
    what = "the filter" if filtered else "exact model"
    bad = [r for r in exact if r.failed]
    if not bad:
        return f"{what}: no violation in {steps:,} control steps"
    violated = sum(r.violated for r in bad)
    fast = sum(r.too_fast for r in bad)
    diverged = sum(r.diverged for r in bad)
    return (
        f"{what}: {len(bad)} of {len(exact)} cases violate a constraint in "
        f"{steps:,} control steps: {violated} episodes with a contact or beyond a "
        f"limit, {diverged} diverged, {fast:,} states beyond a speed limit, "
        f"{sum(r.overloaded for r in bad):,} steps beyond a motor's limit"
    )
