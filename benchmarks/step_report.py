"""Tables and a plot of what `benchmarks.step` measured."""

from matplotlib.figure import Figure

from benchmarks.page import Table


def tables(result: dict) -> list[Table]:
    """The tables of what `run_bench` measured."""
    found = [_targets(result)]
    if result["step"]:
        found += [
            _steps(result, "in a row", "in_a_row"),
            _steps(result, "by turns", "by_turns"),
            _parts(result),
        ]
    if result["compiling"]:
        found.append(_compiling(result))
    if result["simulation"]:
        found.append(_simulations(result))
    if result["scaling"]:
        found.append(_scaling(result))
    return found


def _targets(result: dict) -> Table:
    rows = []
    for t in result["targets"]:
        sign = "≥" if t["at_least"] else "≤"
        rows.append(
            [
                t["target"],
                f"{t['value']:.2f}",
                f"{sign} {t['limit']:g}",
                "yes" if t["reached"] else "no",
            ]
        )
    columns = ["target", "measured", "wanted", "reached"]
    return Table(columns, rows, "What is to be reached")


def _steps(result: dict, words: str, order: str) -> Table:
    header = [
        "tasks, constraints",
        "plain step",
        "step",
        "p99",
        "bound",
        "step over bound",
        "by the wall clock",
        "plain step over bound",
    ]
    rows = []
    for e in result["step"]:
        figures = e[order]
        step, plain, bound = (figures[n] for n in ("step", "plain step", "bound"))
        rows.append(
            [
                _case(e),
                _us_of(plain),
                _us_of(step),
                _us(step["cpu_p99"]),
                _us_of(bound),
                _ratio(step, bound),
                f"{figures['ratio']:.2f}",
                _ratio(plain, bound),
            ]
        )
    return Table(header, rows, f"One control step, {words} [µs]")


def _us_of(figures: dict | None) -> str:
    """The median by processor time; a dash where nothing was measured."""
    return "–" if figures is None else _us(figures["cpu_median"])


def _ratio(figures: dict | None, bound: dict) -> str:
    if figures is None:
        return "–"
    return f"{figures['cpu_median'] / bound['cpu_median']:.2f}"


def _compiling(result: dict) -> Table:
    times = result["compiling"]
    rows = [
        [text, f"{times[name]['wall']:.1f}", f"{times[name]['cpu']:.1f}"]
        for name, text in (
            ("first", "the first one, which compiles"),
            ("later", "a later one, which finds what was kept"),
        )
    ]
    columns = ["process", "wall clock [s]", "processor time [s]"]
    return Table(columns, rows, "Making model and law ready for the first step")


def _parts(result: dict) -> Table:
    names = list(result["step"][0]["parts"])
    rows = [
        [
            _case(e),
            *(_us(e["parts"][name]) for name in names),
            _us(sum(e["parts"].values())),
        ]
        for e in result["step"]
    ]
    columns = ["tasks, constraints", *names, "step"]
    return Table(columns, rows, "Its parts, wall clock, in a row [µs]")


def _simulations(result: dict) -> Table:
    header = [
        "tasks, constraints",
        "step",
        "recording",
        "real-time factor",
        "by processor time",
        "writing the page afterwards",
    ]
    rows = []
    for e in result["simulation"]:
        recording = e["recording"]
        rows.append(
            [
                _case(e),
                "plain" if e["plain"] else "as it is",
                "yes" if recording else "no",
                f"{e['real_time_factor']:.2f}",
                f"{e['cpu_factor']:.2f}",
                f"{e['writing_the_page']:.2f} s" if recording else "–",
            ]
        )
    return Table(header, rows, "Whole simulation, 1 kHz")


def _scaling(result: dict) -> Table:
    header = [
        "growing",
        "constraints",
        "sizes",
        "step, median [µs]",
        "exponent, of the last two",
        "per unit [µs]",
        "last over first",
    ]
    rows = [
        [
            e["quantity"],
            e["constraints"],
            ", ".join(map(str, e["sizes"])),
            ", ".join(map(_us, e["median"])),
            f"{e['exponent']:.2f}, {e['last_exponent']:.2f}",
            f"{1e6 * e['per_unit']:.2f}",
            f"{e['last_over_first']:.2f}",
        ]
        for e in result["scaling"]
    ]
    return Table(header, rows, "Growth of the control step")


def _case(entry: dict) -> str:
    return f"{entry['case']}, {entry['constraints']}"


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.0f}"


def draw_bench(result: dict) -> Figure:
    """The parts of each step with its bound, and a panel per quantity that grows."""
    quantities = list(dict.fromkeys(e["quantity"] for e in result["scaling"]))
    wide = bool(result["step"])
    figure = Figure(
        figsize=(11.0, 3.2 * wide + 3.4 * -(-len(quantities) // 2) + 0.2),
        layout="constrained",
    )
    rows = wide + -(-len(quantities) // 2)
    if not rows:
        figure.text(0.5, 0.5, "nothing to draw", ha="center")
        return figure
    grid = figure.add_gridspec(rows, 2)
    if wide:
        _draw_parts(figure.add_subplot(grid[0, :]), result["step"])
    for i, quantity in enumerate(quantities):
        ax = figure.add_subplot(grid[wide + i // 2, i % 2])
        for e in result["scaling"]:
            if e["quantity"] == quantity:
                ax.plot(
                    e["sizes"],
                    [1e6 * t for t in e["median"]],
                    "o-",
                    label=e["constraints"],
                )
        ax.set_xlabel(quantity)
        ax.set_ylabel("control step, median [µs]")
        ax.set_ylim(bottom=0.0)
        ax.grid(alpha=0.3)
        ax.legend()
    return figure


def _draw_parts(ax, entries: list[dict]) -> None:
    lanes = range(len(entries))
    left = [0.0] * len(entries)
    for name in entries[0]["parts"]:
        widths = [1e6 * e["parts"][name] for e in entries]
        ax.barh(lanes, widths, left=left, label=name, height=0.6)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    for lane, e in zip(lanes, entries, strict=True):
        bound = 1e6 * e["in_a_row"]["bound"]["median"]
        label = "bound" if lane == 0 else None
        ax.plot([bound, bound], [lane - 0.4, lane + 0.4], "k-", lw=2, label=label)
    ax.set_yticks(lanes, [_case(e) for e in entries])
    ax.invert_yaxis()
    ax.set_xlabel("control step, median [µs]")
    ax.legend(ncols=7, fontsize="small", loc="lower left", bbox_to_anchor=(0.0, 1.0))
