"""Reads of `result.json` what is asked for: bounded, without numpy, and hostile content named.

What the file holds is declared in `result_document`; here stand only the keys that lists of runs
need, with the bounds within which they are believed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from madrob_console.archive.digests import FileDigest, run_id_at, run_id_of
from madrob_console.archive.folders import LARGEST_NUMBER, RESULT_FILE, RESULT_FORMAT
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import Stamp, read_bounded
from madrob_console.files.plain import refusal
from madrob_console.kinds import SourceKind
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.run import (
    VALID_OUTCOMES,
    AcceptedDoubts,
    Closure,
    Correction,
    FalseStart,
    Incident,
    JournalMark,
    TestbedFault,
    Voiding,
    Waiver,
)
from scoring.libraries import Libraries
from scoring.procedure import Ruling, StepRecord
from scoring.protocol import Condition, Outcome, Signal, Step, Thresholds

LARGEST_RESULT = 10_000_000
"""A larger `result.json` is none, bytes."""

Number = Annotated[int, Meta(ge=1, le=LARGEST_NUMBER)]
"""Of a subject or a run."""
ConditionNumber = Annotated[int, Meta(ge=1, le=20)]
Name = Annotated[str, Meta(max_length=200)]
"""Longer than any name that the console writes."""
StartTime = Annotated[float, Meta(ge=0, le=1e11)]
"""s since the epoch, within what calendars reach."""

_Item = TypeVar("_Item")

_AGAIN = "`madrob recover` makes it again"
_FIRST_LINE = 65_536
_DAMAGED = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)


Spread = Annotated[float, Meta(ge=0)]
"""Of a value, in its unit."""


class UncertaintyPart(msgspec.Struct, frozen=True):
    """How far a value can be trusted."""

    u: Spread
    expanded: Spread


class IndicatorPart(msgspec.Struct, frozen=True):
    """One indicator; no value where there is a reason instead."""

    value: int | float | None
    unit: str = ""
    reason: str | None = None
    uncertainty: UncertaintyPart | None = None
    doubts: tuple[str, ...] = ()


class ClosurePart(msgspec.Struct, frozen=True):
    """How the result was finalised."""

    team_word: Name


class VoidingPart(msgspec.Struct, frozen=True):
    """Why a run counts nowhere."""

    reason: str


class FormerSetup(msgspec.Struct, frozen=True):
    """As which run a run was set up, before a correction."""

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


class RatesPart(msgspec.Struct, frozen=True):
    """What is read of the data quality."""

    signals: Annotated[tuple[SignalRate, ...], Meta(max_length=50)] = ()


class RunKind(msgspec.Struct, frozen=True):
    """What is read of the set-up in a result; older ones know no practice."""

    practice: bool = False


class ListedResult(msgspec.Struct, frozen=True):
    """What lists of runs read of a `ResultDocument`; words of later versions pass as they are."""

    subject: Number
    condition_number: ConditionNumber
    run_number: Number
    team: Name
    start: StartTime
    outcome: Outcome
    indicators: dict[str, IndicatorPart]
    issue: Annotated[int, Meta(ge=0)]
    ruleset: Name
    source: Name | None = None
    competition: Name = ""
    closure: ClosurePart | None = None
    outcome_reason: str = ""
    journal: JournalMark | None = None
    flags: Annotated[tuple[Flag, ...], Meta(max_length=50)] | None = None
    voided: VoidingPart | None = None
    corrections: tuple[CorrectionPart, ...] = ()
    setup: RunKind = RunKind()
    libraries: Libraries | None = None
    zero_samples: ZeroPart | None = None
    run_id: Name = ""
    testbed: Name = ""
    thresholds: Thresholds | None = None
    quality: RatesPart = RatesPart()

    @property
    def rate(self) -> float | None:
        """How often the door's angle was sampled, Hz; None where it does not say."""
        door = Signal.DOOR.value
        return next((one.rate for one in self.quality.signals if one.signal == door), None)

    @property
    def valid(self) -> bool:
        """Whether its indicators count (protocol section 2)."""
        return self.outcome in VALID_OUTCOMES and self.voided is None

    @property
    def why_invalid(self) -> str:
        """Why they do not, in the referee's words or the machine's; empty where they do."""
        if self.voided is not None:
            return self.voided.reason
        return "" if self.valid else self.outcome_reason

    @property
    def practice(self) -> bool:
        """Whether it is of a practice run; all those of a simulated testbed are."""
        return self.setup.practice or self.source == SourceKind.SIMULATED


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


class StepsPart(msgspec.Struct, frozen=True):
    """When what was done in a run, s since the epoch; no stop where the machine failed."""

    start: StartTime
    stop: StartTime | None
    steps: Annotated[tuple[StepPart, ...], Meta(max_length=len(Step))]

    @property
    def done(self) -> dict[Step, float]:
        """The steps that count."""
        return {one.step: one.final for one in self.steps if one.final is not None}


class SetupPart(msgspec.Struct, frozen=True):
    """What is read of a run's set-up in its journal."""

    subject: Number
    team: Name
    ruleset: Name
    practice: bool = False
    run_id: Name = ""
    testbed: Name = ""


class _Format(msgspec.Struct):
    format: int


class _Remarks(msgspec.Struct):
    remarks: list[str]


class _OfQuality(msgspec.Struct):
    quality: _Remarks


class _Marks(msgspec.Struct, frozen=True):
    """What a result of a version that wrote no flags has of them."""

    outcome: Outcome
    source: SourceKind
    quality: _Remarks
    steps: tuple[StepRecord, ...]
    false_starts: tuple[FalseStart, ...]
    incidents: tuple[Incident, ...]
    waivers: tuple[Waiver, ...]
    rulings: tuple[Ruling, ...]
    closure: Closure | None
    voided: Voiding | None = None
    corrections: tuple[Correction, ...] = ()
    setup: RunKind = RunKind()

    @property
    def practice(self) -> bool:
        """Whether it was set up as practice."""
        return self.setup.practice

    @property
    def out_of_plan(self) -> bool:
        """Who wrote no flags knew no plan."""
        return False

    @property
    def team_reason(self) -> str:
        """There was no list of teams to differ from."""
        return ""

    @property
    def accepted_doubts(self) -> tuple[AcceptedDoubts, ...]:
        """Nor any doubts."""
        return ()

    @property
    def faults(self) -> tuple[TestbedFault, ...]:
        """They stand among the remarks, as `Run.remarks` words them."""
        found = (text for text in self.quality.remarks if text.startswith(("fault at ", "fault: ")))
        return tuple(TestbedFault(0.0, text) for text in found)


class EventPart(msgspec.Struct, frozen=True):
    """Something that happened, s since the epoch and since the start."""

    time: float
    since_start: float
    event: Name


class TabledResult(ListedResult, frozen=True):
    """What the tables of runs read besides."""

    stop: float | None = None
    lock_detection: Name = ""
    software: str = ""
    events: tuple[EventPart, ...] = ()
    steps: tuple[StepPart, ...] = ()


class _Files(msgspec.Struct):
    files: dict[str, FileDigest]


class _Details(msgspec.Struct):
    setup: SetupPart


class _FirstEntry(msgspec.Struct):
    details: _Details


_Listed = TypeVar("_Listed", bound=ListedResult)

_formats = msgspec.json.Decoder(_Format)
_anything: msgspec.json.Decoder[Any] = msgspec.json.Decoder()
_results = msgspec.json.Decoder(ListedResult)
_tabled = msgspec.json.Decoder(TabledResult)
_files = msgspec.json.Decoder(_Files)
_steps = msgspec.json.Decoder(StepsPart)
_quality = msgspec.json.Decoder(_OfQuality)
_marks = msgspec.json.Decoder(_Marks)
_first_entries = msgspec.json.Decoder(_FirstEntry)


class UnusableResultError(MadrobError):
    """A `result.json` that says nothing about a run."""


class DamagedResultError(UnusableResultError):
    """One that was spoilt: it can be made again."""


def read_result(folder: str) -> tuple[ListedResult, Stamp]:
    """What the `result.json` of a run folder says.

    Raises:
        FileNotFoundError: there is none.
        UnusableResultError: it cannot be used; the message says why and what to do.
    """
    data, stamp = _read(folder)
    return _completed(_decoded(_results, data), folder, data), stamp


def read_tabled_result(folder: str) -> TabledResult:
    """The same, and what the tables of runs want besides.

    Raises:
        FileNotFoundError: there is none.
        UnusableResultError: it cannot be used; the message says why and what to do.
    """
    data, _ = _read(folder)
    return tabled_result(folder, data)


def tabled_result(folder: str, data: bytes) -> TabledResult:
    """The same of a result that is in memory.

    Args:
        folder: of the run, or its bag.
        data: what `result.json` has.

    Raises:
        UnusableResultError: it cannot be used; the message says why.
    """
    return _completed(_decoded(_tabled, data), folder, data)


def _completed(result: _Listed, folder: str, data: bytes) -> _Listed:
    """With what a result of an earlier version does not say itself."""
    if result.flags is None:
        result = replace(result, flags=_flags_of(data))
    if not result.run_id:
        result = replace(result, run_id=_run_id_of(folder, data))
    return result


def _run_id_of(folder: str, data: bytes) -> str:
    """The identity of a run whose result has none; of its recording, where it has no digest."""
    try:
        found = run_id_of(_files.decode(data).files)
    except _DAMAGED:
        found = ""
    return found or run_id_at(Path(folder))


def _flags_of(data: bytes) -> tuple[Flag, ...]:
    """The flags of a result that has none with it; none where it does not say."""
    try:
        marks = _marks.decode(data)
    except _DAMAGED:
        return ()
    return flags(marks, marks.steps, marks.source, marks.quality.remarks)


def read_whole_result(folder: str) -> dict[str, Any]:
    """All of the `result.json` of a run folder, as JSON values.

    Raises:
        FileNotFoundError: there is none.
        UnusableResultError: it cannot be used; the message says why and what to do.
    """
    data, _ = _read(folder)
    _decoded(_results, data)  # refuses what is no result
    whole: dict[str, Any] = _decoded(_anything, data)
    return whole


def read_remarks(folder: str) -> list[str]:
    """What a stored result says of the data quality; nothing where it is missing or damaged."""
    try:
        data, _ = read_bounded(f"{folder}/{RESULT_FILE}", LARGEST_RESULT)
        return _quality.decode(data).quality.remarks
    except (OSError, *_DAMAGED):
        return []


def read_steps(folder: str) -> StepsPart | None:
    """When the steps were done, as a stored result says; None where it is missing or damaged."""
    try:
        data, _ = read_bounded(f"{folder}/{RESULT_FILE}", LARGEST_RESULT)
        return _steps.decode(data)
    except (OSError, *_DAMAGED):
        return None


def read_file_digests(folder: str) -> dict[str, FileDigest]:
    """The files that a stored result names; none where it is missing, damaged or older."""
    try:
        data, _ = read_bounded(f"{folder}/{RESULT_FILE}", LARGEST_RESULT)
        return _files.decode(data).files
    except (OSError, *_DAMAGED):
        return {}


def _read(folder: str) -> tuple[bytes, Stamp]:
    """A `result.json` of a format that is known."""
    try:
        data, stamp = read_bounded(f"{folder}/{RESULT_FILE}", LARGEST_RESULT)
    except FileNotFoundError:
        raise
    except NotADirectoryError as error:  # the file of a bag alone
        raise FileNotFoundError(*error.args) from None
    except OSError as error:
        raise UnusableResultError(
            f"{RESULT_FILE} cannot be read ({refusal(error)}): put a readable file in its place"
        ) from None
    if stamp[1] > LARGEST_RESULT:
        size = f"{stamp[1] / 1e6:.0f} MB"
        raise DamagedResultError(f"{RESULT_FILE} has {size}, too much for a result: {_AGAIN}")
    version = _decoded(_formats, data).format
    if version > RESULT_FORMAT:
        raise UnusableResultError(
            f"{RESULT_FILE} has format {version}, this program knows {RESULT_FORMAT}: use a "
            "newer madrob-console"
        )
    return data, stamp


def _decoded(decoder: msgspec.json.Decoder[_Item], data: bytes) -> _Item:
    try:
        return decoder.decode(data)
    except _DAMAGED as error:
        why = str(error)[:120]
        raise DamagedResultError(f"{RESULT_FILE} is damaged ({why}): {_AGAIN}") from None


def read_setup(journal: str) -> SetupPart | None:
    """The set-up in the first line of a run's journal; None when it does not say."""
    try:
        data, _ = read_bounded(journal, _FIRST_LINE)
        return _first_entries.decode(data.partition(b"\n")[0]).details.setup
    except (OSError, *_DAMAGED):
        return None
