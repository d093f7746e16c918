"""Runs a case: episode after episode, each judged, the worst one kept."""

import zlib
from dataclasses import replace

import numpy as np

from benchmarks.adversary.attacks import Episode, make_episode
from benchmarks.adversary.cases import Case, Result
from benchmarks.adversary.drive import Drive, drive_exact, drive_torque
from benchmarks.adversary.judge import Verdict
from benchmarks.adversary.policies import drive_filter
from benchmarks.adversary.robots import Subject, load_subject
from benchmarks.kept_cases import in_a_line
from crar_drake.errors import ScenarioError
from crar_drake.law.parameters import (
    LookaheadParameters,
    PaperGains,
    with_constraints,
)

DURATION = 1.0  # of an episode [s], but
FEWEST_STEPS = 60  # at least
SEARCHES = 4  # times as many steps for the search, whose episodes build on each other
FRESH = 0.3  # share of the search's episodes that are drawn anew
KEPT = 4  # lineages that the search goes on with


def run_case(case: Case) -> Result:
    """Plays and judges episodes until the case has its steps.

    Returns:
        What was found. Where an episode cannot be run, `error` says why, and what was
        found until then stays.
    """
    result = Result(case=case)
    try:
        _attack(case, result)
    except Exception as error:  # a counterexample counts, whatever comes after it
        result.error = in_a_line(error)
    return result


def _attack(case: Case, result: Result) -> None:
    """Adds what each episode of a case comes to."""
    num_steps = episode_steps(case)
    rng = np.random.default_rng(_seed_of(case))
    # Nastiest first: smallest distance, and the lineage of the episode that had it.
    nasty: list[tuple[float, list[int]]] = []
    worst = 0.0
    total = 0  # refused ones count here, or a case of refused gains would not end
    wanted = case.steps * (SEARCHES if case.attack == "search" else 1)
    while total < wanted:
        lineage = _next_lineage(case, nasty, rng)
        # A mutation needs the robot and the tasks that the seed was drawn for.
        subject = load_subject(case.robot, lineage[0])
        task_set = subject.task_set(lineage[0])
        total += num_steps
        try:
            done, verdict = play_and_judge(case, subject, task_set, lineage, num_steps)
        except ScenarioError:
            result.refused += 1
            continue
        nearest = min(verdict.clearance, verdict.path_clearance)
        nasty = sorted([*nasty, (nearest, lineage)], key=lambda x: x[0])[:KEPT]
        result.add(verdict)
        result.add(done, ("steps", "diverged", "admitted", "unheld", "overloaded"))
        result.episodes += 1
        result.violated += verdict.unsafe
        if case.plant == "torque" and (verdict.unsafe or done.diverged):
            _explain(case, subject, task_set, lineage, num_steps, done, result)
        badness = _badness(verdict, done)
        if badness > worst:
            worst = badness
            result.worst = {
                "task_set": task_set,
                "lineage": lineage,
                "num_steps": num_steps,
                "step": verdict.first,
                "clearance": nearest,
                "excess": verdict.excess,
                "overspeed": verdict.overspeed,
                "diverged": done.diverged,
            }


def play_and_judge(
    case: Case, subject: Subject, task_set: str, lineage: list[int], num_steps: int
) -> tuple[Drive, Verdict]:
    """An episode, and what the independent judge says of it.

    Raises:
        ScenarioError: the law refuses its parameters.
    """
    if case.plant != "filter":
        episode, done = play(case, subject, task_set, lineage, num_steps)
        return done, judge_episode(subject, episode, done, lineage)
    filter, judge = subject.filter(case.period, case.motors)
    done = drive_filter(filter, judge, case.attack, num_steps, lineage[0])
    floor = filter.parameters.safety_distance
    rng = np.random.default_rng([lineage[0], 2])
    verdict = judge.judge(done.q, done.v, done.T, rng, floor=floor)
    return done, verdict


def episode_steps(case: Case) -> int:
    """Control steps of an episode."""
    return max(FEWEST_STEPS, round(DURATION / case.period))


def play(
    case: Case, subject: Subject, task_set: str, lineage: list[int], num_steps: int
) -> tuple[Episode, Drive]:
    """Makes an episode and runs it.

    Raises:
        ScenarioError: the law refuses its parameters.
    """
    nominal = PaperGains() if case.paper else None
    parameters = LookaheadParameters(period=case.period, nominal=nominal)
    parameters = with_constraints(parameters, case.constraints)
    model = subject.model(task_set)
    episode = make_episode(
        case.attack, model, subject.judge, parameters, num_steps, lineage
    )
    drive = drive_exact if case.plant == "exact" else drive_torque
    return episode, drive(model, episode)


def judge_episode(
    subject: Subject, episode: Episode, done: Drive, lineage: list[int]
) -> Verdict:
    """What the independent judge says of it."""
    laws = episode.parameters, *episode.switches.values()
    floor = min(law.safety_distance for law in laws)
    if done.per_step > 1:  # a plant under torque is not the one of the theorem
        floor = 0.0
    rng = np.random.default_rng([lineage[0], 2])
    return subject.judge.judge(
        done.q, done.v, done.T, rng, per_step=done.per_step, floor=floor
    )


def _next_lineage(case: Case, nasty: list, rng: np.random.Generator) -> list[int]:
    """A new seed; or, of the search, a nasty lineage with one more mutation."""
    seed = int(rng.integers(2**31))
    if case.attack != "search" or not nasty or rng.random() < FRESH:
        return [seed]
    return [*nasty[int(rng.integers(len(nasty)))][1], seed]


def _seed_of(case: Case) -> list[int]:
    """The same dice for a case whatever other cases are run."""
    name = f"{case.robot} {case.attack} {case.period:g}"
    return [case.seed, zlib.crc32(name.encode())]


def _badness(verdict: Verdict, done: Drive) -> float:
    """How bad a violation is, in about millimetres; 0 if there is none."""
    return (
        1e6 * done.diverged
        + 1e3 * max(0.0, -min(verdict.clearance, verdict.path_clearance))
        + 1e3 * verdict.excess * (verdict.beyond_limit + verdict.ahead > 0)
        + 1e-3 * verdict.overspeed * (verdict.too_fast > 0)
    )


def _explain(case, subject, task_set, lineage, num_steps, done, result) -> None:
    """Whether the exact plant violates under the same targets: then it is the law."""
    exact = replace(case, plant="exact")
    episode, ideal = play(exact, subject, task_set, lineage, num_steps)
    verdict = judge_episode(subject, episode, ideal, lineage)
    if verdict.unsafe or ideal.diverged:
        result.by_law += 1
    else:
        result.by_plant += 1
        result.slip = max(result.slip, done.slip)
