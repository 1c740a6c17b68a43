"""A competition's plan and its progress, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from rich.cells import set_cell_size

from madrob_console.archive.history import condition_words
from madrob_console.names import terminal_safe
from madrob_console.referee.competition_plan import (
    Attempts,
    PlannedAttempt,
    PlanProgress,
    Task,
)

NOTES = (
    "done: completed, timed out, aborted; valid: the first two; best: level of steps.",
    "Interrupted and voided runs come next again; practice runs never count.",
    "P behind what is done: a protest is open, the line is not final.",
)
"""How to read the numbers."""

_TEAM, _WAY, _DOOR = 14, 20, 14


def plan_lines(found: PlanProgress, competition: str, teams: Mapping[int, str]) -> Iterator[str]:
    """The plan as a table of at most 80 characters in a line.

    Args:
        found: how much of it is done.
        competition: its name.
        teams: subject -> team.
    """
    yield f"MADROB plan {competition}".rstrip()
    yield summary_words(found)
    following = found.next
    if following is not None:
        yield f"Next: {attempt_words(following, teams)}."
    yield ""
    yield _line("", "subj", "team", "cond", "task", "door", "done", "valid", "best")
    begun = False
    for line in found.lines:
        mark = ">" if line.left and not begun else ""
        begun = begun or bool(mark)
        yield _row(mark, line, teams)
    if extra := [one for one in found.tasks if not one.planned]:
        yield ""
        yield "Out of plan:"
        yield from (_row("", one, teams) for one in extra)
    yield ""
    yield from NOTES


def summary_words(found: PlanProgress) -> str:
    """How much is done, in a sentence."""
    text = f"{found.planned - found.left} of {found.planned} attempts done, {found.left} left."
    if found.unread:
        plural = "s are" if found.unread > 1 else " is"
        text += f" {found.unread} run{plural} DAMAGED and not counted."
    if protested := sum(one.open_protests for one in found.tasks):
        plural = "s are" if protested > 1 else " is"
        text += f" {protested} PROTEST{plural} open: NOT FINAL."
    return text


def attempt_words(attempt: PlannedAttempt, teams: Mapping[int, str]) -> str:
    """One attempt in words: whose, in which condition, which of how many."""
    return (
        f"{task_words(attempt.task, teams)} ({', '.join(condition_words(attempt.task.condition))}),"
        f" attempt {attempt.number} of {attempt.planned}"
    )


def task_words(task: Task, teams: Mapping[int, str]) -> str:
    """A team and its condition: `3 Delft, condition 5`."""
    return (
        f"{task.subject} {teams.get(task.subject, '')}".rstrip() + f", condition {task.condition}"
    )


def plan_json(
    found: PlanProgress, competition: str, teams: Mapping[int, str], software: str
) -> bytes:
    """The same as JSON.

    Args:
        found: how much of it is done.
        competition: its name.
        teams: subject -> team.
        software: what made it, with its version.
    """
    following = found.next
    content = {
        "software": software,
        "competition": competition,
        "planned": found.planned,
        "done": found.planned - found.left,
        "left": found.left,
        "next": None
        if following is None
        else {**_task(following.task, teams), "attempt": following.number},
        "lines": [_attempts(line, teams) for line in found.lines],
        "out_of_plan": [_attempts(one, teams) for one in found.tasks if not one.planned],
        "damaged_runs": found.unread,
        "problems": list(found.problems),
    }
    return msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n"


def _row(mark: str, of: Attempts, teams: Mapping[int, str]) -> str:
    subject, condition = of.task
    best = "-" if of.best_level is None else str(of.best_level)
    done = f"{of.done}/{of.planned}" if of.planned else str(of.done)
    done += "P" if of.open_protests else ""
    words = condition_words(condition)
    return _line(
        *(mark, str(subject), teams.get(subject, ""), str(condition)),
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
        "done": of.done,
        "valid": of.valid,
        "best_level": of.best_level,
        "left": of.left,
        "open_protests": of.open_protests,
    }
