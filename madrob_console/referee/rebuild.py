"""The state of a run from its journal, and the journal's checksum in a result.

For scoring again, replay and recovery.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from enum import StrEnum

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.referee import journal
from madrob_console.referee.acts import (
    ACT_CALLED,
    Act,
    Consequence,
    Correct,
    DecideProtest,
    FileProtest,
    Finalise,
    Reissue,
    Situation,
    TakeBack,
    Void,
    WithdrawProtest,
    act_named,
)
from madrob_console.referee.evidence import Evidence
from madrob_console.referee.journal import Entry
from madrob_console.referee.records import (
    FalseStart,
    FaultKind,
    JournalMark,
    TestbedFault,
)
from madrob_console.referee.run import (
    Phase,
    Run,
    begin_countdown,
    begin_run,
    changed,
    decide_false_starts,
    note_fault,
    reissued,
    stop,
    time_out,
)
from madrob_console.referee.run_setup import StoredRuleset
from scoring.protocol import EventName, Outcome
from scoring.rest import HandleRest

_LATEST = 1e11  # s since the epoch, within what calendars reach


class Change(StrEnum):
    """Kinds of journal lines that no act wrote."""

    COUNTDOWN_BEGINS = "countdown begins"
    WITHDRAWN = journal.WITHDRAWN
    RUN_STARTS = "run starts"
    ROBOT_STARTS = "robot starts"
    ROBOT_SAYS = "robot says"
    RUN_STOPS = "run stops"
    TIMEOUT_ELAPSED = "timeout elapsed"
    FALSE_START = "false start"
    COUNTDOWN_HELD = "countdown held"
    EVENT = "event"
    FAULT = "fault of the testbed"
    UNRECORDED = "recording incomplete"
    EVIDENCE = "evidence"
    EVIDENCE_RECORDED = "evidence recorded"
    RESULT_WRITTEN = "result written"
    REISSUED = "re-issued after a rule change"
    RESTORED = "re-issued after damage"


def act_of(entry: Entry) -> Act | None:
    """The act in a journal line, None in others; MadrobError where the details do not fit."""
    if entry.what not in ACT_CALLED:
        return None
    try:
        return act_named(entry.what, entry.details)
    except MadrobError as error:
        raise MadrobError(f"journal line is damaged: {error}") from None


def rebuild(
    entries: Iterable[Entry], handle_zero: float = 0.0, zero_samples: HandleRest | None = None
) -> Run:
    """The run after all entries; MadrobError where a line is damaged.

    `handle_zero` (N) and `zero_samples` are those stored with the run: they may be older than it.
    """
    run = Run()
    for entry in entries:
        run = after(run, entry)
    return replace(run, handle_zero=handle_zero, zero_samples=zero_samples)


def after(run: Run, entry: Entry) -> Run:
    """The run after one more entry; MadrobError where the line is damaged."""
    try:
        act = act_of(entry)
        if act is None:
            return _changed(run, entry)
        if run.setup is None and Consequence.NEW_RUN not in act.consequences:
            return run
        if entry.id and Consequence.COUNTDOWN in act.consequences:
            return run  # it begins when that line is on disk: a line of its own says when
        return act.apply(Situation(run), _time(entry.time))
    except (KeyError, ValueError, TypeError, ArithmeticError) as error:
        what = terminal_safe(f"'{entry.what}' is damaged: {error}")
        raise MadrobError(f"journal line {what}") from None


def _time(field: float) -> float:
    if not 0.0 <= (time := float(field)) <= _LATEST:
        raise ValueError(f"{time:g} is no time")
    return time


def _changed(run: Run, entry: Entry) -> Run:
    details = entry.details
    match entry.what:
        case Change.COUNTDOWN_BEGINS if run.setup is not None:
            decided = decide_false_starts(run, "countdown restarted")
            return begin_countdown(decided, _time(details["time"]))
        case Change.COUNTDOWN_HELD if run.phase is Phase.COUNTDOWN:
            return replace(run, held=_time(details["time"]))
        case Change.RUN_STARTS:
            return begin_run(run)
        case Change.TIMEOUT_ELAPSED:
            return time_out(run, _time(details["time"]), entry.reason)
        case Change.RUN_STOPS:
            return stop(run, Outcome(details["outcome"]), _time(details["time"]), entry.reason)
        case Change.FALSE_START | Change.ROBOT_STARTS | Change.ROBOT_SAYS | Change.FAULT:
            return _with_observed(run, entry, _time(details["time"]))
        case Change.UNRECORDED | Change.EVIDENCE_RECORDED:
            return _with_recorded(run, entry)
        case Change.REISSUED | Change.RESTORED if run.phase in (Phase.STOPPED, Phase.FINAL):
            rules = msgspec.convert(details.get("ruleset"), StoredRuleset | None)
            at = _time(entry.time)
            return changed(reissued(run, at, entry.what, entry.reason, entry.referee, rules), at)
        case Change.RESULT_WRITTEN:
            return replace(run, issue=max(run.issue, int(details["issue"])))
        case _:
            return run


def _with_observed(run: Run, entry: Entry, at: float) -> Run:
    if entry.what == Change.ROBOT_STARTS:
        return replace(run, robot_start=at)
    if entry.what == Change.ROBOT_SAYS:
        return replace(run, robot_words=entry.reason)
    if entry.what == Change.FALSE_START:
        mark = FalseStart(at, EventName(entry.details["event"]))
        return replace(run, false_starts=(*run.false_starts, mark))
    kind = FaultKind(entry.details["kind"])
    return note_fault(run, TestbedFault(at, entry.reason, kind))


def _with_recorded(run: Run, entry: Entry) -> Run:
    details = entry.details
    if entry.what == Change.UNRECORDED:
        return replace(run, unrecorded=max(0, int(details["messages"])))
    return replace(run, evidence=msgspec.convert(details, Evidence))


_BESIDE = {Change.EVENT, Change.EVIDENCE, Change.RESULT_WRITTEN, Change.WITHDRAWN}
"""Lines that change no result; their place among the others may differ."""

_OPENING = (Reissue, Void, Correct, TakeBack, FileProtest, DecideProtest, WithdrawProtest)
_OPENS = {*(act.name for act in _OPENING), Change.REISSUED, Change.RESTORED}


def mark_of(entries: Iterable[Entry]) -> JournalMark:
    growing = GrowingMark()
    for entry in entries:
        growing.add_line(entry)
    return growing.mark


def marks_of(entries: Iterable[Entry]) -> Iterator[JournalMark]:
    """The mark after each line."""
    growing = GrowingMark()
    for entry in entries:
        growing.add_line(entry)
        yield growing.mark


class GrowingMark:
    """The mark of a journal that is still being written."""

    def __init__(self) -> None:
        self._lines = 0
        self._digest = hashlib.sha256()
        self._final = False
        self.mark = JournalMark(0, self._digest.hexdigest())

    def add_line(self, entry: Entry) -> None:
        if entry.what in _BESIDE:
            return
        self._digest.update(f"{entry.to_json()}\n".encode())
        self._lines += 1
        if not self._final or entry.what in _OPENS:
            self.mark = JournalMark(self._lines, self._digest.hexdigest())
            self._final = entry.what == Finalise.name
