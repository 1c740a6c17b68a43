"""A stored result compared with what its recording gives today (protocol section 11)."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.file_digests import digests_of_torn
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.result_files import document_of
from madrob_console.archive.result_reader import UnusableResultError, read_whole_result
from madrob_console.archive.run_journal import UnusableJournalError, read_run_journal
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import Scored, lines_lost, score_recording
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, utc_text
from madrob_console.referee.rebuild import Change
from recorder.bag import METADATA_FILE
from scoring.indicator_table import IndicatorName
from scoring.result import LIBRARY_NAMES, Libraries, libraries_here

CLOSEST = 1e-9
"""Relative; the rounding differences of libraries stay far below it."""


class Grade(StrEnum):
    """How a stored result compares with a fresh one of its recording."""

    SAME = "same digits"
    CLOSE = "equal to 1e-9"
    DIFFERS = "differs"

    @classmethod
    def of(cls, stored: object, now: object) -> Grade:
        """Grade one computed value: only numbers may differ, and only in their last digits."""
        if stored == now:
            return cls.SAME
        numbers = isinstance(stored, float) and isinstance(now, float)
        if numbers and math.isclose(stored, now, rel_tol=CLOSEST):  # type: ignore[arg-type]
            return cls.CLOSE
        return cls.DIFFERS

    @classmethod
    def worst(cls, grades: Iterable[Grade]) -> Grade:
        return max(grades, key=list(cls).index, default=cls.SAME)


def library_words(stored: Libraries, now: Libraries) -> str:
    if stored == now:
        return f"the same libraries ({now.words}): another processor, or a changed file"
    changed = (
        f"{name} {getattr(stored, key)} stored, {getattr(now, key)} now"
        for key, name in LIBRARY_NAMES.items()
        if getattr(stored, key) != getattr(now, key)
    )
    return f"libraries differ: {'; '.join(changed)}"


_NOT_COMPARED = {"format", "software", "libraries", "remark", "files_left_out", "flags"}
"""Keys about the program that wrote the result, in its own words, or about work done beside it."""

_COMPUTED = ("indicators.", "quality.")
"""Where libraries decide the last digits. Not for times: 1e-9 of the epoch is over a second."""

_VALUE = re.compile(r"indicators\.(\w+)\.value")
_UNCERTAINTY = re.compile(r"indicators\.\w+\.uncertainty\b")
_DOUBTS = re.compile(r"indicators\.\w+\.doubts\b")

_LONGEST = 80


@dataclass(frozen=True, slots=True)
class Difference:
    """One JSON value that differs from the stored one, in the place `what`: `events[3].time`."""

    what: str
    stored: Any
    recomputed: Any
    grade: Grade = Grade.DIFFERS

    @property
    def words(self) -> str:
        return f"{self.what}: stored {_short(self.stored)}, now {_short(self.recomputed)}"

    @property
    def indicator(self) -> IndicatorName | None:
        """Whose value it is; None for anything else."""
        match = _VALUE.fullmatch(self.what)
        return next((name for name in IndicatorName if match and name == match[1]), None)


@dataclass(frozen=True, slots=True)
class CheckedRun:
    """The findings of a check: every value that differs from the stored one in any digit.

    The grade does not depend on `uncertainties`.
    """

    differences: tuple[Difference, ...]
    uncertainties: tuple[Difference, ...]
    stored_by: Libraries
    libraries: Libraries

    @property
    def grade(self) -> Grade:
        return Grade.worst(difference.grade for difference in self.differences)

    def differences_of(self, grade: Grade) -> tuple[Difference, ...]:
        return tuple(difference for difference in self.differences if difference.grade is grade)

    @property
    def of_the_rest(self) -> Grade:
        return Grade.worst(each.grade for each in self.differences if not _DOUBTS.match(each.what))

    @property
    def values_hold(self) -> bool:
        return self.grade is Grade.DIFFERS and self.of_the_rest is not Grade.DIFFERS

    @property
    def words(self) -> str:
        match grade := self.grade:
            case Grade.SAME:
                return str(grade)
            case Grade.CLOSE:
                return f"{grade} ({library_words(self.stored_by, self.libraries)})"
            case Grade.DIFFERS:
                words = f"{grade} in {len(self.differences_of(grade))}"
                if not self.values_hold:
                    return words
                return f"{words}, only doubts; the values: {self.of_the_rest}"

    @property
    def uncertainty_words(self) -> str:
        """Which uncertainties differ, on one line; empty where none does."""
        last = {each.what.split(".")[1]: each for each in self.uncertainties}  # the expanded one
        changes = (
            f"{name} {_short(each.recomputed)} was {_short(each.stored)}"
            for name, each in last.items()
        )
        return f"uncertainties differ in {len(last)}: {', '.join(changes)}" if last else ""

    def content(self) -> dict[str, Any]:
        def values(differences: Iterable[Difference]) -> list[dict[str, object]]:
            return [
                {"what": each.what, "stored": each.stored, "recomputed": each.recomputed}
                for each in differences
            ]

        return {
            "grade": self.grade,
            "grade_but_for_doubts": self.of_the_rest,
            "differences": values(self.differences_of(Grade.DIFFERS)),
            "last_digits": values(self.differences_of(Grade.CLOSE)),
            "uncertainties": values(self.uncertainties),
            "libraries": {"stored": self.stored_by, "now": self.libraries},
        }


def check_run(run: RunPath) -> CheckedRun:
    """Score a run again by its own ruleset and decisions, and compare with its `result.json`.

    The engine's own remarks on the data quality (messages lost on their way) may be stored beside
    those of the recording.
    """
    folder = run.path
    run.demand_recording()
    try:
        stored = read_whole_result(str(folder))
    except FileNotFoundError:
        stored = None
    except UnusableResultError as error:
        raise MadrobError(f"{folder}: {error}") from None
    if stored is None:
        raise MadrobError(
            f"{folder}: has no {RESULT_FILE} to check: name a run folder with a result"
        )
    scored = score_recording(folder)[0]
    checked = compare(stored, scored, folder)
    lost_lines = tuple(_journal_differences(folder))
    lacks = scored.run.unrecorded
    if lacks and not lost_lines and checked.grade is Grade.DIFFERS:
        words = f"cannot be checked: lacks {counted(lacks, 'message')}"
        raise MadrobError(f"{folder}: {words}; its result stays as it was issued")
    return dataclasses.replace(checked, differences=(*lost_lines, *checked.differences))


def is_withdrawn(folder: Path) -> bool:
    """Whether the engine withdrew the start of a run: there is nothing to check."""
    if (folder / RESULT_FILE).exists():
        return False
    try:
        journal = read_run_journal(folder)
    except (OSError, UnusableJournalError):
        return False
    return bool(journal.never_ran) and journal.entries[-1].what == Change.WITHDRAWN


def compare(stored: dict[str, Any], scored: Scored, folder: Path) -> CheckedRun:
    """Compare a whole `result.json` with a fresh result; removes `files` from `stored`."""
    # cut off after its result and before the journal's line of it: this is the first issue
    first = dataclasses.replace(scored.run, issue=max(1, scored.run.issue))
    scored = dataclasses.replace(scored, run=first)
    recomputed = msgspec.json.encode(document_of(scored, folder, {}))
    differences = tuple(_compare(stored, msgspec.json.decode(recomputed), folder))
    return CheckedRun(
        differences=tuple(each for each in differences if not _UNCERTAINTY.match(each.what)),
        uncertainties=tuple(each for each in differences if _UNCERTAINTY.match(each.what)),
        stored_by=msgspec.convert(stored["libraries"], Libraries),
        libraries=libraries_here(),
    )


def _compare(
    stored: dict[str, Any], recomputed: dict[str, Any], folder: Path
) -> Iterator[Difference]:
    files, stored_files = recomputed.pop("files"), stored.pop("files", None)
    remarks = recomputed["quality"].pop("remarks")
    del recomputed["quality"]["lost"]  # only the engine knew
    if _has_recording(stored_files, files, folder):
        # The bag was torn or unfinished before the result was written.
        remarks = [remark for remark in remarks if not remark.startswith(folder.name)]
    compared = {key: value for key, value in recomputed.items() if key not in _NOT_COMPARED}
    yield from differences_between("", stored, compared)
    yield from _remark_differences(_remarks(stored), remarks)
    yield from _file_differences(stored_files, files, folder)


def differences_between(where: str, stored: object, recomputed: object) -> Iterator[Difference]:
    match stored, recomputed:
        case dict(), dict():
            for key, value in recomputed.items():
                if key in stored:  # a later version may add some
                    yield from differences_between(f"{where}.{key}".lstrip("."), stored[key], value)
                elif where == "indicators":
                    yield Difference(f"indicators.{key}.value", None, value["value"])
        case list(), list() if len(stored) == len(recomputed):
            for index, pair in enumerate(zip(stored, recomputed, strict=True)):
                yield from differences_between(f"{where}[{index}]", *pair)
        case list(), list():
            yield Difference(where, f"{len(stored)} entries", f"{len(recomputed)} entries")
        case _ if stored != recomputed:
            computed = where.startswith(_COMPUTED)
            grade = Grade.of(stored, recomputed) if computed else Grade.DIFFERS
            yield Difference(where, stored, recomputed, grade)


def _journal_differences(folder: Path) -> Iterator[Difference]:
    for line in lines_lost(folder):
        yield Difference(JOURNAL_FILE, f"'{line.what}' of {utc_text(line.time)}", "missing")


def _remarks(stored: Mapping[str, Any]) -> list[Any]:
    quality = stored.get("quality")
    remarks = quality.get("remarks") if isinstance(quality, dict) else None
    return remarks if isinstance(remarks, list) else []


def _remark_differences(stored: list[Any], recomputed: list[str]) -> Iterator[Difference]:
    stored_remarks = {_without_place(str(remark)) for remark in stored}
    for remark in recomputed:
        if _without_place(remark) not in stored_remarks:
            yield Difference("quality.remarks", None, remark)


def _without_place(remark: str) -> str:
    """A remark on a torn bag begins with the folder's name, which may be changed."""
    return remark.rpartition("/")[2]


def _has_recording(stored: object, digests: Mapping[str, Any], folder: Path) -> bool:
    """Whether the recording is the one of the result, or `recover` has made it of that one."""
    if not isinstance(stored, dict):
        return False
    names = [name for name in stored if name.endswith(".mcap")]
    changed = [name for name in names if not _is_same(name, stored[name], digests, folder)]
    return bool(names) and not changed


def _is_same(name: str, stored: object, digests: Mapping[str, Any], folder: Path) -> bool:
    if stored == digests.get(name):
        return True
    torn = digests_of_torn(folder / Path(name).name)
    return name in digests and isinstance(stored, dict) and stored.get("sha256") in torn


def _file_differences(
    stored: object, digests: Mapping[str, Any], folder: Path
) -> Iterator[Difference]:
    if not isinstance(stored, dict):
        yield Difference("files", stored, "files with their digests")
        return
    for name, digest in stored.items():
        if name == METADATA_FILE or _is_same(name, digest, digests, folder):
            continue  # `recover` writes these anew, of what is in the recording
        if name in digests:
            yield from differences_between(f"files.{name}", digest, digests[name])
        else:
            there = (folder / Path(name).name).exists()
            yield Difference(f"files.{name}", digest, "unreadable" if there else "missing")


def _short(value: object) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
