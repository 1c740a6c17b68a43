"""A stored result against what its recording gives today (protocol section 11)."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.digests import lists_evidence
from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.grades import Grade, libraries_told
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_reader import UnusableResultError, read_whole_result
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import Scored, score_recording
from madrob_console.errors import MadrobError
from recorder.bag import METADATA_FILE
from scoring.libraries import Libraries, libraries_here

_NOT_COMPARED = {
    *("format", "software", "libraries", "remark", "files_left_out", "flags"),
    "removed_evidence",
}
"""Keys that tell of the program that wrote the result, in its words what others tell, or of what
is done beside a result that is written."""

_COMPUTED = ("indicators.", "quality.")
"""Where libraries decide the last digits. Times are stamps: of the epoch 1e-9 is over a second."""

_UNCERTAINTY = re.compile(r"indicators\.\w+\.uncertainty\b")
_DOUBTS = re.compile(r"indicators\.\w+\.doubts\b")
"""What says how far a value can be trusted; no value hangs on it."""

_LONGEST = 80


@dataclass(frozen=True, slots=True)
class Difference:
    """One value that is not what was stored.

    Attributes:
        what: where it stands in `result.json`, as in `events[3].time`.
        stored: what the file says.
        recomputed: what the recording gives, or what there is today.
        grade: how far apart they are.
    """

    what: str
    stored: object
    recomputed: object
    grade: Grade = Grade.DIFFERS

    @property
    def words(self) -> str:
        """All of it on one line."""
        return f"{self.what}: stored {_short(self.stored)}, now {_short(self.recomputed)}"


@dataclass(frozen=True, slots=True)
class CheckedRun:
    """What the check of a run found.

    Attributes:
        found: every value that is not what was stored to the last digit.
        uncertainties: those that are not what was stored; no grade hangs on them.
        stored_by: what computed the stored result; None = it does not say.
        libraries: what computes now.
    """

    found: tuple[Difference, ...]
    uncertainties: tuple[Difference, ...]
    stored_by: Libraries | None
    libraries: Libraries

    @property
    def grade(self) -> Grade:
        """The worst of what was found."""
        return Grade.worst(difference.grade for difference in self.found)

    def of(self, grade: Grade) -> tuple[Difference, ...]:
        """What was found of one grade."""
        return tuple(difference for difference in self.found if difference.grade is grade)

    @property
    def of_the_rest(self) -> Grade:
        """The worst of what was found but for doubts: of what was measured."""
        return Grade.worst(each.grade for each in self.found if not _DOUBTS.match(each.what))

    @property
    def values_hold(self) -> bool:
        """Whether it differs in doubts only."""
        return self.grade is Grade.DIFFERS and self.of_the_rest is not Grade.DIFFERS

    @property
    def words(self) -> str:
        """The verdict, on one line."""
        match grade := self.grade:
            case Grade.SAME:
                return str(grade)
            case Grade.CLOSE:
                return f"{grade} ({libraries_told(self.stored_by, self.libraries)})"
            case Grade.DIFFERS:
                told = f"{grade} in {len(self.of(grade))}"
                if not self.values_hold:
                    return told
                return f"{told}, only doubts; the values: {self.of_the_rest}"

    @property
    def uncertainty_words(self) -> str:
        """Which uncertainties are other ones, on one line; empty where none is."""
        last = {each.what.split(".")[1]: each for each in self.uncertainties}  # the expanded one
        told = (
            f"{name} {_short(each.recomputed)} was {_short(each.stored)}"
            for name, each in last.items()
        )
        return f"uncertainties differ in {len(last)}: {', '.join(told)}" if last else ""

    def content(self) -> dict[str, Any]:
        """What was found, for programs."""

        def values(found: Iterable[Difference]) -> list[dict[str, object]]:
            return [
                {"what": each.what, "stored": each.stored, "recomputed": each.recomputed}
                for each in found
            ]

        return {
            "grade": self.grade,
            "grade_but_for_doubts": self.of_the_rest,
            "differences": values(self.of(Grade.DIFFERS)),
            "last_digits": values(self.of(Grade.CLOSE)),
            "uncertainties": values(self.uncertainties),
            "libraries": {"stored": self.stored_by, "now": self.libraries},
        }


def check_run(run: RunPath) -> CheckedRun:
    """Score a run again by its own ruleset and decisions, and compare with its `result.json`.

    What an older version of the program did not store is not compared. Remarks on the data
    quality that only the engine could make (messages lost on their way) may be stored beside
    those that the recording gives.

    Args:
        run: a run folder.

    Raises:
        MadrobError: there is no usable result, or the run cannot be scored.
    """
    folder = run.path
    if run.prefix:
        raise MadrobError(f"{run.name}: holds no recording: put the bag back beside the results")
    try:
        stored = read_whole_result(str(folder)) if folder.is_dir() else None
    except FileNotFoundError:
        stored = None
    except UnusableResultError as error:
        raise MadrobError(f"{folder}: {error}") from None
    if stored is None:
        raise MadrobError(
            f"{folder}: has no {RESULT_FILE} to check: name a run folder with a result"
        )
    return compare(stored, score_recording(folder)[0], folder)


def compare(stored: dict[str, Any], scored: Scored, folder: Path) -> CheckedRun:
    """What a stored result says against a fresh one of the same run.

    Args:
        stored: all of its `result.json`; its files are taken out.
        scored: the run, as it is scored now.
        folder: of the run.
    """
    # cut off after its result and before the journal's line of it: this is the first issue
    first = dataclasses.replace(scored.run, issue=max(1, scored.run.issue))
    scored = dataclasses.replace(scored, run=first)
    recomputed = msgspec.json.encode(ResultDocument.of(scored, folder, {}))
    found = tuple(_compare(stored, msgspec.json.decode(recomputed), folder))
    return CheckedRun(
        found=tuple(each for each in found if not _UNCERTAINTY.match(each.what)),
        uncertainties=tuple(each for each in found if _UNCERTAINTY.match(each.what)),
        stored_by=msgspec.convert(stored.get("libraries"), Libraries | None),
        libraries=libraries_here(),
    )


def _compare(
    stored: dict[str, Any], recomputed: dict[str, Any], folder: Path
) -> Iterator[Difference]:
    files, stored_files = recomputed.pop("files"), stored.pop("files", None)
    remarks = recomputed["quality"].pop("remarks")
    kept = {key: value for key, value in recomputed.items() if key not in _NOT_COMPARED}
    yield from _differences("", stored, kept)
    yield from _remark_differences(_remarks(stored), remarks)
    yield from _file_differences(stored_files, files, folder)


def _differences(where: str, stored: object, recomputed: object) -> Iterator[Difference]:
    match stored, recomputed:
        case dict(), dict():
            for key, value in recomputed.items():
                if key in stored:
                    yield from _differences(f"{where}.{key}".lstrip("."), stored[key], value)
        case list(), list() if len(stored) == len(recomputed):
            for index, pair in enumerate(zip(stored, recomputed, strict=True)):
                yield from _differences(f"{where}[{index}]", *pair)
        case list(), list():
            yield Difference(where, f"{len(stored)} entries", f"{len(recomputed)} entries")
        case _ if stored != recomputed:
            computed = where.startswith(_COMPUTED)
            grade = Grade.of(stored, recomputed) if computed else Grade.DIFFERS
            yield Difference(where, stored, recomputed, grade)


def _remarks(stored: Mapping[str, Any]) -> list[Any]:
    quality = stored.get("quality")
    remarks = quality.get("remarks") if isinstance(quality, dict) else None
    return remarks if isinstance(remarks, list) else []


def _remark_differences(stored: list[Any], recomputed: list[str]) -> Iterator[Difference]:
    known = {_without_place(str(remark)) for remark in stored}
    for remark in recomputed:
        if _without_place(remark) not in known:
            yield Difference("quality.remarks", None, remark)


def _without_place(remark: str) -> str:
    """A remark on a torn bag begins with a path, and results folders are moved."""
    return remark.rpartition("/")[2]


def _file_differences(
    stored: object, found: Mapping[str, Any], folder: Path
) -> Iterator[Difference]:
    if stored is None:  # an older version: it wrote no digests
        return
    if not isinstance(stored, dict):
        yield Difference("files", stored, "files with their digests")
        return
    for name, digest in stored.items():
        if name == METADATA_FILE and lists_evidence(folder):
            continue
        if name in found:
            yield from _differences(f"files.{name}", digest, found[name])
        else:
            there = (folder / Path(name).name).exists()
            yield Difference(f"files.{name}", digest, "unreadable" if there else "missing")


def _short(value: object) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
