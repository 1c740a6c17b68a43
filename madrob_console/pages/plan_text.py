"""A competition's plan and its progress, as text and for programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from textwrap import wrap
from typing import Any

import msgspec
from rich.cells import set_cell_size

from madrob_console.common.formatting import format_span
from madrob_console.common.names import terminal_safe
from madrob_console.pages.competition import CONDITION_NUMBERS
from madrob_console.referee.competition_plan import (
    Attempts,
    PlannedAttempt,
    PlanProgress,
    Task,
    delay,
)
from madrob_console.referee.run_summary import condition_words
from scoring.protocol import Condition

PLAN_NOTES = (
    "done: completed, timed out, aborted; valid: the first two; best: level of steps.",
    "Interrupted or voided runs, and aborts for a testbed fault, come next again.",
    "An attempt that was repeated counts once; practice runs never count.",
    ">: next. P: a protest is open, the line is not final.",
)
"""How to read the numbers."""

_TEAM, _WAY, _DOOR = 14, 20, 14


def condition_lines() -> Iterator[str]:
    """The twenty conditions, as a plan names them."""
    yield "  no  benchmark type  opening side  starting side  task"
    for number in CONDITION_NUMBERS:
        of = Condition.from_number(number)
        sides = f"{of.opening_side.upper():12}  {of.starting_side.upper():13}"
        yield f"{number:>4}  {of.benchmark_type:14}  {sides}  {of.way}"
    yield ""
    yield "A line of a plan is `subject,condition,attempts,time`, the last two at will: 3,7,2,14:30"
    yield 'A condition in words is quoted: 3,"pull, from CCW, No Force",2'


def plan_lines(
    progress: PlanProgress, competition: str, teams: Mapping[int, str], now: float
) -> Iterator[str]:
    """The plan as a table of at most 80 characters in a line; `teams` maps subjects to names.

    `now`, s since the epoch, tells how late the next attempt is.
    """
    yield f"MADROB plan {competition}".rstrip()
    yield summary_words(progress)
    for words in schedule_words(progress, teams, now):
        yield from wrap(words, 80, break_long_words=False)
    yield ""
    yield _line("", "subj", "team", "cond", "task", "door", "done", "valid", "best")
    begun, day = False, ""
    for line in progress.lines:
        mark = ">" if line.left and not begun else ""
        begun = begun or bool(mark)
        of_day, _, time = line.time.rpartition(" ")
        if of_day not in ("", day):
            day = of_day
            yield day
        yield _row(mark, line, teams, time)
    if extra := [task for task in progress.tasks if not task.planned]:
        yield ""
        yield "Out of plan:"
        yield from (_row("", task, teams) for task in extra)
    for task in progress.tasks:
        if task.beyond:
            yield f"{task.beyond} more than planned: {task_words(task.task, teams)}."
    yield ""
    yield from PLAN_NOTES


def summary_words(progress: PlanProgress) -> str:
    done = progress.planned - progress.left
    text = f"{done} of {progress.planned} attempts done, {progress.left} left."
    if progress.unread:
        plural = "s are" if progress.unread > 1 else " is"
        text += f" {progress.unread} run{plural} DAMAGED and not counted."
    if protested := sum(task.open_protests for task in progress.tasks):
        plural = "s are" if protested > 1 else " is"
        text += f" {protested} PROTEST{plural} open: NOT FINAL."
    return text


def attempts_cell(of: Attempts) -> str:
    """`1/2`: one of two planned attempts is done; `+1`: one out of plan; `P`: a protest is open."""
    done = f"{of.done - of.beyond}/{of.planned}" if of.planned else f"+{of.done}"
    return f"{done}P" if of.open_protests else done


def schedule_words(
    progress: PlanProgress, teams: Mapping[int, str], now: float, running: Task | None = None
) -> Iterator[str]:
    """What goes on and what comes next, with its planned time and how late it is `now`."""
    for slot in progress.upcoming():
        if slot.task == running:
            yield f"Now: {attempt_words(slot, teams)}."
            break
    for slot in islice(progress.upcoming(running), 1):
        yield f"Next: {attempt_words(slot, teams)}{late_words(slot.time, now)}."


def late_words(planned: str, now: float) -> str:
    """`, 12 min LATE`; empty within the first minute, and where no time is planned."""
    minutes = delay(planned, now) // 60
    return f", {format_span(60 * minutes)} LATE" if minutes else ""


def attempt_words(attempt: PlannedAttempt, teams: Mapping[int, str]) -> str:
    at = f", planned for {attempt.time}" if attempt.time else ""
    return (
        f"{task_words(attempt.task, teams)} ({', '.join(condition_words(attempt.task.condition))}),"
        f" attempt {attempt.number} of {attempt.planned}{at}"
    )


def task_words(task: Task, teams: Mapping[int, str]) -> str:
    """A team and its condition: `3 Delft, condition 5`."""
    return (
        f"{task.subject} {teams.get(task.subject, '')}".rstrip() + f", condition {task.condition}"
    )


def plan_json(
    progress: PlanProgress, competition: str, teams: Mapping[int, str], software: str
) -> bytes:
    following = progress.next
    content = {
        "software": software,
        "competition": competition,
        "planned": progress.planned,
        "done": progress.planned - progress.left,
        "left": progress.left,
        "next": None
        if following is None
        else {
            **_task(following.task, teams),
            "attempt": following.number,
            "time": following.time,
        },
        "lines": [_attempts(line, teams) for line in progress.lines],
        "out_of_plan": [_attempts(task, teams) for task in progress.tasks if not task.planned],
        "damaged_runs": progress.unread,
        "problems": list(progress.problems),
    }
    return msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n"


def _row(mark: str, of: Attempts, teams: Mapping[int, str], time: str = "") -> str:
    subject, condition = of.task
    team = teams.get(subject, "")
    if time:  # beside the team, as nothing else is as long as its column
        team = f"{_fit(team, _TEAM - len(time) - 1)} {time}"
    best = "-" if of.best_level is None else str(of.best_level)
    done = attempts_cell(of)
    words = condition_words(condition)
    return _line(
        *(mark, str(subject), team, str(condition)),
        *(words.way, words.door, done, str(of.valid), best),
    )


def _line(
    mark: str, subject: str, team: str, condition: str, way: str, door: str, *numbers: str
) -> str:
    words = f"{_fit(team, _TEAM)} {condition:>4} {_fit(way, _WAY)} {_fit(door, _DOOR)}"
    done, valid, best = numbers
    return f"{mark:1} {subject:>4} {words} {done:>5} {valid:>5} {best:>4}"


def _fit(text: str, width: int) -> str:
    return set_cell_size(terminal_safe(text), width)


def _task(task: Task, teams: Mapping[int, str]) -> dict[str, Any]:
    return {
        "subject": task.subject,
        "team": teams.get(task.subject, ""),
        "condition": task.condition,
    }


def _attempts(of: Attempts, teams: Mapping[int, str]) -> dict[str, Any]:
    return {
        **_task(of.task, teams),
        "attempts": of.planned,
        "done": of.done - of.beyond,
        "beyond": of.beyond,
        "valid": of.valid,
        "best_level": of.best_level,
        "left": of.left,
        "open_protests": of.open_protests,
        "time": of.time,
    }
