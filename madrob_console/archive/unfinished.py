"""Runs that were cut off: no result, and nobody works on them."""

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
from madrob_console.files import held
from madrob_console.files.bounded import stamp_of
from madrob_console.files.plain import open_plain
from madrob_console.referee.journal import HOLD_FILE, LARGEST_JOURNAL, Entry
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from scoring.protocol import event_words

MOST_READ = 2 * LARGEST_JOURNAL
"""Of journals at one look, bytes: less than 2 s, whatever they hold."""


@dataclass(frozen=True, slots=True)
class Unfinished:
    """What is known of a run that was cut off.

    Attributes:
        folder: as seen from the results folder.
        subject, team, run_number, condition: whose and which; 0 and empty where unknown.
        phase: where it stood.
        started: planned or actual start, s since the epoch; None before the countdown.
        last_time: of the last line of its journal, s since the epoch; None without a line.
        last_event: the last thing that the sensors said, in words; empty for nothing.
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
        """All of it in one sentence."""
        kind = "practice run" if lies_in_practice(self.folder) else "run"
        who = f"{kind} {self.run_number} of subject {self.subject} {self.team}".rstrip()
        known = [f"{who} was cut off while {self.phase}"]
        if self.started is not None and self.last_time is not None:
            known.append(f"last line {self.last_time - self.started:+.1f} s from the start")
        known.append(f"last event {self.last_event}" if self.last_event else "no event yet")
        known.append(f"{self.recorded / 1e6:.1f} MB recorded")
        return ", ".join(known)


def find_unfinished(root: Path) -> tuple[Unfinished, ...]:
    """The runs of a results folder that were cut off, oldest first.

    A run whose journal is held goes on elsewhere; one whose countdown never began
    is none: nothing is to be decided about it. One whose journal cannot be used is left out: the
    history says what is wrong with it. Beyond `MOST_READ` bytes of journals the later ones wait
    until those before them are decided.

    Raises:
        MadrobError: the folder cannot be read.
    """
    found: list[Unfinished] = []
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
                found.append(_known(name, folder, journal.entries, journal.run))
    return tuple(found)


def is_held(journal: Path) -> bool:
    """Whether an engine works on the run of this journal.

    Where its hold does not tell (another user's run, or one that an older version recorded), the
    lock of the journal itself does, which everybody can hold who may read it.
    """
    if (told := held.is_held(journal.with_name(HOLD_FILE))) is not None:
        return told
    try:
        file = open_plain(journal)
    except OSError:
        return False
    try:
        return held.locked_by_another(file)
    finally:
        os.close(file)


def _known(name: str, folder: Path, entries: tuple[Entry, ...], run: Run) -> Unfinished:
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
