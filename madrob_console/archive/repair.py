"""Makes the result of a run again where it is not what the journal says, or is damaged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.result_reader import read_file_digests
from madrob_console.archive.result_writer import result_files, write_result
from madrob_console.archive.scored import Scored, open_run
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import stamp_of
from madrob_console.files.held import Hold
from madrob_console.referee.journal import HOLD_FILE


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
        with Hold(folder / HOLD_FILE):
            opened = open_run(folder)
            if not opened.out_of_date and _has_all_files(folder):
                return None
            run = replace(opened.recorded.run, issue=max(1, opened.recorded.run.issue))
            scored = Scored.of(opened.recorded.record, run, opened.assessment)
            write_result(folder, result_files(folder, scored), run.issue)
            return scored
    except BlockingIOError:
        raise busy from None
    except OSError as error:
        raise MadrobError(f"{folder}: cannot be written ({error.strerror})") from None


def _has_all_files(folder: Path) -> bool:
    """Whether the data files that the result names are there, in their size."""
    sizes = {name: digest.bytes for name, digest in read_file_digests(str(folder)).items()}
    for name, size in sizes.items():
        if name.endswith(".mcap") or "/" in name:
            continue  # the recording itself: `recover` sees to it
        stamp = stamp_of(str(folder / name))
        if stamp is None or stamp[1] != size:
            return False
    return True
