"""Runs that were cut off: they have no result, and no process works on them."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    lies_in_practice,
    run_folder_names,
)
from madrob_console.archive.run_journal import UnusableJournalError, read_run_journal
from madrob_console.common import file_locks
from madrob_console.common.plain_files import open_plain, stamp_of
from madrob_console.referee.journal import HOLD_FILE, LARGEST_JOURNAL, Entry
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from scoring.protocol import event_words

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
    def stopped(self) -> bool:
        """Whether its journal says how it ended: only its result is missing."""
        return self.phase in (Phase.STOPPED, Phase.FINAL)

    @property
    def words(self) -> str:
        kind = "practice run" if lies_in_practice(self.folder) else "run"
        who = f"{kind} {self.run_number} of subject {self.subject} {self.team}".rstrip()
        state = (
            f"is {self.phase} and has none" if self.stopped else f"was cut off while {self.phase}"
        )
        facts = [f"{who} {state}"]
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

    Where the hold of another user's run does not tell, the lock of the journal does: everybody can
    take it who may read the file.
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
