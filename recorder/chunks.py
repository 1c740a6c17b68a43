"""Unpacks the content of an MCAP chunk: whole, damaged or cut off.

A whole chunk is believed if its size and its checksum are right. A cut one has lost its end, so
no checksum can tell; what comes before the cut is what was written.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import zstandard

RECORD_LIMIT = 128 * 1024 * 1024
"""The most bytes a record or a chunk may have, decompressed; rosbag2 makes chunks of 0.75 MiB."""

CHUNK_HEAD = struct.Struct("<QQQII")  # first time, last time, size, checksum, length of a name
_SIZE = struct.Struct("<Q")
_NAME_LIMIT = 32
_LZ4_PIECE = 64 * 1024
_ZSTD_STEP = 256
"""Bytes per step: they are at most 64 blocks, which unpack to 128 KiB each."""

_SECTOR = 512


@dataclass(frozen=True, slots=True)
class ChunkContent:
    """Records of a chunk; of a cut chunk those before the cut and a part of the next one.

    `problem` says why that is not all, as the end of a sentence; else None. `foreign`: the chunk
    may be whole, but this reader cannot decompress it.
    """

    records: bytes
    problem: str | None
    foreign: bool = False


@dataclass(frozen=True, slots=True)
class _Packed:
    size: int
    checksum: int
    compression: str
    data: bytes
    data_size: int


def unpack(body: bytes) -> ChunkContent:
    """Decompress a chunk record's body, or what is left of it.

    Memory is taken as the content grows, never for what the chunk claims.
    """
    try:
        packed = _parse_chunk(body)
    except (struct.error, ValueError):
        return ChunkContent(b"", "is damaged")
    if packed.size > RECORD_LIMIT:
        return ChunkContent(b"", f"claims {packed.size} bytes")
    if packed.compression not in _UNPACKERS:
        words = f"has the unknown compression {packed.compression!r}"
        return ChunkContent(b"", words, foreign=True)
    content = _decompress(packed, packed.data)
    cut = len(packed.data) < packed.data_size
    problem = "is cut off" if cut else _mistake(packed, content)
    if problem is None:
        return ChunkContent(content, None)
    # A power cut leaves sectors of zeros where data never came to the disk.
    solid = packed.data.rstrip(b"\0")
    if len(packed.data) - len(solid) >= _SECTOR:
        content, cut = _decompress(packed, solid), True
    return ChunkContent(content[: packed.size] if cut else b"", problem)


def _parse_chunk(body: bytes) -> _Packed:
    _, _, size, checksum, name_length = CHUNK_HEAD.unpack_from(body)
    if name_length > _NAME_LIMIT:
        raise ValueError
    start = CHUNK_HEAD.size + name_length
    name = body[CHUNK_HEAD.size : start].decode()
    (data_size,) = _SIZE.unpack_from(body, start)
    start += _SIZE.size
    return _Packed(size, checksum, name, body[start : start + data_size], data_size)


def _mistake(packed: _Packed, content: bytes) -> str | None:
    if len(content) != packed.size:
        return "cannot be decompressed to the size that it claims"
    if packed.checksum and zlib.crc32(content) != packed.checksum:
        return "has a wrong checksum"
    return None


def _decompress(packed: _Packed, data: bytes) -> bytes:
    pieces: list[bytes] = []
    size = 0
    try:
        for piece in _UNPACKERS[packed.compression](data):
            pieces.append(piece)
            size += len(piece)
            if size > packed.size:
                break
    except (zstandard.ZstdError, RuntimeError):  # lz4 has no error of its own
        pass
    return b"".join(pieces)


def _plain(data: bytes) -> Iterator[bytes]:
    yield data


def _zstd(data: bytes) -> Iterator[bytes]:
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    for start in range(0, len(data), _ZSTD_STEP):
        if decompressor.eof:
            return
        yield decompressor.decompress(data[start : start + _ZSTD_STEP])


def _lz4(data: bytes) -> Iterator[bytes]:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    while not decompressor.eof:
        piece = decompressor.decompress(data, max_length=_LZ4_PIECE)
        data = b""
        if not piece and decompressor.needs_input:
            return
        yield piece


_UNPACKERS = {"": _plain, "zstd": _zstd, "lz4": _lz4}
