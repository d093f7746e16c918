"""What is left of a session: the files of a run, made of its log."""

from pathlib import Path

from crar_drake.motion.report import inspect
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.run import (
    Interrupts,
    RunResult,
    summary_of,
    with_lasting_name,
    write_run,
)


def save_session(
    live: LiveSimulation,
    out: Path,
    interrupts: Interrupts,
    *,
    record: bool = True,
    failure: BaseException | None = None,
) -> tuple[RunResult, list[BaseException]]:
    """Writes log, summary, plot and page, as `run.run_scenario` does.

    Args:
        out: the folder.
        interrupts: another Ctrl-C leaves it at what is there.
        record: whether to make the page.
        failure: what ended the simulation, if anything did.

    Returns:
        The result, whose `files` are what was written; and why others were not.
    """
    scenario = with_lasting_name(live.logged_scenario())
    performer = live.setup.motion.performer
    log = live.recorder.log(scenario)
    summary = summary_of(
        log,
        scenario,
        live.setup,
        failure,
        motion=inspect(performer) if performer is not None else None,
        warnings=[live.reported()],
    )
    result = RunResult(log, summary, live.setup)
    missing = write_run(out, result, scenario, record, interrupts, note=live.reported())
    return result, missing
