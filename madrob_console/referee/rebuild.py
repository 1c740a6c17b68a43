"""The state of a run from its journal: for scoring again, replay and recovery."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from enum import StrEnum

from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.referee.acts import Act, Consequence, Situation, act_named, is_act
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import FalseStart, Run, TestbedFault
from madrob_console.referee.transitions import begin_run, stop, time_out
from scoring.protocol import EventName, Outcome


class Change(StrEnum):
    """Journal lines that no act wrote."""

    RUN_STARTS = "run starts"
    RUN_STOPS = "run stops"
    TIMEOUT_ELAPSED = "timeout elapsed"
    FALSE_START = "false start"
    EVENT = "event"
    FAULT = "fault of the testbed"
    RESULT_WRITTEN = "result written"


def act_of(entry: Entry) -> Act | None:
    """The act that a journal line tells of; None for a line of another kind.

    Raises:
        MadrobError: the line's details do not fit the act.
    """
    if not is_act(entry.what):
        return None
    try:
        return act_named(entry.what, entry.details)
    except MadrobError as error:
        raise MadrobError(f"journal line is damaged: {error}") from None


def rebuild(entries: Iterable[Entry], handle_zero: float = 0.0) -> Run:
    """The run after all entries.

    Args:
        entries: of one run, in order.
        handle_zero: the one stored with the run, N.

    Raises:
        MadrobError: a line is damaged.
    """
    run = Run()
    for entry in entries:
        run = after(run, entry, handle_zero)
    return replace(run, handle_zero=handle_zero)


def after(run: Run, entry: Entry, handle_zero: float) -> Run:
    """The run after one more entry.

    Args:
        run: before it.
        entry: the next of its journal.
        handle_zero: the one stored with the run, N.

    Raises:
        MadrobError: the line is damaged.
    """
    act = act_of(entry)
    if act is not None:
        if run.setup is None and Consequence.NEW_RUN not in act.consequences:
            return run
        return act.apply(Situation(run, measure=lambda: handle_zero), entry.time)
    try:
        match entry.what:
            case Change.RUN_STARTS:
                return begin_run(run)
            case Change.TIMEOUT_ELAPSED:
                return time_out(run, float(entry.details["time"]), entry.reason)
            case Change.RUN_STOPS:
                outcome = Outcome(entry.details["outcome"])
                return stop(run, outcome, float(entry.details["time"]), entry.reason)
            case Change.FALSE_START:
                name = EventName(entry.details["event"])
                mark = FalseStart(float(entry.details["time"]), name)
                return replace(run, false_starts=(*run.false_starts, mark))
            case Change.FAULT:
                fault = TestbedFault(float(entry.details["time"]), entry.reason)
                return replace(run, faults=(*run.faults, fault))
            case Change.RESULT_WRITTEN:
                return replace(run, issue=int(entry.details["issue"]))
            case _:
                return run
    except (KeyError, ValueError, TypeError) as error:
        what = terminal_safe(f"'{entry.what}' is damaged: {error}")
        raise MadrobError(f"journal line {what}") from None
