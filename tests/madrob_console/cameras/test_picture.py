"""Messages of cameras as small pictures, and messages that hold none."""

from __future__ import annotations

import io
import math
import struct
import tracemalloc
import zlib
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from madrob_console.cameras import SIDE
from madrob_console.cameras.picture import (
    MOST_BYTES,
    MOST_MESSAGE,
    PictureError,
    decoded,
    jpeg,
    opened,
)
from recorder.message import RawMessage
from tests.madrob_console.cameras.frames import COMPRESSED, RAW, compressed, packed, pattern, raw


def seen(message: RawMessage) -> Image.Image:
    return decoded(message).picture


def message(data: bytes, told: str = "jpeg") -> RawMessage:
    return compressed("/camera", data, 1.0, 1.0, told)


COLOURS = (
    np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [250, 250, 250]]], dtype=np.uint8)
    .repeat(8, axis=0)
    .repeat(8, axis=1)
)
"""Squares of red, green, blue and white, of 8 x 8 pixels each."""


def corners(picture: Image.Image) -> list[tuple[int, ...]]:
    pixels = np.asarray(picture.convert("RGB").resize((16, 16)))
    return [tuple(map(int, pixels[y, x])) for y in (4, 12) for x in (4, 12)]


def assert_shown(picture: Image.Image) -> None:
    for seen, meant in zip(corners(picture), [(255, 0, 0), (0, 255, 0), (0, 0, 255)], strict=False):
        assert max(abs(a - b) for a, b in zip(seen, meant, strict=True)) < 40


def _opaque(pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> bytes:
    return np.dstack([pixels, np.full(pixels.shape[:2], 7, np.uint8)]).tobytes()


def _mosaic(pattern_name: str) -> bytes:
    channel = {"r": 0, "g": 1, "b": 2}
    made = np.zeros(COLOURS.shape[:2], np.uint8)
    for place, colour in enumerate(pattern_name):
        y, x = divmod(place, 2)
        made[y::2, x::2] = COLOURS[y::2, x::2, channel[colour]]
    return made.tobytes()


def _yuv(order: str) -> bytes:
    whole = np.asarray(Image.fromarray(COLOURS).convert("YCbCr"))
    first, second = whole[:, 0::2], whole[:, 1::2]
    parts = {"y": first[..., 0], "u": first[..., 1], "v": first[..., 2], "Y": second[..., 0]}
    return np.dstack([parts[name] for name in order]).tobytes()


@pytest.mark.parametrize(
    ("encoding", "size", "data"),
    [
        ("rgb8", 3, COLOURS.tobytes()),
        ("bgr8", 3, COLOURS[..., ::-1].tobytes()),
        ("8UC3", 3, COLOURS[..., ::-1].tobytes()),
        ("rgba8", 4, _opaque(COLOURS)),
        ("bgra8", 4, _opaque(COLOURS[..., ::-1])),
        ("yuv422", 2, _yuv("uyvY")),
        ("uyvy", 2, _yuv("uyvY")),
        ("yuv422_yuy2", 2, _yuv("yuYv")),
        ("yuyv", 2, _yuv("yuYv")),
        *((f"bayer_{name}8", 1, _mosaic(name)) for name in ("rggb", "bggr", "gbrg", "grbg")),
    ],
)
def test_raw_pictures_have_their_colours(encoding: str, size: int, data: bytes) -> None:
    assert_shown(seen(raw(data, encoding, 16, 16, 16 * size)))


@pytest.mark.parametrize("big", [False, True])
def test_grey_of_two_bytes_is_stretched_to_the_brightest(*, big: bool) -> None:
    values = np.array([[0, 1000], [2000, 4000]], dtype=">u2" if big else "<u2")
    picture = seen(raw(values.tobytes(), "mono16", 2, 2, 4, big=big))
    assert np.asarray(picture).ravel().tolist() == [0, 63, 127, 255]


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("encoding", "number", "depths", "grey", "words"),
    [
        ("32FC1", "f4", [0.4, 1.0, 2.5, 6.1], [40, 63, 119, 255], "depth 0.4 to 6.1 m"),
        (
            "32FC1",
            "f4",
            [math.nan, math.inf, -math.inf, 2.5],
            [0, 0, 0, 40],
            "depth 2.5 to 2.5 m, black: none",
        ),
        ("32FC1", "f4", [-3e38, 0.0, 0.0, 3e38], [40, 148, 148, 255], "depth -3e+38 to 3e+38 m"),
        ("16UC1", "u2", [0, 400, 3250, 6100], [0, 40, 148, 255], "depth 0.4 to 6.1 m, black: none"),
    ],
)
def test_depth_is_grey_from_the_nearest_to_the_farthest_and_says_which(
    *, encoding: str, number: str, depths: list[float], grey: list[int], words: str, big: bool
) -> None:
    values = np.array(depths, dtype=f"{'>' if big else '<'}{number}")
    step = 2 * values.itemsize + 3  # a row may be longer than its pixels
    rows = b"".join(pair.tobytes() + b"\xff\xff\xff" for pair in (values[:2], values[2:]))
    picture, scale = decoded(raw(rows, encoding, 2, 2, step, big=big))
    assert np.asarray(picture).ravel().tolist() == pytest.approx(grey, abs=1)
    assert scale == words


def test_a_large_depth_image_takes_no_more_than_a_picture_does() -> None:
    side = 2800  # as many as a message holds
    depths = np.linspace(0.5, 9.0, side * side, dtype="<f4").reshape(side, side)
    tracemalloc.start()
    picture, scale = decoded(raw(depths.tobytes(), "32FC1", side, side, 4 * side))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (picture.size, scale) == ((SIDE, SIDE), "depth 0.5 to 9 m")
    assert most < 6 * depths.nbytes


def test_grey_of_one_byte_is_as_it_is() -> None:
    assert np.asarray(seen(raw(bytes([1, 2, 3, 4]), "mono8", 2, 2, 2))).ravel().tolist() == [
        1,
        2,
        3,
        4,
    ]


def test_rows_may_be_longer_than_their_pixels() -> None:
    rows = np.zeros((16, 64), np.uint8)
    rows[:, :48] = COLOURS.reshape(16, 48)
    assert_shown(seen(raw(rows.tobytes(), "rgb8", 16, 16, 64)))


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
@pytest.mark.parametrize("told", ["jpeg", "png", "bgr8; jpeg compressed bgr8", "", "\x1b[2Jlie"])
def test_what_a_compressed_picture_is_its_bytes_say(kind: str, told: str) -> None:
    picture = seen(message(packed(pattern(3), kind), told))
    assert picture.size == (160, 120)
    assert picture.mode == "RGB"


def test_a_large_picture_is_made_small() -> None:
    picture = seen(message(packed(Image.effect_noise((3000, 2000), 90))))
    assert picture.size == (SIDE, SIDE * 2 // 3)
    made = jpeg(picture)
    assert len(made.data) <= MOST_BYTES
    assert opened(made.data).size == (made.width, made.height)


def test_a_file_has_as_many_bytes_as_it_may_whatever_is_in_it() -> None:
    noise = Image.effect_noise((960, 960), 255)
    for most in (100_000, 20_000, 1000):
        assert len(jpeg(noise, most).data) <= most
    with pytest.raises(PictureError, match="smaller than 10 bytes"):
        jpeg(noise, 10)


def test_nothing_of_a_file_is_passed_on_but_the_picture() -> None:
    file = io.BytesIO()
    exif = Image.Exif()
    exif[0x010E] = "SECRET"
    pattern(1).save(file, "JPEG", comment=b"SECRET", exif=exif)
    assert file.getvalue().count(b"SECRET") == 2
    assert b"SECRET" not in jpeg(seen(message(file.getvalue()))).data


def _png(width: int, height: int, data: bytes = b"") -> bytes:
    """A PNG that claims a size, whatever is in it."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _scans(count: int) -> bytes:
    file = io.BytesIO()
    pattern(1).save(file, "JPEG", progressive=True)
    data = file.getvalue()
    last = data.rindex(b"\xff\xda")
    return data[:last] + data[last:-2] * count + data[-2:]


HOSTILE: dict[str, tuple[RawMessage, str]] = {
    "empty": (message(b""), "it is empty"),
    "text": (message(b"no picture at all"), "neither JPEG nor PNG"),
    "another format": (message(packed(pattern(1), "BMP")), "neither JPEG nor PNG"),
    "cut": (message(packed(pattern(1))[:900]), "cannot be decoded"),
    "cut png": (message(packed(pattern(1), "PNG")[:300]), "cannot be decoded"),
    "bomb": (message(_png(30_000, 30_000, zlib.compress(bytes(10**6)))), "megapixels"),
    "large": (message(_png(8000, 8000)), "claims 8000 x 8000 pixels, more than 24 megapixels"),
    "long": (message(_png(1_000_000, 1)), "more than 24 megapixels"),
    "lies": (message(_png(4000, 4000, zlib.compress(bytes(100)))), "cannot be decoded"),
    "unpacks without end": (message(_png(10, 10, zlib.compress(bytes(10**8)))), ""),
    "scans": (message(_scans(150)), "more than 100 scans"),
    "no such encoding": (raw(bytes(4), "\x1b[2Jrgb", 1, 1, 3), "the encoding"),
    "another encoding": (raw(bytes(4), "32SC1", 1, 1, 4), "the encoding 32SC1 is not shown"),
    "no depth": (raw(b"\x00\x00\xc0\x7f", "32FC1", 1, 1, 4), "no pixel of it has a depth"),
    "no depth in mm": (raw(bytes(8), "16UC1", 2, 2, 4), "no pixel of it has a depth"),
    "depth too short": (raw(bytes(10), "32FC1", 100, 100, 400), "not in its 10 bytes"),
    "depth claims": (raw(bytes(4), "32FC1", 30_000, 30_000, 120_000), "megapixels"),
    "too short": (raw(bytes(10), "rgb8", 100, 100, 300), "not in its 10 bytes"),
    "rows too short": (raw(bytes(30_000), "rgb8", 100, 100, 3), "in rows of 3 bytes"),
    "claims": (raw(bytes(10), "rgb8", 2**32 - 1, 2**32 - 1, 2**32 - 1), "megapixels"),
    "nothing": (raw(b"", "rgb8", 0, 0, 0), "claims 0 x 0 pixels"),
    "half a pair": (raw(bytes(6), "uyvy", 3, 1, 6), "odd number of pixels"),
    "half a square": (raw(bytes(1), "bayer_rggb8", 1, 1, 1), "smaller than one square"),
    "large message": (message(bytes(MOST_MESSAGE + 1)), "32 MB, more than 32 MB"),
    "not of its type": (
        RawMessage("/c", COMPRESSED, b"\x00\x01\x00\x00\xff", 1, 1),
        "its bytes are no sensor_msgs",
    ),
    "another type": (RawMessage("/c", "std_msgs/msg/String", b"", 1, 1), "it is a std_msgs/msg/St"),
    "no message": (RawMessage("/c", RAW, b"", 1, 1), "its bytes are no sensor_msgs"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_picture_that_lies_is_named_in_one_line(name: str) -> None:
    sent, why = HOSTILE[name]
    if not why:  # what it claims is there, and nothing of the rest is unpacked
        assert seen(sent).size == (10, 10)
        return
    with pytest.raises(PictureError) as caught:
        seen(sent)
    told = str(caught.value)
    assert why in told
    assert told.isprintable()
    assert len(told) < 200


def _changed(data: bytes) -> st.SearchStrategy[bytes]:
    def change(found: tuple[int, bytes, int]) -> bytes:
        at, new, cut = found
        return (data[:at] + new + data[at + len(new) :])[: len(data) - cut]

    places = st.integers(0, len(data) - 1)
    return st.tuples(places, st.binary(max_size=8), st.integers(0, len(data) // 2)).map(change)


pictures = st.one_of(
    _changed(packed(pattern(1))),
    _changed(packed(pattern(1), "PNG")),
    st.binary(max_size=200),
)


@given(pictures, st.text(max_size=20))
@settings(max_examples=200, deadline=None)
def test_whatever_bytes_come_there_is_a_small_picture_or_one_line(data: bytes, told: str) -> None:
    _small_or_told(lambda: seen(message(data, told.replace("\0", ""))))


sizes = st.integers(0, 40) | st.integers(0, 2**32 - 1)


@given(
    st.binary(max_size=400),
    st.sampled_from(
        [
            *("rgb8", "mono16", "bayer_rggb8", "bayer_gbrg16", "uyvy", "yuyv", "bgra8"),
            *("32FC1", "16UC1", "?"),
        ]
    ),
    sizes,
    sizes,
    sizes,
    st.booleans(),
)
@settings(max_examples=300, deadline=None)
def test_whatever_a_raw_picture_claims_there_is_a_small_picture_or_one_line(
    data: bytes, encoding: str, width: int, height: int, step: int, big: bool
) -> None:
    _small_or_told(lambda: seen(raw(data, encoding, width, height, step, big=big)))


@given(st.binary(max_size=300), st.sampled_from([COMPRESSED, RAW]))
@settings(max_examples=200, deadline=None)
def test_whatever_a_message_is_there_is_a_small_picture_or_one_line(data: bytes, kind: str) -> None:
    _small_or_told(lambda: seen(RawMessage("/c", kind, b"\x00\x01\x00\x00" + data, 1, 1)))


def _small_or_told(make: Callable[[], Image.Image]) -> None:
    try:
        picture = make()
    except PictureError as error:
        said = str(error)
    else:
        said = "a picture"
        assert max(picture.size) <= SIDE
        assert len(jpeg(picture).data) <= MOST_BYTES
    assert said.isprintable()
