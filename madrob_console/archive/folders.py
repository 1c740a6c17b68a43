"""Runs on disk: folder names, run numbers, safe writing (protocol section 10).

A results folder holds one folder a run and `run_numbers.jsonl`, the numbers ever given out: a
run number is never used again, even when its folder is gone.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from madrob_console.errors import MadrobError
from scoring.eurobench.run_info import series_prefix

LARGEST_NUMBER = 999
"""Subjects and runs are numbered from 1 to this: file names have three digits for them."""

NUMBERS_FILE = "run_numbers.jsonl"
"""In the results folder: one line for each run number given out."""

RESULT_FILE = "result.json"
"""In a run folder: the whole result."""

JOURNAL_FILE = "journal.jsonl"
"""In a run folder: every act and every change of state."""

REPORT_FILE = "report.html"
"""In a run folder: the page for the team."""

RESULT_FORMAT: Final = 1
"""Version of the layout of `result.json`."""

_TIME_FORMAT = "%Y%m%d_%H%M%S"
_FOLDER = re.compile(r"subject_([0-9]{3})_cond_([0-9]{3})_run_([0-9]{3})_([0-9]{8}_[0-9]{6})")


@dataclass(frozen=True, slots=True)
class RunId:
    """Which run it is: the repetition `run` of `subject` in `condition` (its number, 1..20)."""

    subject: int
    condition: int
    run: int

    def folder_name(self, start_time: float) -> str:
        """The name of the run's folder, with `start_time` (s since the epoch) in local time."""
        local = datetime.fromtimestamp(start_time, tz=UTC).astimezone()
        series = series_prefix(self.subject, self.condition)
        return f"{series}{self.run:03d}_{local.strftime(_TIME_FORMAT)}"


def parse_folder_name(name: str) -> tuple[RunId, datetime] | None:
    """Which run a folder is for, and its local start time; None for any other name."""
    match = _FOLDER.fullmatch(name)
    if match is None:
        return None
    subject, condition, run = map(int, match.groups()[:3])
    try:
        started = datetime.strptime(match[4], _TIME_FORMAT).astimezone()
    except (ValueError, OverflowError):
        return None
    return RunId(subject, condition, run), started


def run_folder_names(root: Path) -> list[str]:
    """The names of the run folders in a results folder, in no order.

    Links are not followed: a run lies in its results folder.

    Raises:
        MadrobError: the folder exists but cannot be read.
    """
    try:
        with os.scandir(root) as found:
            return [
                item.name
                for item in found
                if _FOLDER.fullmatch(item.name) and item.is_dir(follow_symlinks=False)
            ]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _unusable(root, error) from None


def next_run_number(root: Path, subject: int, condition: int) -> int:
    """One more than the largest run number ever used for this subject and condition.

    Raises:
        MadrobError: all numbers are used, or the results folder cannot be read.
    """
    number = max(_used_numbers(root, subject, condition), default=0) + 1
    if number > LARGEST_NUMBER:
        raise MadrobError(
            f"subject {subject} has used run {LARGEST_NUMBER}, the last one, in condition "
            f"{condition}: choose another results folder"
        )
    return number


def reserve_run_folder(root: Path, run: RunId, start_time: float) -> Path:
    """Give out a run number for good; returns the run's folder, which the recorder makes.

    Args:
        root: the results folder; made if there is none.
        run: the run; its number must never have been used for its subject and condition.
        start_time: s since the epoch; stands in the folder's name.

    Raises:
        MadrobError: a number is out of range or used, or the disk refuses.
    """
    for name, number in (("subject", run.subject), ("run number", run.run)):
        if not 1 <= number <= LARGEST_NUMBER:
            raise MadrobError(f"{name} {number}: use a number from 1 to {LARGEST_NUMBER}")
    folder = root / run.folder_name(start_time)
    try:
        root.mkdir(parents=True, exist_ok=True)
        with _numbers_locked(root) as numbers:
            if run.run in _used_numbers(root, run.subject, run.condition):
                raise MadrobError(
                    f"run {run.run} of subject {run.subject} in condition {run.condition} exists: "
                    f"use run {next_run_number(root, run.subject, run.condition)}"
                )
            _append_line(numbers, _line(run))
    except OSError as error:
        raise _unusable(root, error) from None
    return folder


def _line(run: RunId) -> bytes:
    return msgspec.json.encode(run) + b"\n"


def _used_numbers(root: Path, subject: int, condition: int) -> set[int]:
    """Every run number of a subject and condition, from the folders and from the numbers file."""
    series = series_prefix(subject, condition)
    try:
        names = os.listdir(root)  # noqa: PTH208  ten thousand Paths take too long
        given_out = (root / NUMBERS_FILE).read_bytes() if NUMBERS_FILE in names else b""
    except FileNotFoundError:
        return set()
    except OSError as error:
        raise _unusable(root, error) from None
    start = re.escape(_line(RunId(subject, condition, 0)).removesuffix(b"0}\n"))
    lines = re.findall(rb"^" + start + rb"([0-9]{1,3})\}$", given_out, re.MULTILINE)
    digits = slice(len(series), len(series) + 3)
    folders = (name[digits] for name in names if name.startswith(series))
    return {int(line) for line in lines} | {int(n) for n in folders if n.isdecimal()}


@contextmanager
def _numbers_locked(root: Path) -> Iterator[int]:
    """The numbers file, open for appending by nobody else."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    numbers = os.open(root / NUMBERS_FILE, flags, 0o666)
    try:
        fcntl.flock(numbers, fcntl.LOCK_EX)
        yield numbers
    finally:
        os.close(numbers)


def _append_line(file: int, line: bytes) -> None:
    size = os.fstat(file).st_size
    if size and os.pread(file, 1, size - 1) != b"\n":
        line = b"\n" + line  # the last line is torn: it stays by itself
    if os.write(file, line) != len(line):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(file)


def _unusable(root: Path, error: OSError) -> MadrobError:
    return MadrobError(
        f"{root}: cannot be used for results ({error.strerror}); choose another results folder"
    )
