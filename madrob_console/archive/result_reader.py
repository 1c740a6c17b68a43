"""Reads of `result.json` what is asked for: bounded, without numpy, and hostile content named.

What the file holds is declared in `result_document`; here stand only the keys that lists of runs
need, with the bounds within which they are believed.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from madrob_console.archive.folders import LARGEST_NUMBER, RESULT_FILE, RESULT_FORMAT
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import Stamp, read_bounded
from madrob_console.files.plain import refusal
from scoring.protocol import Outcome

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

_AGAIN = "make it again with `madrob score`"
_FIRST_LINE = 65_536
_DAMAGED = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)


class IndicatorPart(msgspec.Struct, frozen=True):
    """One indicator; no value where there is a reason instead."""

    value: int | float | None


class ClosurePart(msgspec.Struct, frozen=True):
    """How the result was finalised."""

    team_word: Name


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


class SetupPart(msgspec.Struct, frozen=True):
    """What is read of a run's set-up in its journal."""

    subject: Number
    team: Name
    ruleset: Name


class _Format(msgspec.Struct):
    format: int


class _Remarks(msgspec.Struct):
    remarks: list[str]


class _OfQuality(msgspec.Struct):
    quality: _Remarks


class _Details(msgspec.Struct):
    setup: SetupPart


class _FirstEntry(msgspec.Struct):
    details: _Details


_formats = msgspec.json.Decoder(_Format)
_anything: msgspec.json.Decoder[Any] = msgspec.json.Decoder()
_results = msgspec.json.Decoder(ListedResult)
_quality = msgspec.json.Decoder(_OfQuality)
_first_entries = msgspec.json.Decoder(_FirstEntry)


class UnusableResultError(MadrobError):
    """A `result.json` that says nothing about a run."""


def read_result(folder: str) -> tuple[ListedResult, Stamp]:
    """What the `result.json` of a run folder says.

    Raises:
        FileNotFoundError: there is none.
        UnusableResultError: it cannot be used; the message says why and what to do.
    """
    data, stamp = _read(folder)
    return _decoded(_results, data), stamp


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
        raise UnusableResultError(f"{RESULT_FILE} has {size}, too much for a result: {_AGAIN}")
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
        raise UnusableResultError(f"{RESULT_FILE} is damaged ({why}): {_AGAIN}") from None


def read_setup(journal: str) -> SetupPart | None:
    """The set-up in the first line of a run's journal; None when it does not say."""
    try:
        data, _ = read_bounded(journal, _FIRST_LINE)
        return _first_entries.decode(data.partition(b"\n")[0]).details.setup
    except (OSError, *_DAMAGED):
        return None
