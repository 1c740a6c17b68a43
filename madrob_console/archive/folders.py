"""Runs on disk: folder names, run numbers, paths, duplicates, shards (protocol section 10)."""

from __future__ import annotations

import errno
import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.files import checked_plain, open_plain, read_all, refusal
from scoring.eurobench.run_info import run_prefixes, series_prefix

# A results folder holds one folder a run and `run_numbers.jsonl`, the numbers ever given out: a
# run number is never used again, even when its folder is gone. Its sub-folder `practice` has the
# same for practice runs (section 2), with numbers of their own. A run is named by its folder as
# seen from the results folder: `subject_...` or `practice/subject_...`.


LARGEST_NUMBER = 999
"""Subjects and runs are numbered from 1 to this: file names have three digits for them."""

NUMBERS_FILE = "run_numbers.jsonl"
"""In the results folder: one line for each run number given out."""

RESULT_FILE = "result.json"
"""In a run folder: the whole result."""

ISSUE_FILE = "result_issue_{}.json"
"""In a run folder: the result as it was in an earlier issue, by its number."""

JOURNAL_FILE = "journal.jsonl"
"""In a run folder: every act and every change of state."""

REPORT_FILE = "report.html"
"""In a run folder: the page for the team."""

PICTURES_FOLDER = "pictures"
"""In a run folder: what its cameras saw."""

PICTURES_INDEX = "index.json"
"""In that folder: which picture is of what."""

FRAMES_FOLDER = "frames"
"""In a run folder: what its cameras saw at the instants that somebody asked for."""

INDEX_PAGE = "index.html"
"""Where the pages of a competition begin; a run has one of its own among them."""

RESULT_FORMAT: Final = 1
"""Version of the layout of `result.json`."""

PRACTICE_FOLDER = "practice"
"""In the results folder: the practice runs."""

_LARGEST = 16_000_000  # bytes of the numbers file: some 300,000 runs
_TIME_FORMAT = "%Y%m%d_%H%M%S"
_IN_PRACTICE = f"{PRACTICE_FOLDER}/"
_FOLDER = re.compile(r"subject_([0-9]{3})_cond_([0-9]{3})_run_([0-9]{3})_([0-9]{8}_[0-9]{6})")


@dataclass(frozen=True, slots=True)
class RunName:
    """What its folder is called after: repetition `run` of `subject` in `condition` (1..20).

    Two testbeds may give the same name; the identity of a run is its `run_id` (section 2).
    """

    subject: int
    condition: int
    run: int

    def folder_name(self, start_time: float) -> str:
        """The name of the run's folder, with `start_time` (s since the epoch) in local time."""
        local = datetime.fromtimestamp(start_time, tz=UTC).astimezone()
        series = series_prefix(self.subject, self.condition)
        return f"{series}{self.run:03d}_{local.strftime(_TIME_FORMAT)}"


def series_folder(root: Path, *, practice: bool) -> Path:
    """Where the official or the practice runs of a results folder lie."""
    return root / PRACTICE_FOLDER if practice else root


def link_problem(root: Path) -> str | None:
    """Why practice runs cannot be kept there, in words: behind a link nobody would find them."""
    folder = root / PRACTICE_FOLDER
    return f"{folder}: is a link; put a folder in its place" if folder.is_symlink() else None


def results_folder_of(run: Path) -> Path:
    """The results folder in which a run folder lies."""
    return run.parent.parent if run.parent.name == PRACTICE_FOLDER else run.parent


def lies_in_practice(name: str) -> bool:
    """Whether a run folder of this name lies among the practice runs."""
    return name.startswith(_IN_PRACTICE)


def parse_folder_name(name: str) -> tuple[RunName, datetime] | None:
    """Which run a folder is for, and its local start time; None for any other name."""
    match = _FOLDER.fullmatch(name.removeprefix(_IN_PRACTICE))
    if match is None:
        return None
    subject, condition, run = map(int, match.groups()[:3])
    try:
        started = datetime.strptime(match[4], _TIME_FORMAT).astimezone()
    except (ValueError, OverflowError):
        return None
    return RunName(subject, condition, run), started


def named_by_recording(names: Iterable[str]) -> str | None:
    """What a run folder was called when its recording was made, by what lies in it; None = unknown.

    Args:
        names: of the files in it.
    """
    stems = (name.removesuffix("_0.mcap") for name in names if name.endswith("_0.mcap"))
    return next((stem for stem in stems if parse_folder_name(stem) is not None), None)


def pictures_in(folder: str) -> int:
    """How many pictures there are of what a run's cameras saw; 0 where that cannot be told."""
    place = f"{folder}/{PICTURES_FOLDER}"
    try:
        names = os.listdir(place)  # noqa: PTH208  as below
    except OSError:
        return 0
    return sum(name.endswith(".jpg") for name in names) if PICTURES_INDEX in names else 0


def run_folder_names(root: Path) -> list[str]:
    """The names of the run folders in a results folder, those of practice too, in no order.

    Links are not followed: a run lies in its results folder.

    Raises:
        MadrobError: the folder exists but cannot be read.
    """
    names = _folder_names(root)
    if PRACTICE_FOLDER in names:
        names.remove(PRACTICE_FOLDER)
        within = _folder_names(root / PRACTICE_FOLDER)
        names += [f"{_IN_PRACTICE}{name}" for name in within if name != PRACTICE_FOLDER]
    return names


def _folder_names(root: Path) -> list[str]:
    """The names of the run folders that lie there themselves, and of the one for practice."""
    try:
        with os.scandir(root) as found:
            return [
                item.name
                for item in found
                if (item.name == PRACTICE_FOLDER or _FOLDER.fullmatch(item.name))
                and item.is_dir(follow_symlinks=False)
            ]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _unusable(root, error) from None


def next_run_number(root: Path, subject: int, condition: int, *, practice: bool = False) -> int:
    """One more than the largest run number ever used for this subject and condition.

    Args:
        root: the results folder.
        subject: the robot's number.
        condition: its number.
        practice: of the practice runs; else of the official ones.

    Raises:
        MadrobError: all numbers are used, or the results folder cannot be read.
    """
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
    """Give out a run number for good; returns the run's folder, which the recorder makes.

    Args:
        root: the results folder; made if there is none.
        run: the run; its number must never have been used for its subject and condition.
        start_time: s since the epoch; stands in the folder's name.
        practice: it is a practice run.

    Raises:
        MadrobError: a number is out of range or used, or the disk refuses.
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
    if run.run in _used_numbers(place, run.subject, run.condition) or not _given_out(place, run):
        free = next_run_number(root, run.subject, run.condition, practice=practice)
        raise MadrobError(
            f"run {run.run} of subject {run.subject} in condition {run.condition} exists: "
            f"use run {free}"
        )
    return folder


def give_out_run_number(root: Path, subject: int, condition: int) -> int:
    """A run number that was never used for this subject and condition, given out for good.

    Args:
        root: holds the runs themselves: the results folder, or that of its practice runs.
        subject: the robot's number.
        condition: its number.

    Raises:
        MadrobError: all numbers are used, or the folder cannot be read or written.
    """
    while not _given_out(
        root, run := RunName(subject, condition, next_run_number(root, subject, condition))
    ):
        pass  # another program was faster
    return run.run


def _line(run: RunName) -> bytes:
    return msgspec.json.encode(run) + b"\n"


def _used_numbers(root: Path, subject: int, condition: int) -> set[int]:
    """Every run number of a subject and condition, from the folders and from the numbers file."""
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


def _given_out(root: Path, run: RunName) -> bool:
    """Write a number down for good, and tell whether nobody did so before.

    Nobody is waited for: of two programs that append the same line at once the first one has it.

    Raises:
        MadrobError: the disk refuses.
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
    """Append a line, on disk on return; returns where in the file it stands."""
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


# Whether a run could be recorded in a results folder.


_REMEDY = "choose another results folder"
_OPEN_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NONBLOCK | os.O_CLOEXEC
_NAMELESS_FILE = os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC
_UNSUPPORTED = (errno.EOPNOTSUPP, errno.EISDIR, errno.ENOENT)
"""Of file systems that know no file without a name: FAT, NFS."""


def recording_problem(root: Path, *, attempt: bool, practice: bool = False) -> str | None:
    """Why no run could be recorded in a results folder, in words; None when one could.

    Args:
        root: the results folder; one that is not there yet will be made.
        attempt: make a file without a name there, too: a disk that turned read-only shows itself
            only then, and one that hangs lets this wait. It leaves nothing.
        practice: a practice run.
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
    """Why no run number can be given out, in words."""
    try:
        os.close(open_plain(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"{path}: cannot be used ({refusal(error)}); put a plain file in its place"
    if os.access(path, os.W_OK):
        return None
    return f"{path}: cannot be written; make it yours"


# The runs behind the paths that somebody names: bags, run folders, published files.


@dataclass(frozen=True, slots=True)
class RunPath:
    """One run on disk.

    Attributes:
        path: its bag, or the folder that holds its files.
        prefix: how the names of its published files begin; empty for a recorded run.
    """

    path: Path
    prefix: str = ""

    @property
    def name(self) -> str:
        """What it is called, its folder included; the runs of one folder differ in it."""
        return str(self.path / self.prefix)

    @property
    def own_name(self) -> str:
        """How files made of it are called: like its folder, or its bag where that is a file."""
        whole = Path(os.path.abspath(self.path))  # noqa: PTH100  `..` has a name, too
        return self.prefix or (whole.name if whole.is_dir() else whole.stem)


def runs_at(path: Path) -> list[RunPath]:
    """The runs at a path, at any depth, in the order of their names.

    Run folders, also those that somebody renamed, and folders of published files; else the path
    itself, which may be a bag, or nothing that can be read: reading it says so. In a folder with a
    bag, the bag is the run. Links and hidden folders in it are not followed.
    """
    return list(_runs_below(path)) or [RunPath(path)]


def all_runs_at(paths: Iterable[Path]) -> list[RunPath]:
    """The runs at some paths, in their order; what lies at two of them once."""
    found: dict[tuple[str, str], RunPath] = {}
    for path in paths:
        for run in runs_at(path):
            found.setdefault((os.path.realpath(run.path), run.prefix), run)
    return list(found.values())


def _runs_below(top: Path) -> Iterator[RunPath]:
    folders = [top]
    while folders:
        path = folders.pop()
        try:
            names = os.listdir(path)  # noqa: PTH208  ten thousand Paths take too long
        except NotADirectoryError:
            continue
        except OSError:  # reading it says why; the path that was named is looked at by `runs_at`
            if path is not top:
                yield RunPath(path)
            continue
        if _is_bag(names):
            yield RunPath(path)
        elif prefixes := run_prefixes(names):
            yield from (RunPath(path, prefix) for prefix in prefixes)
        elif path is not top and parse_folder_name(path.name) is not None:
            yield RunPath(path)  # its recording is missing
        else:
            below = (path / name for name in sorted(names, reverse=True) if name[0] != ".")
            folders += [folder for folder in below if not folder.is_symlink()]


def _is_bag(names: Iterable[str]) -> bool:
    return any(name == "metadata.yaml" or name.endswith((".mcap", ".db3")) for name in names)


# Shares of many runs: each shard has its own, and all shards together have every run once.


_FORM = re.compile(r"([0-9]{1,7})/([0-9]{1,7})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several shares of the runs.

    Which share a run is in follows from its own name alone (that of its folder, bag or files):
    machines that see it under other paths, and tasks that start hours apart while runs come in,
    agree on it. All copies of a run are in one share, and shares are about equally large.

    Attributes:
        number: which, from 1.
        count: how many there are.
    """

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def __contains__(self, run: RunPath) -> bool:
        digest = hashlib.sha256(run.own_name.encode(errors="surrogateescape")).digest()
        return int.from_bytes(digest[:8]) % self.count == self.number - 1

    @property
    def folder_name(self) -> str:
        """How a folder of its files is called."""
        return f"shard_{self.number}_of_{self.count}"

    @classmethod
    def parse(cls, text: str) -> Shard:
        """A shard from `2/8`.

        Raises:
            MadrobError: it is none.
        """
        match = _FORM.fullmatch(text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise MadrobError(f"'{text}': give i/n, from 1/n to n/n")
        return cls(int(match[1]), int(match[2]))


def shared_out(runs: Iterable[RunPath], shard: Shard | None) -> list[RunPath]:
    """The runs of a share, in their order; None = all of them."""
    return [run for run in runs if shard is None or run in shard]


# Runs that are there several times: which place of each counts (protocol section 2).


@dataclass(frozen=True, slots=True)
class RunPlace:
    """Where a run with a usable result lies.

    Attributes:
        name: of the place, unlike any other.
        run_id: of the run; empty = not known, so that it is like no other.
        practice: whether it counts for nothing there.
        issue: of the result there.
    """

    name: str
    run_id: str
    practice: bool
    issue: int


def places_that_count(places: Iterable[RunPlace]) -> dict[str, str]:
    """By `run_id`, the name of the place that counts: official, of the latest issue, the first."""
    kept: dict[str, RunPlace] = {}
    for place in places:
        other = kept.get(place.run_id)
        if place.run_id and (other is None or _rank(place) > _rank(other)):
            kept[place.run_id] = place
    return {run_id: place.name for run_id, place in kept.items()}


def _rank(place: RunPlace) -> tuple[bool, int]:
    return not place.practice, place.issue


def why_twin(place: str, counting: str) -> str:
    """Why the run at a place does not count although it is valid, in words."""
    return f"{place} is the same run as {counting}, which counts"
