"""Recordings with known answers: does this installation score right?

The recordings, in one archive, and what each must score to lie beside this module. Reading,
decoding, detecting and scoring are those of every run: nothing here knows a rule.
"""

from __future__ import annotations

import tarfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from lzma import LZMAError
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.archive.scored import score_recording
from madrob_console.cli.finding import Finding, Severity
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import read_all
from madrob_console.common.stored_json import decode
from madrob_console.common.version import DISTRIBUTION
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Outcome
from scoring.result import Indicator, Result, libraries_here

FOLDER = Path(__file__).parent / "references"

EXPECTED_FILE = "expected.json"

ARCHIVE = "recordings.tar.xz"
"""All recordings together: they are alike, so that this takes a tenth of the room."""

_LARGEST = 4_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """What one value must be: in an interval, or missing for a reason. Else ValueError.

    Attributes:
        lowest, highest: a right score lies between them, both included; null where there is none.
        truth: what happened, before sensors and filters; null where no number says it.
        missing: why there is no value, in words; null where there is one.
        why: how this follows.
    """

    lowest: float | None = None
    highest: float | None = None
    truth: float | None = None
    missing: str | None = None
    why: str

    def __post_init__(self) -> None:
        if {self.lowest is None, self.highest is None} != {self.missing is not None}:
            raise ValueError("give lowest and highest, or why there is no value")

    def problem(self, value: float | None, reason: str | None) -> str | None:
        """The error of a value, or of the reason why there is none; None = right."""
        if self.missing is not None:
            wanted = f"no value ({self.missing})"
            right = value is None and reason == self.missing
        else:
            assert self.lowest is not None
            assert self.highest is not None
            ends = dict.fromkeys(f"{end:.9g}" for end in (self.lowest, self.highest))
            wanted = " to ".join(ends)
            right = value is not None and self.lowest <= value <= self.highest
        if right:
            return None
        actual = f"no value ({reason})" if value is None else f"{value:.9g}"
        return f"{actual}, expected {wanted}"


@dataclass(frozen=True, slots=True)
class Reference:
    """A recording and what it must score to.

    Attributes:
        recording: file name.
        about: what was recorded, in words.
        steps: by number: when each was done, s since the start. They are the same in all rulesets.
        indicators: of each ruleset for which they are known.
    """

    recording: str
    about: str
    outcome: Outcome
    steps: Mapping[str, Expected]
    indicators: Mapping[RulesetName, Mapping[IndicatorName, Expected]]

    @property
    def name(self) -> str:
        return Path(self.recording).stem

    @property
    def values(self) -> int:
        return 1 + len(self.steps) + sum(map(len, self.indicators.values()))


@dataclass(frozen=True, slots=True)
class ReferenceScore:
    """This installation's score of a reference.

    Attributes:
        off: each wrong value: name, value and what was expected, a line each.
        values: how many values are off; all of them where it could not be scored.
    """

    reference: Reference
    off: tuple[str, ...]
    values: int


def read_references(folder: Path) -> tuple[Reference, ...]:
    """The references of a folder, in order."""
    path = folder / EXPECTED_FILE
    try:
        references = decode(read_all(path, _LARGEST), tuple[Reference, ...])
    except (OSError, MadrobError) as error:
        raise _damaged(path, f"cannot be read ({error})") from None
    if not references:
        raise _damaged(path, "names no recording")
    return references


def score_references(references: tuple[Reference, ...], folder: Path) -> Iterator[ReferenceScore]:
    """Score each reference from its recording."""
    with recordings_of(folder) as unpacked:
        for reference in references:
            yield _scored_reference(reference, unpacked / reference.recording)


@contextmanager
def recordings_of(folder: Path) -> Iterator[Path]:
    """A temporary folder with the recordings."""
    path = folder / ARCHIVE
    with TemporaryDirectory(prefix="madrob_references_") as unpacked:
        try:
            with tarfile.open(path, "r:xz") as archive:
                for member in archive:
                    file = archive.extractfile(member)
                    assert file is not None
                    Path(unpacked, Path(member.name).name).write_bytes(file.read())
        except (OSError, EOFError, LZMAError, tarfile.TarError) as error:
            raise _damaged(path, f"cannot be unpacked ({error})") from None
        yield Path(unpacked)


def versions() -> Finding:
    return Finding(Severity.OK, "versions", libraries_here().words)


def reference_findings(score: ReferenceScore) -> Iterator[Finding]:
    name = score.reference.name
    if not score.off:
        yield Finding(Severity.OK, name, f"{score.reference.values} values right")
    for problem in score.off:
        yield Finding(Severity.ERROR, name, problem)


def reference_verdict(scores: Sequence[ReferenceScore]) -> str:
    off = sum(score.values for score in scores)
    if off:
        are = "value is" if off == 1 else "values are"
        return (
            f"{off} {are} off: do not use this installation for results; "
            f"install {DISTRIBUTION} again in a new environment, with its libraries"
        )
    values = sum(score.reference.values for score in scores)
    return f"this installation scores right ({len(scores)} references, {values} values)"


def _damaged(path: Path, what: str) -> MadrobError:
    return MadrobError(f"{path}: {what}: install {DISTRIBUTION} again")


def _scored_reference(reference: Reference, path: Path) -> ReferenceScore:
    try:
        scored = score_recording(path, tuple(reference.indicators))
    except MadrobError as error:
        return ReferenceScore(reference, (str(error),), reference.values)
    results = {scoring.result.ruleset: scoring.result for scoring in scored}
    first = scored[0].result
    off = []
    if first.outcome is not reference.outcome:
        off.append(f"outcome: {first.outcome}, expected {reference.outcome}")
    off += _steps_off(reference, first)
    for ruleset, expected in reference.indicators.items():
        for name, wanted in expected.items():
            indicator: Indicator = results[ruleset].indicators[name]
            problem = wanted.problem(indicator.value, indicator.reason)
            if problem is not None:
                off.append(f"{name} by {ruleset}: {problem}")
    return ReferenceScore(reference, tuple(off), len(off))


def _steps_off(reference: Reference, result: Result) -> Iterator[str]:
    for record in result.steps:
        wanted = reference.steps.get(str(record.step.value))
        time = None if record.final is None else record.final - result.start
        problem = None if wanted is None else wanted.problem(time, record.why_not)
        if problem is not None:
            yield f"step {record.step.value}: {problem}"
