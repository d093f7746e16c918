"""Tables of what the adversary found: for the terminal and as Markdown."""

from collections.abc import Sequence

from rich.table import Table

from benchmarks import page
from benchmarks.adversary.cases import Result

HEADER = (
    "attack",
    "robot",
    "period",
    "plant",
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

SHORT = (
    "attack",
    "robot",
    "period",
    "plant",
    "steps",
    "bad",
    "div.",
    "ref.",
    "below",
    "limit",
    "path",
    "fast",
    "nearest",
    "excess",
    "nom./corr./scaled",
)


def rich_table(results: Sequence[Result]) -> Table:
    """A line per case."""
    table = Table(title="attack by robot by period; distances in mm, excess in rad")
    for name in SHORT:
        table.add_column(
            name, justify="left" if name in SHORT[:2] else "right", no_wrap=True
        )
    for result in results:
        style = "red" if result.error or result.violated or result.diverged else None
        table.add_row(*_row(result), style=style)
    return table


def _row(r: Result) -> list[str]:
    case = r.case
    head = [case.attack, case.robot, f"{1e3 * case.period:g} ms", case.plant]
    if r.error:
        return [*head, *[""] * (len(SHORT) - 5), r.error[:60]]
    nearest = min(r.clearance, r.path_clearance)
    return [
        *head,
        f"{r.steps}",
        f"{r.violated}/{r.episodes}",
        f"{r.diverged}",
        f"{r.refused}",
        f"{r.below}",
        f"{r.beyond_limit}",
        f"{r.ahead}+{r.blocked}",
        f"{r.too_fast}",
        f"{1e3 * nearest:.1f}",
        f"{r.excess:.2g}",
        "/".join(map(str, r.admitted)) if any(r.admitted) else "-",
    ]


def _figures(results: Sequence[Result]) -> list[str]:
    """Sums and worst values of some cases."""

    def total(name: str) -> int:
        return sum(getattr(r, name) for r in results)

    refused, diverged = total("refused"), total("diverged")
    episodes = f"{total('violated')} of {total('episodes')}"
    episodes += f", {diverged} diverged" if diverged else ""
    episodes += f", {refused} refused" if refused else ""
    nearest = min(min(r.clearance, r.path_clearance) for r in results)
    admitted = [sum(r.admitted[i] for r in results) for i in range(3)]
    told = " / ".join(f"{n:,}" for n in admitted) if any(admitted) else "not told"
    excess = max(r.excess for r in results)
    overspeed = max(r.overspeed for r in results)
    ahead, blocked = total("ahead"), total("blocked")
    return [
        f"{total('steps'):,}",
        episodes,
        f"{total('below'):,}, {total('penetrating'):,}",
        f"{total('beyond_limit'):,}",
        f"{ahead:,} / {blocked:,} of {total('paths'):,}",
        f"{total('too_fast'):,}",
        f"{1e3 * nearest:.1f} mm",
        f"{excess:.3g} rad" if excess > 1e-6 else "none",
        f"{overspeed:.3g}",
        told,
    ]


def grouped(results: Sequence[Result], what: str) -> page.Table:
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
    return page.Table([what, *HEADER[4:]], rows)


def explained(results: Sequence[Result]) -> page.Table:
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
    return page.Table(
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


def plant_tables(results: Sequence[Result]) -> list[page.Table]:
    """By attack, robot and period, of one plant."""
    found = [grouped(results, what) for what in ("attack", "robot", "period")]
    if results and results[0].case.plant == "torque":
        found.append(explained(results))
    return found


def not_run(results: Sequence[Result]) -> str:
    """A line for each case that failed; "" if none did."""
    return "".join(
        f"* {r.case.attack}, {r.case.robot}, {1e3 * r.case.period:g} ms, "
        f"{r.case.plant}: {r.error}\n"
        for r in results
        if r.error
    )


def markdown(results: Sequence[Result]) -> str:
    """All tables, plant by plant."""
    parts, plants = [], list(dict.fromkeys(r.case.plant for r in results))
    for plant in plants:
        of_plant = [r for r in results if r.case.plant == plant]
        if len(plants) > 1:
            parts.append(f"Plant: {plant}.\n")
        parts += [table.markdown() for table in plant_tables(of_plant)]
    if lines := not_run(results):
        parts.append(f"Not run:\n\n{lines}")
    return "\n".join(parts)


def verdict_line(results: Sequence[Result]) -> str:
    """One line that says it all."""
    exact = [r for r in results if r.case.plant != "torque" and not r.error]
    steps = sum(r.steps for r in exact)
    if not exact:
        return "nothing was run with the exact model"
    filtered = all(r.case.plant == "filter" for r in exact)
    what = "the filter" if filtered else "exact model"
    bad = [r for r in exact if r.unsafe]
    if not bad:
        return f"{what}: no violation in {steps:,} control steps"
    violated = sum(r.violated for r in bad)
    fast = sum(r.too_fast for r in bad)
    diverged = sum(r.diverged for r in bad)
    return (
        f"{what}: {len(bad)} of {len(exact)} cases violate a constraint in "
        f"{steps:,} control steps: {violated} episodes with a contact or beyond a "
        f"limit, {diverged} diverged, {fast:,} states beyond a speed limit"
    )
