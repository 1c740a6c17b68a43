"""The keys of `result.json` that lists need, and the checksums that tie it to its run.

What the file holds is declared in `result_document`.
"""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from uuid import UUID

import msgspec
from msgspec import Meta

from madrob_console.archive.folders import LARGEST_NUMBER
from madrob_console.common.files import open_plain, refusal
from madrob_console.common.names import SourceKind
from madrob_console.referee.flags import Flag
from madrob_console.referee.records import (
    JournalMark,
    Sha256,
    derived_run_id,
)
from madrob_console.referee.run import VALID_OUTCOMES
from scoring.indicator_table import IndicatorName
from scoring.libraries import Libraries
from scoring.protocol import Condition, Outcome, Signal, Step, Thresholds
from scoring.result import Indicator, Uncertainty

Number = Annotated[int, Meta(ge=1, le=LARGEST_NUMBER)]
ConditionNumber = Annotated[int, Meta(ge=1, le=20)]
Name = Annotated[str, Meta(max_length=200)]
StartTime = Annotated[float, Meta(ge=0, le=1e11)]
"""s since the epoch, within the range of calendars."""

_UNTOLD = "why is not told"

Whole = Annotated[int, Meta(ge=-(2**53), le=2**53)]
"""As many digits as every reader of JSON keeps."""

Spread = Annotated[float, Meta(ge=0)]


class UncertaintyPart(msgspec.Struct, frozen=True):
    """How far a value can be trusted."""

    u: Spread
    expanded: Spread


class IndicatorPart(msgspec.Struct, frozen=True):
    """One indicator; a value or a reason why not."""

    value: Whole | float | None
    unit: str = ""
    reason: str | None = None
    uncertainty: UncertaintyPart | None = None
    doubts: tuple[str, ...] = ()

    def indicator_of(self, name: IndicatorName) -> Indicator:
        if self.value is None:
            return Indicator(None, name.spec.unit, self.reason or _UNTOLD, doubts=self.doubts)
        known = self.uncertainty
        spread = None if known is None else Uncertainty(known.u, known.expanded)
        return Indicator(self.value, name.spec.unit, None, spread, self.doubts)


class ClosurePart(msgspec.Struct, frozen=True):
    """How the result was finalised."""

    team_word: Name


class VoidingPart(msgspec.Struct, frozen=True):
    """Why a run counts nowhere."""

    reason: str


class AnswerPart(msgspec.Struct, frozen=True):
    """What closed a protest."""

    end: Name


class ProtestPart(msgspec.Struct, frozen=True):
    """A protest against the result; without an answer it is open. Times as `StartTime`."""

    time: StartTime
    at: StartTime | None = None
    answer: AnswerPart | None = None


class FormerSetup(msgspec.Struct, frozen=True):
    """Which run it was set up as, before a correction."""

    subject: Number
    run_number: Number
    condition: Condition


class CorrectionPart(msgspec.Struct, frozen=True):
    """What was set until a correction."""

    before: FormerSetup


class ZeroPart(msgspec.Struct, frozen=True):
    """The handle zero that was set for a run, N."""

    mean: int | float


class SignalRate(msgspec.Struct, frozen=True):
    """How often a signal was sampled, Hz."""

    signal: str
    rate: Annotated[float, Meta(ge=0)] | None = None


class QualityPart(msgspec.Struct, frozen=True):
    """Sampling rates and remarks of the data quality."""

    signals: Annotated[tuple[SignalRate, ...], Meta(max_length=50)] = ()
    remarks: tuple[str, ...] = ()


class RunKind(msgspec.Struct, frozen=True):
    """The set-up part of a result; older ones have no practice."""

    practice: bool = False


class RulingPart(msgspec.Struct, frozen=True):
    """The referee's word on a step."""

    confirmed: bool | None


class StepPart(msgspec.Struct, frozen=True):
    """One of the six steps: its times, s since the epoch; null = not done."""

    step: Step
    name: Name = ""
    sensors: StartTime | None = None
    referee: RulingPart | None = None
    final: StartTime | None = None
    reason: str | None = None


class EventPart(msgspec.Struct, frozen=True):
    """An event, s since the epoch and since the start."""

    time: float
    since_start: float
    event: Name


@dataclass(frozen=True, slots=True)
class FileDigest:
    """A file of the run as it was when the result was written.

    Attributes:
        sha256: its digest.
        bytes: its size.
    """

    sha256: Sha256
    bytes: int


class ListedResult(msgspec.Struct, frozen=True):
    """What is read of a `result.json`; what other versions add or lack does not matter.

    No stop where the machine failed.
    """

    subject: Number
    condition_number: ConditionNumber
    run_number: Number
    team: Name
    start: StartTime
    outcome: Outcome
    indicators: dict[str, IndicatorPart]
    issue: Annotated[int, Meta(ge=0, le=2**53)]
    ruleset: Name
    source: Name | None = None
    competition: Name = ""
    closure: ClosurePart | None = None
    outcome_reason: str = ""
    journal: JournalMark | None = None
    flags: Annotated[tuple[Flag, ...], Meta(max_length=50)] | None = None
    voided: VoidingPart | None = None
    corrections: tuple[CorrectionPart, ...] = ()
    protests: Annotated[tuple[ProtestPart, ...], Meta(max_length=50)] = ()
    setup: RunKind = RunKind()
    libraries: Libraries | None = None
    zero_samples: ZeroPart | None = None
    run_id: Name = ""
    testbed: Name = ""
    thresholds: Thresholds | None = None
    quality: QualityPart = QualityPart()
    stop: StartTime | None = None
    lock_detection: Name = ""
    software: str = ""
    events: tuple[EventPart, ...] = ()
    steps: Annotated[tuple[StepPart, ...], Meta(max_length=len(Step))] = ()
    files: dict[str, FileDigest] = {}

    @property
    def told(self) -> dict[IndicatorName, Indicator]:
        """The indicators that this version knows, in the protocol's order."""
        parts = self.indicators
        return {name: parts[name].indicator_of(name) for name in IndicatorName if name in parts}

    @property
    def steps_done(self) -> dict[Step, float]:
        return {one.step: one.final for one in self.steps if one.final is not None}

    @property
    def rate(self) -> float | None:
        """Sampling rate of the door's angle, Hz; None where it does not say."""
        door = Signal.DOOR.value
        return next((one.rate for one in self.quality.signals if one.signal == door), None)

    @property
    def open_protest(self) -> ProtestPart | None:
        return next((one for one in self.protests if one.answer is None), None)

    @property
    def instant_in_question(self) -> float | None:
        """The instant of the open protest, else of the last one, s from the start."""
        of = self.open_protest or (self.protests[-1] if self.protests else None)
        return None if of is None or of.at is None else of.at - self.start

    @property
    def valid(self) -> bool:
        """Whether its indicators count (protocol section 2)."""
        return self.outcome in VALID_OUTCOMES and self.voided is None

    @property
    def why_invalid(self) -> str:
        """The referee's or the machine's reason; empty where it is valid."""
        if self.voided is not None:
            return self.voided.reason
        return "" if self.valid else self.outcome_reason

    @property
    def practice(self) -> bool:
        """Whether it counts for nothing; all runs of a simulated testbed do."""
        return self.setup.practice or self.source == SourceKind.SIMULATED


class SetupPart(msgspec.Struct, frozen=True):
    """The part of a set-up that is read from the journal."""

    subject: Number
    team: Name
    ruleset: Name
    practice: bool = False
    run_id: Name = ""
    testbed: Name = ""
    competition: Name | None = None


# Checksums that tie the files of a run to the result that was computed from them.


LARGEST_DIGESTED = 4_000_000_000
"""Larger files have no digest, bytes: it would take a minute. A run of 3 h takes half of that."""

IDENTITY_RECORD = "madrob_identity"
"""The metadata record of a repaired recording, whose digest has changed since."""

_RUN_ID = "run_id"
_RECORDING = ".mcap"
_METADATA = "metadata.yaml"
_DATA = (_RECORDING, ".yaml", ".csv")


def digests_of(
    folder: Path, new: Mapping[str, bytes] | None = None
) -> tuple[dict[str, FileDigest], tuple[str, ...]]:
    """Digests of recording and data files, `new` ones included; then why others have none."""
    digests, left_out, new = {}, [], new or {}
    names = {f"{folder.name}_0.mcap", _METADATA, *_data_files(folder), *new}
    if lists_evidence(folder):
        names.discard(_METADATA)
    for name in sorted(names):
        try:
            digests[name] = _digest_of(new[name]) if name in new else _digest(folder / name)
        except OSError as error:
            left_out.append(f"{name}: cannot be read ({refusal(error)})")
    return digests, tuple(left_out)


def lists_evidence(folder: Path) -> bool:
    """Whether a bag has or had evidence: then its `metadata.yaml` has no digest.

    Evidence may be finished after the result, and is thinned later. Both change `metadata.yaml`.
    """
    from recorder.bag import is_evidence

    return any(map(is_evidence, _names(folder))) or any(map(is_evidence, listed_in(folder)))


def listed_in(folder: Path) -> list[str]:
    """The files in a bag's `metadata.yaml`; none where that is missing or damaged."""
    from recorder.bag import YAML_PROBLEMS
    from recorder.mcap_reader import DamageError
    from recorder.reader import bag_information, listed_names

    try:
        return listed_names(bag_information(folder))
    except (DamageError, OSError, *YAML_PROBLEMS):
        return []


def run_id_of(files: Mapping[str, FileDigest]) -> str:
    """The run id of a run of an earlier version, from its files; empty without a recording.

    An empty recording, as from a sync that keeps names only, identifies no run.
    """
    named = (name for name, of in files.items() if name.endswith(_RECORDING) and of.bytes)
    recordings = sorted(named)
    return derived_run_id(files[recordings[0]].sha256) if recordings else ""


def run_id_at(path: Path) -> str:
    """As `run_id_of`, on disk; empty where its recording cannot be read."""
    if kept := kept_run_id(path):
        return kept
    names = [path.name] if path.is_file() else _data_files(path)
    folder = path.parent if path.is_file() else path
    recordings = sorted(name for name in names if name.endswith(_RECORDING))
    try:
        return run_id_of({name: _digest(folder / name) for name in recordings[:1]})
    except OSError:
        return ""


def identity_record(run_id: str) -> dict[str, dict[str, str]]:
    return {IDENTITY_RECORD: {_RUN_ID: run_id}}


def kept_run_id(path: Path) -> str:
    from recorder.errors import RecorderError  # lists of runs do without the recorder
    from recorder.reader import read_bag

    try:
        return str(UUID(read_bag(path).records[IDENTITY_RECORD][_RUN_ID]))
    except (RecorderError, KeyError, ValueError):
        return ""


def _data_files(folder: Path) -> list[str]:
    return [name for name in _names(folder) if _is_data(name)]


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208  of the names only
    except OSError:
        return []  # the files that must be there tell why


def _is_data(name: str) -> bool:
    """Evidence is not: the result takes nothing from it, and its digest takes long."""
    from recorder.bag import is_evidence  # lists of runs do without the recorder

    return name.endswith(_DATA) and not name.startswith(".") and not is_evidence(name)


def _digest(path: Path) -> FileDigest:
    with os.fdopen(open_plain(path), "rb") as file:
        if (size := os.fstat(file.fileno()).st_size) > LARGEST_DIGESTED:
            raise OSError(errno.EFBIG, f"{size / 1e9:.1f} GB, too much for a digest")
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return FileDigest(sha256=digest, bytes=file.tell())


def _digest_of(content: bytes) -> FileDigest:
    return FileDigest(sha256=hashlib.sha256(content).hexdigest(), bytes=len(content))
