"""Runs that were cut off: no result, and nobody works on them."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, run_folder_names
from madrob_console.errors import MadrobError
from madrob_console.files.plain import open_plain
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class Unfinished:
    """What is known of a run that was cut off.

    Attributes:
        folder: its name in the results folder.
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
        who = f"run {self.run_number} of subject {self.subject} {self.team}".rstrip()
        known = [f"{who} was cut off while {self.phase}"]
        if self.started is not None and self.last_time is not None:
            known.append(f"last line {self.last_time - self.started:+.1f} s from the start")
        known.append(f"last event {self.last_event}" if self.last_event else "no event yet")
        known.append(f"{self.recorded / 1e6:.1f} MB recorded")
        return ", ".join(known)


def find_unfinished(root: Path) -> tuple[Unfinished, ...]:
    """The runs of a results folder that were cut off, oldest first.

    A run whose journal is locked goes on elsewhere; one without a journal line never began.

    Raises:
        MadrobError: the folder cannot be read.
    """
    found = []
    for name in sorted(run_folder_names(root), key=lambda name: name[-15:]):
        folder = root / name
        with suppress(OSError, MadrobError):  # the history says what is wrong with it
            if (folder / RESULT_FILE).exists() or is_held(folder / JOURNAL_FILE):
                continue
            entries, _ = read_journal(folder / JOURNAL_FILE)
            if entries:
                found.append(_known(folder, entries, rebuild(entries)))
    return tuple(found)


def is_held(journal: Path) -> bool:
    """Whether an engine works on the run of this journal."""
    try:
        file = open_plain(journal)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a network disk without locks, on which no engine records
    finally:
        os.close(file)
    return False


def _known(folder: Path, entries: tuple[Entry, ...], run: Run) -> Unfinished:
    events = [e.details.get("event", "") for e in entries if e.what == Change.EVENT]
    setup = run.setup
    return Unfinished(
        folder=folder.name,
        subject=0 if setup is None else setup.subject,
        team="" if setup is None else setup.team,
        run_number=0 if setup is None else setup.run_number,
        condition=0 if setup is None else setup.condition.number,
        phase=run.phase,
        started=run.start,
        last_time=entries[-1].time,
        last_event=str(events[-1]) if events else "",
        recorded=sum(path.stat().st_size for path in folder.glob("*.mcap")),
    )
