"""How the lookahead's parameters trade tracking, margin and smoothness.

    python -m benchmarks.parameter_study MOTION… [--preview S]
        [--page docs/measurements/parameters.md]

Each line changes one thing of the defaults, or of the law without a preview. At a
control period of 5 ms, where the differences show sooner than at 1 ms.
"""

import statistics
from collections.abc import Sequence
from dataclasses import replace

from benchmarks.page import Benchmark, Table, run
from benchmarks.preview_option import (
    add_preview_option,
    defaults_or_preview,
    lookahead_defaults,
)
from benchmarks.sweep.cases import (
    Case,
    Result,
    find_motions,
    run_case,
)
from crar_drake.control.parameters import CrarParameters
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.simulation.scenario import Scenario

PERIOD = 5e-3  # [s]


def variations(preview: float | None = None) -> dict[str, CrarParameters]:
    """What is tried, by what is said of it.

    Args:
        preview: of all [s]; None for the default, 0 for none, where other parameters
            matter.
    """
    default = lookahead_defaults(preview)

    def ahead(**changes) -> CrarParameters:
        return replace(default, lookahead=replace(default.lookahead, **changes))

    if default.plans:
        return {
            "defaults": default,
            "preview 0.05 s": ahead(preview=0.05),
            "preview 0.2 s": ahead(preview=0.2),
            "smoothness 3e-5 m s²": ahead(smoothness=3e-5),
            "smoothness 2.3e-4 m s²": ahead(smoothness=2.3e-4),
            "pulls as from 2 mm at most": ahead(farthest_pull=0.002),
            "GvN = 60/s": replace(default, GvN=60.0),
            "nominal posture 80/s²": replace(default, nominal_posture_gain=80.0),
            "λ = 0.1 in what is free": ahead(null_space_damping=0.1),
            "T = 0.03 s": ahead(horizon=0.03),
            "no longer way to brake": ahead(longest_horizon=0.012),
            "κ = 50/s": ahead(approach_rate=50.0),
            "κ = 10/s of limits": ahead(limit_approach_rate=10.0),
            "nominal speed limit 16 rad/s": ahead(nominal_speed_limit=16.0),
            "d_min = 10 mm": ahead(distance_margin=1e-2),
            "admission slack 3 mm": ahead(admission_slack=3e-3),
            "limit margin 1e-3 rad": ahead(limit_margin=1e-3),
            "influence 0.15 m": ahead(influence_distance=0.15),
            "guard in the norm of the tasks": ahead(guard_norm="tasks"),
        }
    return {
        "no preview": default,
        "ρ = 1e-5": ahead(rho=1e-5),
        "ρ = 1e-3": ahead(rho=1e-3),
        "ρ_JL = 1e-3": ahead(rho_limits=1e-3),
        "ρ_JL = 0.1": ahead(rho_limits=0.1),
        "ρ_JL = 1": ahead(rho_limits=1.0),
        "d_min = 2 mm": ahead(distance_margin=2e-3),
        "d_min = 10 mm": ahead(distance_margin=1e-2),
        "admission slack 0.1 mm": ahead(admission_slack=1e-4),
        "admission slack 3 mm": ahead(admission_slack=3e-3),
        "limit margin 1e-3 rad": ahead(limit_margin=1e-3),
        "γ = 10/s": ahead(retreat_rate=10.0),
        "retreat at most 0.1 m/s, 0.4 rad/s": ahead(
            retreat_speed=0.1, joint_retreat_speed=0.4
        ),
        "retreat at most 2 m/s, 8 rad/s": ahead(
            retreat_speed=2.0, joint_retreat_speed=8.0
        ),
        "slip low-pass 2 ms": ahead(slip_time_constant=2e-3),
        "slip not seen (10^6 s)": ahead(slip_time_constant=1e6),
        "T = 1/60 s": ahead(horizon=1.0 / 60.0),
        "T = 1/15 s": ahead(horizon=1.0 / 15.0),
        "influence 0.15 m": ahead(influence_distance=0.15),
        "influence 0.6 m": ahead(influence_distance=0.6),
        "nominal speed limit 8 rad/s": ahead(nominal_speed_limit=8.0),
        "nominal speed limit 30 rad/s": ahead(nominal_speed_limit=30.0),
        "guard in the norm of the tasks": ahead(guard_norm="tasks"),
        "the same, ν = 0.3 m": ahead(guard_norm="tasks", guard_damping=0.3),
        "bounds, κ = 50/s": ahead(approach_rate=50.0),
        "bounds, κ = 50/s, in the norm of the tasks": ahead(
            approach_rate=50.0, guard_norm="tasks"
        ),
        "the same, of limits 10/s": ahead(
            approach_rate=50.0, guard_norm="tasks", limit_approach_rate=10.0
        ),
        "λ = 0.05": replace(default, damping=0.05),
        "λ = 0.2": replace(default, damping=0.2),
        "doubled gains (Gv, K = 60, Kp = 900, T = 1/24 s)": replace(
            default, Gv=60.0, K=60.0, Kp=900.0
        ),
    }


def line(name: str, results: Sequence[Result]) -> list[str]:
    """A variation's cells: mean error, margins, violations, smoothness."""
    return [
        name,
        f"{1e3 * statistics.fmean(r.rms_task_error for r in results):.1f} mm",
        f"{1e3 * min(r.smallest_distance for r in results):.1f} mm",
        f"{sum(r.penetrating for r in results)}",
        f"{sum(r.beyond_limit for r in results)}",
        f"{statistics.median(r.rms_acceleration for r in results):.1f} rad/s²",
        f"{statistics.median(r.peak_torque for r in results):.0f} Nm",
        f"{max(r.peak_torque for r in results):.0f} Nm",
    ]


HEADER = [
    "changed",
    "mean error",
    "smallest distance",
    "penetrating samples",
    "samples beyond limits",
    "median rms q̈",
    "median peak τ",
    "largest τ",
]


def main(argv: Sequence[str] | None = None) -> None:
    """Runs every variation on every motion, and prints a table per experiment."""
    benchmark = Benchmark("benchmarks.parameter_study", __doc__, "parameters")
    parser = benchmark.parser
    parser.add_argument("motions", nargs="+", help="as of benchmarks.sweep")
    parser.add_argument("--duration", type=float, help="of each clip at most [s]")
    add_preview_option(parser)
    parser.add_argument("--jobs", type=int, help="processes; one per core")
    arguments = benchmark.parse(argv, defaults_or_preview)
    tried = variations(arguments.preview)
    motions = find_motions(arguments.motions)
    tables = []
    with FreshProcesses(arguments.jobs) as pool:
        futures = {}
        for experiment in EXPERIMENTS:
            for name, controller in tried.items():
                scenario = Scenario(
                    motion="dance",
                    experiment=experiment,
                    controller=controller,
                    duration=arguments.duration,
                ).to_yaml()
                for motion in motions:
                    case = Case(motion, experiment, "lookahead", "acceleration", PERIOD)
                    future = pool.submit(run_case, case, scenario)
                    futures.setdefault((experiment, name), []).append(future)
        for experiment in EXPERIMENTS:
            rows = [
                line(name, [future.result() for future in futures[experiment, name]])
                for name in tried
            ]
            tables.append(Table(HEADER, rows, experiment))
    benchmark.report(tables)


if __name__ == "__main__":
    run(main)
