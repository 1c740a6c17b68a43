"""Runs on disk: folder names, run numbers, where to record (protocol section 10).

A results folder holds one folder a run and `run_numbers.jsonl`, the numbers ever given out: a run
number is never used again, even when its folder is gone. Its sub-folder `practice` has the same
for practice runs (section 2), with numbers of their own. A run is named by its folder as seen
from the results folder: `subject_...` or `practice/subject_...`. A folder whose name ends in
`rehearsal` holds the runs of rehearsals and no others.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import checked_plain, open_plain, read_all, refusal
from scoring.run_info import series_prefix

LARGEST_NUMBER = 999
"""The largest subject and run number: file names have three digits for them."""

NUMBERS_FILE = "run_numbers.jsonl"
"""In the results folder: one line for each run number given out."""

RESULT_FILE = "result.json"

ISSUE_FILE = "result_issue_{}.json"

JOURNAL_FILE = "journal.jsonl"

REPORT_FILE = "report.html"

FRAMES_FOLDER = "frames"
"""The camera pictures of instants that somebody asked for."""

INDEX_PAGE = "index.html"

RESULT_FORMAT: Final = 1

PRACTICE_FOLDER = "practice"

_LARGEST = 16_000_000  # bytes of the numbers file: some 300,000 runs
_TIME_FORMAT = "%Y%m%d_%H%M%S"
_OF_REHEARSALS = "rehearsal"
_IN_PRACTICE = f"{PRACTICE_FOLDER}/"
_FOLDER = re.compile(r"subject_([0-9]{3})_cond_([0-9]{3})_run_([0-9]{3})_([0-9]{8}_[0-9]{6})")


@dataclass(frozen=True, slots=True)
class RunName:
    """Repetition `run` of `subject` in `condition` (1..20). Only `run_id` is unique (section 2)."""

    subject: int
    condition: int
    run: int

    def folder_name(self, start_time: float) -> str:
        """The name of the run's folder, with `start_time` (s since the epoch) in local time."""
        local = datetime.fromtimestamp(start_time, tz=UTC).astimezone()
        series = series_prefix(self.subject, self.condition)
        return f"{series}{self.run:03d}_{local.strftime(_TIME_FORMAT)}"


def holds_rehearsals(root: Path) -> bool:
    """Whether a results folder is for a rehearsal; no other folder is (protocol section 2).

    Raises:
        MadrobError: only the name of a link says so.
    """
    folder = root.resolve()
    holds = folder.name.endswith(_OF_REHEARSALS)
    if root.name.endswith(_OF_REHEARSALS) and not holds:
        raise MadrobError(f"{root}: leads to {folder}, which is no rehearsal's: name that folder")
    return holds


def rehearsal_folder(root: Path) -> Path:
    """The folder for a rehearsal beside another one."""
    return root if holds_rehearsals(root) else root.with_name(f"{root.name}_{_OF_REHEARSALS}")


def series_folder(root: Path, *, practice: bool) -> Path:
    return root / PRACTICE_FOLDER if practice else root


def link_problem(root: Path) -> str | None:
    """Why practice runs cannot be kept there: behind a link nobody would find them."""
    folder = root / PRACTICE_FOLDER
    return f"{folder}: is a link; put a folder in its place" if folder.is_symlink() else None


def results_folder_of(run: Path) -> Path:
    return run.parent.parent if run.parent.name == PRACTICE_FOLDER else run.parent


def lies_in_practice(name: str) -> bool:
    return name.startswith(_IN_PRACTICE)


def parse_folder_name(name: str) -> tuple[RunName, datetime] | None:
    """The run and its local start time; None for any other name."""
    match = _FOLDER.fullmatch(name.removeprefix(_IN_PRACTICE))
    if match is None:
        return None
    subject, condition, run = map(int, match.groups()[:3])
    try:
        started = datetime.fromisoformat(match[4]).astimezone()
    except (ValueError, OverflowError):
        return None
    return RunName(subject, condition, run), started


def named_by_recording(names: Iterable[str]) -> str | None:
    """The run folder's name at recording time, from its files' `names`; None = unknown."""
    stems = (name.removesuffix("_0.mcap") for name in names if name.endswith("_0.mcap"))
    return next((stem for stem in stems if parse_folder_name(stem) is not None), None)


def run_folder_names(root: Path) -> list[str]:
    """Practice included, in no order; links are not followed."""
    names = _folder_names(root)
    if PRACTICE_FOLDER in names:
        names.remove(PRACTICE_FOLDER)
        within = _folder_names(root / PRACTICE_FOLDER)
        names += [f"{_IN_PRACTICE}{name}" for name in within if name != PRACTICE_FOLDER]
    return names


def _folder_names(root: Path) -> list[str]:
    try:
        with os.scandir(root) as entries:
            return [
                item.name
                for item in entries
                if (item.name == PRACTICE_FOLDER or _FOLDER.fullmatch(item.name))
                and item.is_dir(follow_symlinks=False)
            ]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _unusable(root, error) from None


def next_run_number(root: Path, subject: int, condition: int, *, practice: bool = False) -> int:
    place = series_folder(root, practice=practice)
    number = max(_used_numbers(place, subject, condition), default=0) + 1
    if number > LARGEST_NUMBER:
        raise MadrobError(
            f"subject {subject} has used run {LARGEST_NUMBER}, the last one, in condition "
            f"{condition}: choose another results folder"
        )
    return number


def reserve_run_folder(
    root: Path, run: RunName, start_time: float, *, practice: bool = False
) -> Path:
    """Give out the number of `run` for good; returns its folder, which the recorder makes.

    The number must never have been used. `start_time` (s since the epoch) is in the folder's name.
    The results folder is made if need be.
    """
    for name, number in (("subject", run.subject), ("run number", run.run)):
        if not 1 <= number <= LARGEST_NUMBER:
            raise MadrobError(f"{name} {number}: use a number from 1 to {LARGEST_NUMBER}")
    if practice and (problem := link_problem(root)) is not None:
        raise MadrobError(problem)
    place = series_folder(root, practice=practice)
    folder = place / run.folder_name(start_time)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unusable(place, error) from None
    if run.run in _used_numbers(place, run.subject, run.condition) or not _take_number(place, run):
        free = next_run_number(root, run.subject, run.condition, practice=practice)
        raise MadrobError(
            f"run {run.run} of subject {run.subject} in condition {run.condition} exists: "
            f"use run {free}"
        )
    return folder


def give_out_run_number(root: Path, subject: int, condition: int) -> int:
    """Give out an unused run number for good; `root` holds the runs (practice has its own)."""
    while not _take_number(
        root, run := RunName(subject, condition, next_run_number(root, subject, condition))
    ):
        pass  # another program was faster
    return run.run


def _line(run: RunName) -> bytes:
    return msgspec.json.encode(run) + b"\n"


def _used_numbers(root: Path, subject: int, condition: int) -> set[int]:
    series = series_prefix(subject, condition)
    try:
        names = os.listdir(root)  # noqa: PTH208  ten thousand Paths take too long
    except FileNotFoundError:
        return set()
    except OSError as error:
        raise _unusable(root, error) from None
    try:
        given_out = read_all(root / NUMBERS_FILE, _LARGEST) if NUMBERS_FILE in names else b""
    except FileNotFoundError:
        given_out = b""
    except OSError as error:
        raise _no_numbers(root, error) from None
    start = re.escape(_line(RunName(subject, condition, 0)).removesuffix(b"0}\n"))
    lines = re.findall(rb"^" + start + rb"([0-9]{1,3})\}$", given_out, re.MULTILINE)
    digits = slice(len(series), len(series) + 3)
    folders = (name[digits] for name in names if name.startswith(series))
    return {int(line) for line in lines} | {int(n) for n in folders if n.isdecimal()}


def _take_number(root: Path, run: RunName) -> bool:
    """Write a number down for good; returns whether it was unused.

    There is no lock: of two programs that append the same line, the first one has the number.
    """
    line = _line(run)
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        file = checked_plain(os.open(root / NUMBERS_FILE, flags, 0o666))
        try:
            before = os.pread(file, _append(file, line), 0)
        finally:
            os.close(file)
    except OSError as error:
        raise _no_numbers(root, error) from None
    return line not in before.splitlines(keepends=True)


def _append(file: int, line: bytes) -> int:
    """Returns where in the file the line is, once it is on disk."""
    size = os.fstat(file).st_size
    if size and os.pread(file, 1, size - 1) != b"\n":
        line = b"\n" + line  # the last line is torn: it stays by itself
    if os.write(file, line) != len(line):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(file)
    return os.lseek(file, 0, os.SEEK_CUR) - len(line)


def _no_numbers(root: Path, error: OSError) -> MadrobError:
    if error.errno not in (errno.EINVAL, errno.ELOOP, errno.EFBIG):
        return _unusable(root, error)
    return MadrobError(
        f"{root / NUMBERS_FILE}: cannot be used ({refusal(error)}); put a plain file in its place "
        "or choose another results folder"
    )


def _unusable(root: Path, error: OSError) -> MadrobError:
    return MadrobError(
        f"{root}: cannot be used for results ({error.strerror}); choose another results folder"
    )


_REMEDY = "choose another results folder"
_OPEN_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NONBLOCK | os.O_CLOEXEC
_NAMELESS_FILE = os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC
_UNSUPPORTED = (errno.EOPNOTSUPP, errno.EISDIR, errno.ENOENT)
"""Errors of file systems without nameless files: FAT, NFS."""


def recording_problem(root: Path, *, attempt: bool, practice: bool = False) -> str | None:
    """Why no run could be recorded in a results folder; None when one could.

    With `attempt` it also makes a nameless file, which leaves nothing: only that shows a disk that
    turned read-only. A disk that hangs then lets this wait.
    """
    if practice and (problem := link_problem(root)) is not None:
        return problem
    root = series_folder(root, practice=practice)
    place = next((p for p in (root, *root.absolute().parents) if os.path.lexists(p)), root)
    try:
        os.close(os.open(place, _OPEN_FOLDER))
        if not os.access(place, os.W_OK | os.X_OK):
            return f"{place}: nothing can be written there; make it yours, or {_REMEDY}"
        if attempt:
            _make_nameless_file(place)
    except OSError as error:
        return f"{place}: {error.strerror}; {_REMEDY}"
    return None if place != root else _numbers_problem(root / NUMBERS_FILE)


def _make_nameless_file(folder: Path) -> None:
    try:
        os.close(os.open(folder, _NAMELESS_FILE, 0o600))
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise


def _numbers_problem(path: Path) -> str | None:
    try:
        os.close(open_plain(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"{path}: cannot be used ({refusal(error)}); put a plain file in its place"
    if os.access(path, os.W_OK):
        return None
    return f"{path}: cannot be written; make it yours"
