"""The journal of a run on disk: read safely, compared with the result; runs cut off."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    lies_in_practice,
    run_folder_names,
)
from madrob_console.archive.result_document import ResultDocument
from madrob_console.common import file_locks
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import utc_text
from madrob_console.common.names import terminal_safe
from madrob_console.common.plain_files import open_plain, read_all, refusal, stamp_of
from madrob_console.referee.acts import FileProtest, Finalise
from madrob_console.referee.journal import HOLD_FILE, LARGEST_JOURNAL, Entry, Journal, read_journal
from madrob_console.referee.rebuild import Change, mark_of, rebuild
from madrob_console.referee.records import JournalMark, TeamWord
from madrob_console.referee.run import Phase, Run
from scoring.protocol import event_words


class UnusableJournalError(MadrobError):
    """A journal that cannot be used."""


_OF_A_RUN = (Change.COUNTDOWN_BEGINS, Change.RUN_STARTS, Change.RUN_STOPS)


@dataclass(frozen=True, slots=True)
class RunJournal:
    """A journal as read; `run` has all lines and the journal's mark, but no handle zero."""

    entries: tuple[Entry, ...]
    run: Run

    @property
    def never_ran(self) -> str:
        """Why there is nothing to score; empty where a run began or nothing is known."""
        if self.run.start is not None or not self.entries:
            return ""
        last = self.entries[-1]
        why = last.reason if last.what == Change.WITHDRAWN else ""
        return f"the run was never started{f': {why}' if why else ''}"


def read_run_journal(folder: Path) -> RunJournal:
    """The journal of a run folder; FileNotFoundError if there is none."""
    try:
        entries, _ = read_journal(folder / JOURNAL_FILE)
        return RunJournal(entries, replace(_run_of(entries), journal=mark_of(entries)))
    except FileNotFoundError:
        raise
    except NotADirectoryError as error:  # the file of a bag alone
        raise FileNotFoundError(*error.args) from None
    except OSError as error:
        raise _unusable(f"cannot be read ({refusal(error)})") from None
    except MadrobError as error:
        raise _unusable(f"is damaged ({error})") from None
    except Exception as error:  # noqa: BLE001  whatever it is, it is this run's and no other's
        raise _unusable(f"is damaged ({type(error).__name__})") from None


def recorded_competition(folder: Path) -> str | None:
    """The competition of a run by its journal; None = that does not say."""
    try:
        setup = read_run_journal(folder).run.setup
    except (OSError, UnusableJournalError):
        return None
    return None if setup is None else setup.competition


@contextmanager
def journal_held(folder: Path) -> Iterator[Journal]:
    """Opens a run's journal to append, under its lock.

    Raises:
        BlockingIOError: somebody else works on the run.
    """
    journal = Journal()
    journal.reopen(folder / JOURNAL_FILE)
    try:
        yield journal
    finally:
        journal.close()


def ever_protested(folder: Path) -> bool:
    """Whether a team ever protested, or may have: the journal cannot be used."""
    try:
        entries, _ = read_journal(folder / JOURNAL_FILE)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return any(
        entry.what == FileProtest.name
        or (entry.what == Finalise.name and entry.details.get("team_word") == TeamWord.PROTESTED)
        for entry in entries
    )


def evidence_removed(folder: Path) -> str:
    """When the evidence of a run was removed; empty = never, or unknown."""
    try:
        return read_run_journal(folder).run.evidence_removed(utc_text)
    except (UnusableJournalError, OSError):
        return ""


def _run_of(entries: tuple[Entry, ...]) -> Run:
    run = rebuild(entries)
    if run.start is None and any(entry.what in _OF_A_RUN for entry in entries):
        raise MadrobError("the line of its set-up or of its start cannot be read")
    return run


def _unusable(what: str) -> UnusableJournalError:
    words = f"{JOURNAL_FILE} {what}: put it away, and `madrob score` goes by the recording's own"
    return UnusableJournalError(terminal_safe(words))


# The comparison of a result with its journal, which is what counts.


Details = dict[str, int | str]

_DIGEST = "sha256"


class _Marked(msgspec.Struct):
    issue: int = 0
    journal: JournalMark | None = None


def written_details(result: bytes | memoryview) -> Details:
    """What the journal's line `result written` says of a `result.json`."""
    said = msgspec.json.decode(result, type=_Marked)
    lines = 0 if said.journal is None else said.journal.lines
    return {"issue": said.issue, "lines": lines, _DIGEST: hashlib.sha256(result).hexdigest()}


def is_noted(data: bytes, folder: Path) -> bool:
    """Whether the journal has the digest of a `result.json`: it is as it was written."""
    digest = hashlib.sha256(data).hexdigest().encode()
    try:
        return digest in read_all(folder / JOURNAL_FILE, LARGEST_JOURNAL)
    except OSError:
        return False


def was_changed(data: bytes, folder: Path) -> bool:
    """Whether a `result.json` differs from the one that the journal says was written.

    The journal's line follows the file, and a kill can come between. So a result of more lines
    than the last one noted waits for its line. A journal of an earlier version has no digests,
    and one that cannot be used says nothing here.
    """
    if is_noted(data, folder):
        return False
    try:
        entries, _ = read_journal(folder / JOURNAL_FILE)
    except OSError:
        return False
    noted = _noted_in(entries)
    if not noted or _DIGEST not in noted[-1]:
        return False
    try:
        mark = msgspec.json.decode(data, type=_Marked).journal
    except msgspec.MsgspecError:
        return True
    return mark != mark_of(entries) or noted[-1].get("lines") == mark.lines


def waits_for_line(data: bytes, folder: Path) -> bool:
    """Whether the journal lacks the line `result written` of a `result.json`.

    A kill does that, and so does somebody who deletes the line. A journal of an earlier version has
    no digests.
    """
    try:
        noted = _noted_in(read_journal(folder / JOURNAL_FILE)[0])
    except OSError:
        return False
    return not is_noted(data, folder) and (not noted or _DIGEST in noted[-1])


def _noted_in(entries: Iterable[Entry]) -> list[Mapping[str, Any]]:
    return [entry.details for entry in entries if entry.what == Change.RESULT_WRITTEN]


def disagreement(result: ResultDocument, folder: Path) -> str | None:
    """Why a result does not agree with its journal; None = it does, or there is none."""
    try:
        run = read_run_journal(folder).run
    except FileNotFoundError:
        return None
    return ", ".join(disagreements(result, run)) or None


def disagreements(result: ResultDocument, run: Run) -> Iterator[str]:
    """The differences between a result and the state of its run; cheap, numbers left out.

    `result` may be of a version without the journal's mark; `run` has all lines and the mark.
    """
    issue = max(1, run.issue)
    if result.issue != issue:
        yield f"version {result.issue}, the journal has version {issue}"
    word = "not final" if result.closure is None else result.closure.team_word
    said = "not final" if run.closure is None else run.closure.team_word.value
    if word != said:
        yield f"{word}, in the journal {said}"
    if result.outcome is not run.ending.outcome:
        yield f"{result.outcome}, in the journal {run.ending.outcome}"
    if (result.voided is None) is not (run.voided is None):
        yield "void, in the journal it counts" if result.voided else "void in the journal only"
    made_of = result.journal or None
    if made_of and run.journal and made_of != run.journal:
        yield f"made of {made_of.lines} lines of the journal, which has {run.journal.lines}"


def out_of_date(why: str) -> str:
    return (
        f"{RESULT_FILE} is not what the journal says ({why}): an engine that starts makes it again,"
        " and so does `madrob recover`"
    )


# Runs that were cut off: no result, and no process works on them.


MOST_READ = 2 * LARGEST_JOURNAL
"""Bytes of journals read at once: less than 2 s, whatever they hold."""


@dataclass(frozen=True, slots=True)
class Unfinished:
    """A run that was cut off; numbers are 0 and texts empty where unknown.

    Attributes:
        folder: relative to the results folder.
        started: planned or actual start, s since the epoch; None before the countdown.
        last_time: of the last line of its journal, s since the epoch; None without a line.
        last_event: the last event of the sensors; empty for none.
        recorded: bytes of its recording on disk.
    """

    folder: str
    subject: int
    team: str
    run_number: int
    condition: int
    phase: Phase
    started: float | None
    last_time: float | None
    last_event: str
    recorded: int

    @property
    def words(self) -> str:
        kind = "practice run" if lies_in_practice(self.folder) else "run"
        who = f"{kind} {self.run_number} of subject {self.subject} {self.team}".rstrip()
        facts = [f"{who} was cut off while {self.phase}"]
        if self.started is not None and self.last_time is not None:
            facts.append(f"last line {self.last_time - self.started:+.1f} s from the start")
        facts.append(f"last event {self.last_event}" if self.last_event else "no event yet")
        facts.append(f"{self.recorded / 1e6:.1f} MB recorded")
        return ", ".join(facts)


def find_unfinished(root: Path) -> tuple[Unfinished, ...]:
    """The runs of a results folder that were cut off, oldest first.

    Left out are runs whose journal is locked (they go on elsewhere), whose countdown never began
    (nothing to decide), or whose journal cannot be used (the history says so). Beyond `MOST_READ`
    bytes of journals the later runs wait until those before them are decided.
    """
    unfinished: list[Unfinished] = []
    left = MOST_READ
    for name in sorted(run_folder_names(root), key=lambda name: name[-15:]):
        folder = root / name
        with suppress(OSError, UnusableJournalError):
            if (folder / RESULT_FILE).exists() or is_held(folder / JOURNAL_FILE):
                continue
            stamp = stamp_of(str(folder / JOURNAL_FILE))
            size = 0 if stamp is None else stamp.size
            if size <= LARGEST_JOURNAL and (left := left - size) < 0:
                break
            journal = read_run_journal(folder)
            if journal.run.start is not None:
                unfinished.append(_unfinished(name, folder, journal.entries, journal.run))
    return tuple(unfinished)


def is_held(journal: Path) -> bool:
    """Whether an engine works on the run of this journal.

    Where the hold does not tell (another user's run, or one of an older version), the lock of the
    journal does: everybody can take it who may read the file.
    """
    if (held := file_locks.is_held(journal.with_name(HOLD_FILE))) is not None:
        return held
    try:
        file = open_plain(journal)
    except OSError:
        return False
    try:
        return file_locks.locked_by_another(file)
    finally:
        os.close(file)


def _unfinished(name: str, folder: Path, entries: tuple[Entry, ...], run: Run) -> Unfinished:
    events = [e.details.get("event", "") for e in entries if e.what == Change.EVENT]
    setup = run.setup
    return Unfinished(
        folder=name,
        subject=0 if setup is None else setup.subject,
        team="" if setup is None else setup.team,
        run_number=0 if setup is None else setup.run_number,
        condition=0 if setup is None else setup.condition.number,
        phase=run.phase,
        started=run.start,
        last_time=entries[-1].time,
        last_event=event_words(str(events[-1])) if events else "",
        recorded=sum(
            stamp.size for path in folder.glob("*.mcap") if (stamp := stamp_of(str(path)))
        ),
    )
