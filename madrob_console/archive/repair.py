"""Repairs the result of a run and its files."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.issuing import DamagedIssueError, issue, restore_files
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_files import eurobench_files, result_files
from madrob_console.archive.result_reader import lacks_line, read_sound_result
from madrob_console.archive.run_journal import journal_held
from madrob_console.archive.scored import OpenedRun, RecordedRun, Scored, open_run
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.common.formatting import counted
from madrob_console.common.plain_files import OpenFolder, stamp_of
from madrob_console.referee.journal import HOLD_FILE, Entry, Journal, Origin
from madrob_console.referee.rebuild import Change, after, mark_of
from recorder.bag import METADATA_FILE


def repair(folder: Path, *, restore: bool = False) -> Scored | None:
    """Make good what a power cut or damage did to a run's result and its files.

    A result that its journal contradicts is made again, a lost file beside it likewise. With
    `restore` a damaged result that cannot be made again as it was gets the next issue. A run
    without a result waits for the referee. Returns None when nothing was written.

    Raises:
        MadrobError: what is stored stays, and why; or somebody works on the run.
    """
    if stamp_of(str(folder / RESULT_FILE)) is None:
        return None
    busy = MadrobError(f"{folder}: a console works on this run")
    if is_held(folder / JOURNAL_FILE):
        raise busy
    try:
        with _journal_of(folder) as journal:
            return _repaired(folder, open_run(folder), journal, restore=restore)
    except BlockingIOError:
        raise busy from None
    except OSError as error:
        raise MadrobError(f"{folder}: cannot be written ({error.strerror})") from None


@contextmanager
def _journal_of(folder: Path) -> Iterator[Journal | None]:
    """The journal, held; None where there is none."""
    if (folder / JOURNAL_FILE).exists():
        with journal_held(folder) as journal:
            yield journal
    else:
        with Hold(folder / HOLD_FILE):
            yield None


def _repaired(
    folder: Path, opened: OpenedRun, journal: Journal | None, *, restore: bool
) -> Scored | None:
    recorded, now = opened.recorded, time.time()
    run = replace(recorded.run, issue=max(1, recorded.run.issue))
    stored = read_sound_result(str(folder))
    waits = opened.out_of_date or (stored is not None and lacks_line(str(folder)))
    if stored is not None and (journal is None or not waits):
        if not _lacks_files(folder, stored):
            return None
        scored = Scored.of(recorded.record, run, opened.assessment)
        again = restore_files(folder, eurobench_files(folder.name, scored), stored.files)
        return scored if again else None
    scored = Scored.of(recorded.record, run, opened.assessment)
    try:
        issue_in(folder, result_files(folder, scored), recorded.entries, journal, now)
    except DamagedIssueError:
        if not restore:
            raise
        _refuse_incomplete(folder, recorded)
        why = Entry(now, Origin.SYSTEM, Change.RESTORED, reason=f"{RESULT_FILE} was damaged")
        run = replace(after(run, why), journal=mark_of((*recorded.entries, why)))
        scored = Scored.of(recorded.record, run, opened.assessment)
        files = result_files(folder, scored)
        issue_in(folder, files, recorded.entries, journal, now, why)
    return scored


def issue_in(
    folder: Path,
    files: Mapping[str, bytes],
    entries: Sequence[Entry],
    journal: Journal | None,
    now: float,
    why: Entry | None = None,
) -> None:
    with OpenFolder(folder.resolve()) as opened:
        issue(opened, files, entries, journal, now=now, why=why)


def _lacks_files(folder: Path, stored: ResultDocument) -> bool:
    """Whether a file that was made with the result is missing or has another size."""
    for name, listed in stored.files.items():
        if name.endswith(".mcap") or "/" in name or name == METADATA_FILE:
            continue  # the recording itself: `recover` sees to it
        stamp = stamp_of(str(folder / name))
        if stamp is None or stamp.size != listed.bytes:
            return True
    return False


def _refuse_incomplete(folder: Path, recorded: RecordedRun) -> None:
    """Refuse to make a result from less than the lost one was made of."""
    run, record = recorded.run, recorded.recorded_as
    problems = [recorded.bag.problem, *recorded.remarks, run.record_lost]
    if not (folder / JOURNAL_FILE).exists():
        problems.append(f"{JOURNAL_FILE} is missing")
    if run.unrecorded:
        problems.insert(0, f"the recording lacks {counted(run.unrecorded, 'message')}")
    if run.setup is None or run.setup.run_id != record.setup.run_id:
        problems.append("journal and recording are not of the same run")
    if why := next(filter(None, problems), None):
        raise MadrobError(
            f"{folder}: {RESULT_FILE} is damaged and cannot be made again ({why}): put a copy of "
            "it back"
        )
