"""Repairs a run: its torn recording, and a result that is damaged or not what the journal says."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from uuid import UUID

from madrob_console.archive.agreement import Details, written_details
from madrob_console.archive.digests import (
    identity_record,
    kept_run_id,
    lists_evidence,
    run_id_at,
)
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.result_reader import (
    UnusableResultError,
    read_file_digests,
    read_result,
)
from madrob_console.archive.result_writer import result_files, write_result
from madrob_console.archive.run_journal import journal_held
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.archive.scored import Scored, open_run
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import stamp_of
from madrob_console.files.held import Hold
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin
from madrob_console.referee.rebuild import Change
from recorder.bag import METADATA_FILE
from recorder.reader import read_bag
from recorder.recovery import Recovered, recover


def recover_recording(path: Path) -> Recovered:
    """Repair the recording of a run, or any other bag.

    A run of an earlier version is known by its recording's digest, and is the same run after it.

    Raises:
        RecorderError: it cannot be repaired; nothing is lost, the message names the remedy.
    """
    return recover(path, lambda: _identity(path))


def _identity(path: Path) -> dict[str, dict[str, str]]:
    """What a recording says of its run from now on; nothing where it says so already."""
    record = read_bag(path).records.get(RECORD_NAME)
    try:
        if record is None or RunRecord.from_metadata(record).setup.run_id or kept_run_id(path):
            return {}
    except MadrobError:
        return {}  # nobody can use it
    return identity_record(_told_run_id(path) or run_id_at(path))


def _told_run_id(path: Path) -> str:
    """The identity by the result beside a recording, which may be older than its damage.

    Empty where none is told.
    """
    folder = path.parent if path.is_file() else path
    if path.is_file() and path.name not in read_file_digests(str(folder)):
        return ""  # of another run
    try:
        return str(UUID(read_result(str(folder))[0].run_id))
    except (FileNotFoundError, UnusableResultError, ValueError):
        return ""


def repair(folder: Path) -> Scored | None:
    """Make a result again from journal and recording; only files that differ are written.

    A run without a result waits for the referee, one that nobody worked on since its result was
    written is as it should be.

    Returns:
        The run, if anything was written.

    Raises:
        MadrobError: somebody works on the run, it cannot be read, or the disk refuses.
    """
    if stamp_of(str(folder / RESULT_FILE)) is None:
        return None
    journal, busy = folder / JOURNAL_FILE, MadrobError(f"{folder}: a console works on this run")
    if is_held(journal):
        raise busy
    try:
        with Hold(folder / HOLD_FILE) as hold:
            opened = open_run(folder)
            if not opened.out_of_date and _has_all_files(folder):
                return None
            run = replace(opened.recorded.run, issue=max(1, opened.recorded.run.issue))
            scored = Scored.of(opened.recorded.record, run, opened.assessment)
            files = result_files(folder, scored)
            write_result(folder, files, run.issue)
            details = written_details(files[RESULT_FILE], run.issue)
            if all(entry.details != details for entry in opened.recorded.entries):
                _note_written(folder, hold, details)
            return scored
    except BlockingIOError:
        raise busy from None
    except OSError as error:
        raise MadrobError(f"{folder}: cannot be written ({error.strerror})") from None


def _note_written(folder: Path, hold: Hold, details: Details) -> None:
    """Journal what was written, where there is a journal.

    Raises:
        MadrobError: the disk refuses.
        OSError: likewise.
    """
    with suppress(FileNotFoundError), journal_held(folder, hold) as journal:
        written = Entry(time.time(), Origin.SYSTEM, Change.RESULT_WRITTEN, details=details)
        if not journal.append([written]) and journal.refused is not None:
            raise journal.refused


def _has_all_files(folder: Path) -> bool:
    """Whether the data files that the result names are there, in their size."""
    sizes = {name: digest.bytes for name, digest in read_file_digests(str(folder)).items()}
    for name, size in sizes.items():
        if name.endswith(".mcap") or "/" in name:
            continue  # the recording itself: `recover` sees to it
        if name == METADATA_FILE and lists_evidence(folder):
            continue
        stamp = stamp_of(str(folder / name))
        if stamp is None or stamp.size != size:
            return False
    return True
