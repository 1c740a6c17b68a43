"""Reads of `result.json` what is asked for: bounded, without numpy, and hostile content named."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec.structs import replace

from madrob_console.archive.folders import ISSUE_FILE, JOURNAL_FILE, RESULT_FILE, RESULT_FORMAT
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_summary import (
    FileDigest,
    ListedResult,
    SetupPart,
    run_id_at,
    run_id_of,
)
from madrob_console.archive.run_journal import was_changed
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import Stamp, read_bounded, refusal
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.records import Reissuing, TestbedFault
from madrob_console.referee.run import Run
from scoring.quality import Quality

LARGEST_RESULT = 10_000_000
"""A larger `result.json` is refused, bytes."""

_Item = TypeVar("_Item")

_AGAIN = "`madrob recover` makes it again"
_FAULT = "fault at ", "fault: "
"""How `Run.remarks` begins a fault of the testbed."""

_FIRST_LINE = 65_536
_DAMAGED = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)


class _Format(msgspec.Struct):
    format: int


class _Details(msgspec.Struct):
    setup: SetupPart


class _FirstEntry(msgspec.Struct):
    details: _Details


_formats = msgspec.json.Decoder(_Format)
_anything: msgspec.json.Decoder[Any] = msgspec.json.Decoder()
_results = msgspec.json.Decoder(ListedResult)
_documents = msgspec.json.Decoder(ResultDocument)
_first_entries = msgspec.json.Decoder(_FirstEntry)


class UnusableResultError(MadrobError):
    """A `result.json` that cannot be used."""


class DamagedResultError(UnusableResultError):
    """A damaged `result.json`, which can be made again."""


def read_result(folder: str) -> tuple[ListedResult, Stamp]:
    """The `result.json` of a run folder.

    Raises:
        FileNotFoundError: there is none.
        UnusableResultError: the message says why and what to do.
    """
    data, stamp = _read(folder)
    result = _decoded(_results, data)
    if was_changed(data, Path(folder)):
        raise DamagedResultError(f"{RESULT_FILE} was changed after it was written: {_AGAIN}")
    return _completed(result, folder, data), stamp


def decoded_result(folder: str, data: bytes) -> ListedResult:
    """As `read_result`, of a `result.json` in memory; `folder` may be its bag."""
    return _completed(_decoded(_results, data), folder, data)


def _completed(result: ListedResult, folder: str, data: bytes) -> ListedResult:
    """Adds what results of earlier versions lack."""
    if result.flags is None:
        result = replace(result, flags=_flags_of(data))
    if not result.run_id:
        result = replace(result, run_id=run_id_of(result.files) or run_id_at(Path(folder)))
    return result


def _flags_of(data: bytes) -> tuple[Flag, ...]:
    """The flags of a result of 0.1.0; its faults are among the remarks."""
    try:
        document = _documents.decode(data)
    except _DAMAGED:
        return ()
    remarks = document.quality.remarks
    run = Run(
        outcome=document.outcome,
        false_starts=document.false_starts,
        incidents=document.incidents,
        waivers=document.waivers,
        rulings=document.rulings,
        closure=document.closure,
        faults=tuple(TestbedFault(0.0, text) for text in remarks if text.startswith(_FAULT)),
    )
    return flags(run, document.steps, document.source, Quality(remarks=remarks))


def earlier_issues(folder: Path, reissues: Iterable[Reissuing]) -> tuple[ListedResult, ...]:
    """The earlier issues of a result; those that cannot be read are missing."""
    found = []
    for number in {one.issue - 1 for one in reissues}:
        with suppress(OSError, *_DAMAGED):
            data, _ = read_bounded(str(folder / ISSUE_FILE.format(number)), LARGEST_RESULT)
            found.append(_results.decode(data))
    return tuple(found)


def read_whole_result(folder: str) -> dict[str, Any]:
    """All of `result.json` as JSON values; raises as `read_result`."""
    data, _ = _read(folder)
    _decoded(_results, data)  # refuses what is no result
    whole: dict[str, Any] = _decoded(_anything, data)
    return whole


def read_sound_result(folder: str) -> ListedResult | None:
    """As `read_result`; None where the result is missing or cannot be used."""
    try:
        return read_result(folder)[0]
    except (FileNotFoundError, UnusableResultError):
        return None


def read_file_digests(folder: str) -> dict[str, FileDigest]:
    """Empty where the result is missing, damaged or older."""
    result = read_sound_result(folder)
    return {} if result is None else result.files


def _read(folder: str) -> tuple[bytes, Stamp]:
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
    """From the first line of the journal."""
    try:
        data, _ = read_bounded(journal, _FIRST_LINE)
        return _first_entries.decode(data.partition(b"\n")[0]).details.setup
    except (OSError, *_DAMAGED):
        return None


def competition_of(folder: str) -> str | None:
    """From the result, else the journal; None = neither says."""
    if (result := read_sound_result(folder)) is not None:
        return result.competition
    setup = read_setup(f"{folder}/{JOURNAL_FILE}")
    return None if setup is None else setup.competition
