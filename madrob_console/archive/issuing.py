"""Issues results, and refuses one that may not take the place of the stored one.

The only writer of `result.json` and of the files beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.file_digests import FileDigest, digests_of
from madrob_console.archive.folders import ISSUE_FILE, JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.journal_agreement import Details, was_changed, written_details
from madrob_console.archive.result_reader import LARGEST_RESULT
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import atomic_write, atomic_writes
from madrob_console.common.plain_files import OpenFolder, naming_folder, read_all, refusal
from madrob_console.common.stored_json import decode
from madrob_console.referee.journal import Entry, Journal, Origin, refusal_words
from madrob_console.referee.rebuild import Change, marks_of
from madrob_console.referee.records import JournalMark

ResultFiles = Mapping[str, bytes | memoryview]


class DamagedIssueError(MadrobError):
    """The stored result is damaged, and the new one is not the same again."""


def issue(
    folder: OpenFolder,
    files: ResultFiles,
    entries: Sequence[Entry],
    journal: Journal | None = None,
    *,
    now: float = 0.0,
    why: Entry | None = None,
    in_console: bool = False,
) -> Details:
    """Write a result and its files; an earlier issue is kept by its number.

    A deleted folder is made again: the result is all that is left of the run. `entries` are the
    lines of the run's journal, also those that are not on disk yet. `journal` gets the line `why`,
    if any, before the result, and the line `result written` after it, `now` (s since the epoch).
    Without `journal` the caller writes a line with the details that are returned. `in_console`: a
    next issue is taken even if its recording differs, as the referee sees it.

    Raises:
        DamagedIssueError: see there.
        MadrobError: the stored result is of another recording, or of journal lines that are
            missing, or the disk refuses.
    """
    try:
        folder.restore()
    except OSError as error:
        raise MadrobError(
            f"{folder.path}: cannot be made again ({error.strerror}): check disk space, "
            "permissions and what has its name"
        ) from None
    with naming_folder(folder.path, folder.inside):
        return _issue(folder.inside, files, entries, journal, now, why, in_console=in_console)


def _issue(
    folder: Path,
    files: ResultFiles,
    entries: Sequence[Entry],
    journal: Journal | None,
    now: float,
    why: Entry | None,
    *,
    in_console: bool,
) -> Details:
    result = files[RESULT_FILE]
    details = written_details(result)
    stored = _stored(folder)
    noted = [entry.details for entry in entries if entry.what == Change.RESULT_WRITTEN]
    if stored is not None and stored != result:
        _check(folder, stored, result, entries, noted, in_console=in_console)
    if why is not None:
        _append(folder, journal, why, "nothing was re-issued")
    try:
        _write(folder, files, stored, int(details["issue"]))
    except MadrobError as error:
        if why is None:
            raise
        raise MadrobError(
            f"{folder}: version {details['issue']} is journalled, its result is not written yet: "
            f"`madrob recover` writes it ({error})"
        ) from None
    if journal is not None and details not in noted:
        written = Entry(now, Origin.SYSTEM, Change.RESULT_WRITTEN, details=details)
        _append(folder, journal, written, "see to the disk")
    return details


def restore_files(folder: Path, files: ResultFiles, digests: Mapping[str, FileDigest]) -> bool:
    """Write again what the stored result lists and the disk has not, from fresh `files`.

    MadrobError names those that would not be what the result lists; the others are written.
    """
    there, _ = digests_of(folder)
    lost = {name for name in files if digests.get(name) not in (None, there.get(name))}
    fresh, _ = digests_of(folder, {name: bytes(files[name]) for name in lost})
    again = {name: files[name] for name in lost if fresh[name] == digests[name]}
    atomic_writes(folder, again)
    if others := ", ".join(sorted(lost - again.keys())):
        raise MadrobError(
            f"{folder}: the recording does not give {others} as {RESULT_FILE} lists them: put "
            "copies back"
        )
    return bool(again)


def _write(folder: Path, files: ResultFiles, stored: bytes | None, number: int) -> None:
    beside = {
        name: content
        for name, content in files.items()
        if name != RESULT_FILE and not has_content(folder / name, content)
    }
    atomic_writes(folder, beside)
    earlier = folder / ISSUE_FILE.format(number - 1)
    if number > 1 and stored is not None and not earlier.exists():
        atomic_write(earlier, stored)
    atomic_write(folder / RESULT_FILE, files[RESULT_FILE])


def has_content(path: Path, content: bytes | memoryview) -> bool:
    """Whether a file has this content, and so has it on disk: files are written whole."""
    try:
        # by digests: comparing a view would hold up the other threads, 1 ms for each MB
        return sha256(read_all(path, len(content))).digest() == sha256(content).digest()
    except OSError:
        return False


def _append(folder: Path, journal: Journal | None, line: Entry, otherwise: str) -> None:
    assert journal is not None
    if not journal.append([line]):
        assert journal.refused is not None
        raise MadrobError(f"{folder}: {refusal_words(journal.refused)}: {otherwise}")


def _stored(folder: Path) -> bytes | None:
    try:
        return read_all(folder / RESULT_FILE, LARGEST_RESULT)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise MadrobError(
            f"{folder / RESULT_FILE}: cannot be read ({refusal(error)}): rename it"
        ) from None


class _SignalSamples(msgspec.Struct):
    signal: str
    samples: int


class _Samples(msgspec.Struct):
    signals: tuple[_SignalSamples, ...]


class _Sources(msgspec.Struct):
    """What a result says of the files that it was computed from."""

    issue: int
    quality: _Samples
    journal: JournalMark
    files: dict[str, FileDigest]
    closure: Any = None

    @property
    def recording(self) -> set[str]:
        return {each.sha256 for name, each in self.files.items() if name.endswith(".mcap")}

    def is_of_recording_of(self, other: _Sources, *, incomplete: bool) -> bool:
        """`incomplete`: the recording lacks messages that are in the stored result."""
        same = bool(self.recording) and self.recording == other.recording
        return (same and not incomplete) or self.quality == other.quality


def _check(
    folder: Path,
    stored: bytes,
    result: bytes | memoryview,
    entries: Sequence[Entry],
    noted: Sequence[Details],
    *,
    in_console: bool,
) -> None:
    """Refuse a result that may not take the place of the stored one; `noted` by the journal."""
    new, old = decode(result, _Sources), _sources_of(stored)
    lost = MadrobError(
        f"{folder}: {JOURNAL_FILE} lacks lines that {RESULT_FILE} was made of: put a copy of it "
        f"back, or rename {RESULT_FILE} and decide in the console"
    )
    last = noted[-1] if noted else Details()
    ahead = old is not None and old.journal.lines > new.journal.lines
    other = old is not None and old.journal.sha256 != new.journal.sha256
    if (ahead and other) or int(last.get("lines", 0)) > new.journal.lines:
        raise lost
    if written_details(result) in noted:
        return  # it was issued; the stored one is damaged or older
    number = max(0 if old is None else old.issue, int(last.get("issue", 0)))
    is_next = 0 < number < new.issue
    if is_next and (in_console or old is None):
        return
    damaged = not is_next and was_changed(stored, folder) and last.get("lines") == new.journal.lines
    if damaged or old is None:
        raise DamagedIssueError(
            f"{folder}: {RESULT_FILE} is damaged, and what the recording gives is not the same: "
            "put a copy of it back, or try `madrob recover`: it makes the next version"
        )
    if not is_next and old.journal not in marks_of(entries):
        raise lost
    unsigned = old.closure is None and new.closure is None
    if unsigned and new.journal.lines > old.journal.lines:
        return  # the referee has decided something since
    incomplete = any(entry.what == Change.UNRECORDED for entry in entries)
    if not new.is_of_recording_of(old, incomplete=incomplete):
        raise MadrobError(
            f"{folder}: the recording is not the one that {RESULT_FILE} was made of: put that "
            f"back, or rename {RESULT_FILE} and decide in the console"
        )


def _sources_of(stored: bytes) -> _Sources | None:
    """None where the stored result is damaged."""
    try:
        return decode(stored, _Sources)
    except MadrobError:
        return None
