"""Attachments of finished MCAP files: read, added at the end of a copy, and taken out again."""

from __future__ import annotations

import io
from collections import defaultdict
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, DataEnd, McapRecord, Statistics

from recorder.mcap_reader import (
    FRAME,
    DamageError,
    frames_of,
    parse,
    read_summary,
    record_at,
    summary_of,
)
from recorder.mcap_writer import file_end, record_bytes

_DATA_END = record_bytes(DataEnd(0))
_INDEX = frozenset({Opcode.ATTACHMENT_INDEX})


@dataclass(frozen=True, slots=True)
class FileEnding:
    """Another end of a file: `data` from the byte `begin` on."""

    begin: int
    data: bytes


def read_attachment(file: BinaryIO, name: str) -> bytes | None:
    """The attachment of this name; None where there is none, or the file is not whole."""
    try:
        for index in read_summary(file, _INDEX):
            if isinstance(index, AttachmentIndex) and index.name == name:
                attached = record_at(file, index.offset, file.seek(0, io.SEEK_END))
                return attached.data if isinstance(attached, Attachment) else None
    except DamageError:
        pass
    return None


def attach(file: BinaryIO, name: str, media_type: str, data: bytes) -> FileEnding | None:
    """How a copy of the file ends that has an attachment.

    None where `detach` could not give the file back to the last byte.
    """
    try:
        summary = _Summary(file)
    except DamageError:
        return None
    file.seek(summary.data_end)
    if summary.index is not None or file.read() != summary.ending(summary.data_end).data:
        return None
    at, time = summary.data_end, summary.statistics.message_end_time
    record = record_bytes(Attachment(time, time, name, media_type, data))
    index = AttachmentIndex(at, len(record), time, time, len(data), name, media_type)
    return summary.ending(at, record, index)


def detach(file: BinaryIO, name: str) -> FileEnding | None:
    """How the file ended before `attach`; None where no such attachment is at its end."""
    try:
        summary = _Summary(file)
    except DamageError:
        return None
    index = summary.index
    if index is None or index.name != name or index.offset + index.length != summary.data_end:
        return None
    return summary.ending(index.offset)


class _Summary:
    """The summary of a file, its records by opcode; raises DamageError.

    Attributes:
        data_end: the place of the record that ends the data.
        index: of its last attachment.
    """

    def __init__(self, file: BinaryIO) -> None:
        start, records = summary_of(file)
        self.data_end = start - len(_DATA_END)
        self.index: AttachmentIndex | None = None
        self._groups: defaultdict[Opcode, bytes] = defaultdict(bytes)
        statistics: McapRecord | None = None
        for frame in frames_of(io.BytesIO(records), 0, len(records), frozenset(Opcode)):
            if frame.opcode == Opcode.STATISTICS:
                statistics = parse(frame)
            elif frame.opcode == Opcode.ATTACHMENT_INDEX:
                index = parse(frame)
                self.index = index if isinstance(index, AttachmentIndex) else None
                continue
            elif frame.opcode == Opcode.SUMMARY_OFFSET:
                continue
            self._groups[Opcode(frame.opcode)] += (
                FRAME.pack(frame.opcode, len(frame.body)) + frame.body
            )
        if not isinstance(statistics, Statistics):
            raise DamageError("it has no statistics")
        self.statistics = statistics

    def ending(
        self, at: int, record: bytes = b"", index: AttachmentIndex | None = None
    ) -> FileEnding:
        """The end of a file from byte `at` on, with one attachment or none."""
        self.statistics.attachment_count = 0 if index is None else 1
        groups = self._groups | {Opcode.STATISTICS: record_bytes(self.statistics)}
        if index is not None:
            groups[Opcode.ATTACHMENT_INDEX] = record_bytes(index)
        data = record + _DATA_END
        return FileEnding(at, data + file_end(at + len(data), groups))
