"""A message of a camera as a small picture. Loads Pillow: import it where pictures are made.

Whatever a message says of itself may be wrong: what would take more memory or time than a picture
does is refused before it is decoded.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
from collections.abc import Callable
from dataclasses import dataclass

from PIL import Image, UnidentifiedImageError

from madrob_console.archive.nearest_frames import PICTURE_TYPES, SIDE
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.messages.types import Message, MessageError, standard_types
from recorder.bag import RawMessage

MOST_MESSAGE = 32_000_000
"""The most bytes of a message."""

MOST_PIXELS = 24_000_000
"""The most pixels of a picture before it is made small: 6000 x 4000."""

MOST_BYTES = 200_000
"""The most bytes of a small picture."""

_PACKED, _RAW = PICTURE_TYPES
_LONGEST = 16_384  # pixels in a row or a column
_MOST_SCANS = 100  # a picture is sent in ten at most; each costs as much as all of it
_SCAN = b"\xff\xda"
_JPEG, _PNG = b"\xff\xd8", b"\x89PNG\r\n\x1a\n"
_PNG_HEAD = struct.Struct(">16x2I")  # signature, begin of the chunk IHDR; width, height
_QUALITIES = (85, 70, 50, 30, 15)
_SHOWN = 40
_PLAIN_NAME = re.compile(r"[0-9A-Za-z_]{1,40}")


class PictureError(MadrobError):
    """A message without a picture that can be shown; the text is one line."""


def decoded(message: RawMessage, side: int = SIDE) -> Image.Image:
    """The picture in a camera message, RGB or grey, at most `side` pixels wide and high.

    `message` is a `sensor_msgs/msg/CompressedImage` (JPEG or PNG, whatever it claims) or a
    `sensor_msgs/msg/Image`. Raises PictureError where none can be shown.
    """
    if len(message.data) > MOST_MESSAGE:
        raise PictureError(f"it has {len(message.data) / 1e6:.0f} MB, more than 32 MB")
    if message.type not in (_PACKED, _RAW):
        raise PictureError(f"it is a {terminal_safe(message.type)[:_SHOWN]}, no picture")
    try:
        content = standard_types().decode(message.type, message.data)
    except MessageError:
        raise PictureError(f"its bytes are no {message.type}") from None
    if message.type == _PACKED:
        return _small(lambda: _unpacked(bytes(content.data), side), side)
    return _small(lambda: _raw(content), side)


def opened(data: bytes, side: int = SIDE) -> Image.Image:
    """A JPEG that was kept, as `decoded` makes it."""
    return _small(lambda: _unpacked(data, side), side)


def _small(decode: Callable[[], Image.Image], side: int) -> Image.Image:
    try:
        picture = decode()
        picture.thumbnail((side, side), Image.Resampling.BILINEAR, reducing_gap=2.0)
    except PictureError:
        raise
    except MemoryError:
        raise PictureError("no memory to decode it: end other programs") from None
    except Exception as error:  # noqa: BLE001  damaged pictures raise what they like
        words = terminal_safe(str(error))[:100] or type(error).__name__
        raise PictureError(f"it cannot be decoded ({words})") from None
    picture.info.clear()  # comments, profiles
    return picture


@dataclass(frozen=True, slots=True)
class Jpeg:
    """A JPEG file with its size in pixels."""

    data: bytes
    width: int
    height: int


def jpeg(picture: Image.Image, most: int = MOST_BYTES) -> Jpeg:
    """The best JPEG of at most `most` bytes, else PictureError."""
    while True:
        for quality in _QUALITIES:
            file = io.BytesIO()
            picture.save(file, "JPEG", quality=quality, optimize=True)
            if file.tell() <= most:
                return Jpeg(file.getvalue(), *picture.size)
        half = max(1, picture.width // 2), max(1, picture.height // 2)
        if half == picture.size:
            raise PictureError(f"it cannot be made smaller than {most} bytes")
        picture = picture.resize(half)


def _unpacked(data: bytes, side: int) -> Image.Image:
    if not data:
        raise PictureError("it is empty")
    if data.count(_SCAN) > _MOST_SCANS and data.startswith(_JPEG):
        raise PictureError(f"it is a JPEG of more than {_MOST_SCANS} scans")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            picture = Image.open(io.BytesIO(data), formats=("JPEG", "PNG"))
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        _check_png_head(data)
        raise PictureError(f"it claims more than {MOST_PIXELS // 1_000_000} megapixels") from None
    except UnidentifiedImageError:
        _check_png_head(data)
        raise PictureError(f"it is {_damaged(data)}") from None
    _check_size(*picture.size)
    picture.draft("RGB", (side, side))  # a large JPEG is decoded small
    picture.load()
    if picture.mode.startswith(("I", "F")):
        raise PictureError("16 bits of grey are not shown")
    has_colour = picture.mode not in ("1", "L", "LA")
    return picture.convert("RGB" if has_colour else "L")


def _check_png_head(data: bytes) -> None:
    """Refuse a PNG that claims too many pixels, or none."""
    if data.startswith(_PNG) and len(data) >= _PNG_HEAD.size:
        _check_size(*_PNG_HEAD.unpack_from(data))


def _damaged(data: bytes) -> str:
    if data.startswith(_PNG):
        return "a damaged PNG"
    return "a damaged JPEG" if data.startswith(_JPEG) else "neither JPEG nor PNG"


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise PictureError(f"it claims {width} x {height} pixels")
    if width * height > MOST_PIXELS or max(width, height) > _LONGEST:
        most = MOST_PIXELS // 1_000_000
        raise PictureError(f"it claims {width} x {height} pixels, more than {most} megapixels")


def _raw(message: Message) -> Image.Image:
    width, height, step = int(message.width), int(message.height), int(message.step)
    _check_size(width, height)
    encoding = str(message.encoding)
    if encoding not in _ENCODINGS:
        name = encoding if _PLAIN_NAME.fullmatch(encoding) else repr(encoding[:_SHOWN])
        raise PictureError(f"the encoding {terminal_safe(name)} is not shown")
    size, raw_mode = _ENCODINGS[encoding]
    if step < width * size or step * height > len(message.data):
        raise PictureError(
            f"{width} x {height} pixels of {encoding} in rows of {step} bytes are not in its "
            f"{len(message.data)} bytes"
        )
    data = bytes(message.data[: step * height])
    mode = "L" if size == 1 else "RGB"
    return Image.frombytes(mode, (width, height), data, "raw", raw_mode, step)


_ENCODINGS = {
    "rgb8": (3, "RGB"),
    "bgr8": (3, "BGR"),
    "8UC3": (3, "BGR"),
    "rgba8": (4, "RGBX"),
    "bgra8": (4, "BGRX"),
    "8UC4": (4, "BGRX"),
    "mono8": (1, "L"),
    "8UC1": (1, "L"),
}
"""By the names of `sensor_msgs/image_encodings.hpp`: bytes a pixel, Pillow's raw mode."""
