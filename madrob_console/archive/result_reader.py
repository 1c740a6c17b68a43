"""Reads of `result.json` what is asked for: bounded, without numpy, and hostile content named."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from madrob_console.archive.folders import ISSUE_FILE, LARGEST_NUMBER, RESULT_FILE, RESULT_FORMAT
from madrob_console.archive.journal_agreement import is_noted, was_changed
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.run_journal import recorded_competition
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import read_bounded, refusal
from madrob_console.common.stored_json import decode
from madrob_console.referee.records import Reissuing
from madrob_console.referee.run_setup import StoredRuleset
from madrob_console.referee.run_summary import Name, StartTime
from scoring.protocol import ScoringError
from scoring.result import Libraries

LARGEST_RESULT = 10_000_000
"""A larger `result.json` is refused, bytes."""

_Item = TypeVar("_Item")

_AGAIN = "`madrob recover` makes it again"

_DAMAGED = (ScoringError, MadrobError)

Number = Annotated[int, Meta(ge=1, le=LARGEST_NUMBER)]

_Whole = Annotated[int, Meta(ge=-(2**53), le=2**53)]
"""As many digits as every reader of JSON keeps."""


class _Format(msgspec.Struct):
    format: int


class _IndicatorBounds(msgspec.Struct):
    value: _Whole | float | None


class _ProtestBounds(msgspec.Struct):
    time: StartTime
    at: StartTime | None = None


class _StepBounds(msgspec.Struct):
    sensors: StartTime | None = None
    final: StartTime | None = None


class _Bounds(msgspec.Struct):
    """The values that a result can have beyond the types of its document."""

    subject: Number
    condition_number: Annotated[int, Meta(ge=1, le=20)]
    run_number: Number
    team: Name
    start: StartTime
    ruleset: StoredRuleset
    indicators: dict[str, _IndicatorBounds]
    issue: Annotated[int, Meta(ge=0, le=2**53)]
    libraries: Libraries
    stop: StartTime | None = None
    competition: Name = ""
    testbed: Name = ""
    run_id: Name = ""
    flags: Annotated[tuple[msgspec.Raw, ...], Meta(max_length=50)] = ()
    protests: Annotated[tuple[_ProtestBounds, ...], Meta(max_length=50)] = ()
    steps: tuple[_StepBounds, ...] = ()


class UnusableResultError(MadrobError):
    """A `result.json` that cannot be used."""


class DamagedResultError(UnusableResultError):
    """A damaged `result.json`, which can be made again."""


def read_result(folder: str) -> ResultDocument:
    """The `result.json` of a run folder.

    Raises:
        FileNotFoundError: there is none.
        UnusableResultError: the message says why and what to do.
    """
    data = _read(folder)
    if was_changed(data, Path(folder)):
        raise DamagedResultError(f"{RESULT_FILE} was changed after it was written: {_AGAIN}")
    return _document(data, folder)


def lacks_line(folder: str) -> bool:
    """Whether no line of the journal has the digest of `result.json`; raises as `read_result`."""
    return not is_noted(_read(folder), Path(folder))


def _document(data: bytes, folder: str) -> ResultDocument:
    try:
        _decoded(data, _Bounds)
        return _decoded(data, ResultDocument)
    except DamagedResultError:
        if not is_noted(data, Path(folder)):
            raise
        raise UnusableResultError(
            f"{RESULT_FILE} has values that this program does not know: use the madrob-console "
            "that wrote it"
        ) from None


def earlier_issues(folder: Path, reissues: Iterable[Reissuing]) -> tuple[ResultDocument, ...]:
    """The earlier issues of a result; those that cannot be read are missing."""
    issues = []
    for number in {reissue.issue - 1 for reissue in reissues}:
        with suppress(OSError, *_DAMAGED):
            data, _ = read_bounded(str(folder / ISSUE_FILE.format(number)), LARGEST_RESULT)
            issues.append(decode(data, ResultDocument))
    return tuple(issues)


def read_whole_result(folder: str) -> dict[str, Any]:
    """All of a result as JSON values, which need not be a document's; raises likewise."""
    data = _read(folder)
    _decoded(data, _Bounds)
    return _decoded(data, dict[str, Any])


def read_sound_result(folder: str) -> ResultDocument | None:
    """As `read_result`; None where the result is missing or cannot be used."""
    try:
        return read_result(folder)
    except (FileNotFoundError, UnusableResultError):
        return None


def _read(folder: str) -> bytes:
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
    if stamp.size > LARGEST_RESULT:
        size = f"{stamp.size / 1e6:.0f} MB"
        raise DamagedResultError(f"{RESULT_FILE} has {size}, too much for a result: {_AGAIN}")
    version = _decoded(data, _Format).format
    if version > RESULT_FORMAT:
        raise UnusableResultError(
            f"{RESULT_FILE} has format {version}, this program knows {RESULT_FORMAT}: use a "
            "newer madrob-console"
        )
    return data


def _decoded(data: bytes, kind: type[_Item]) -> _Item:
    try:
        return decode(data, kind)
    except _DAMAGED as error:
        raise DamagedResultError(f"{RESULT_FILE} is damaged ({error}): {_AGAIN}") from None


def competition_of(folder: Path) -> str | None:
    """From the result, else the journal; None = neither says."""
    if (result := read_sound_result(str(folder))) is not None:
        return result.competition
    return recorded_competition(folder)
