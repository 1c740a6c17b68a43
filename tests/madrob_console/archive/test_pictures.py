"""What the cameras saw, in a report and in files."""

from __future__ import annotations

import io
import re
import sys
from functools import cache
from pathlib import Path

import pytest
from PIL import Image

from madrob_console.archive.pictures import SIDE, Picture, pictures_of, write_frames
from madrob_console.archive.scored import Scored, score_opened
from madrob_console.export.zip_file import is_safe_name
from madrob_console.pages.report import report_html
from recorder import RawMessage
from tests.madrob_console.archive.frames import (
    FRONT,
    NS,
    compressed,
    film,
    packed,
    pattern,
    raw,
)
from tests.madrob_console.recorded_runs import appealed
from tests.recorder.samples import add_evidence

NEAR = 0.05
"""A frame of a camera of 15 Hz is as near, s."""


@cache
def scored() -> Scored:
    """Of that run, with evidence or without."""
    return score_opened(appealed())


def shown(run: Path, message: RawMessage) -> Picture:
    """The picture of the one frame of a camera, at the first event."""
    add_evidence(run, [message])
    return pictures_of(run, scored())[0]


def at_first_event() -> float:
    return scored().result.events[0].time


def size_of(picture: Picture) -> tuple[int, int]:
    with Image.open(io.BytesIO(picture.data)) as opened:
        return opened.size


def test_each_event_and_mark_has_the_nearest_frame_of_each_camera(filmed: Path) -> None:
    pictures = pictures_of(filmed, scored())
    events = {event.event.value for event in scored().result.events}
    assert {picture.moment.name for picture in pictures} == {*events, "incident_collision"}
    assert len({picture.topic for picture in pictures}) == 2
    assert all(abs(picture.difference) < NEAR for picture in pictures)
    assert {size_of(picture) for picture in pictures} == {(160, 120)}


def test_frame_that_is_small_enough_stays_as_it_is(run: Path) -> None:
    data = packed(pattern(1), "PNG")
    at = at_first_event() + 0.012
    picture = shown(run, compressed(FRONT, data, at, at, "png"))
    assert (picture.data, picture.file_type) == (data, "png")
    assert picture.difference_words == "+12 ms"


def test_large_frame_is_made_smaller(run: Path) -> None:
    at = at_first_event()
    data = packed(pattern(1, (2 * SIDE, SIDE)))
    picture = shown(run, compressed(FRONT, data, at, at))
    assert size_of(picture) == (SIDE, SIDE // 2)


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "mono8"])
def test_raw_frame_becomes_a_jpeg_of_its_colours(run: Path, encoding: str) -> None:
    colour = (200, 40, 90)
    pixel = {"rgb8": bytes(colour), "bgr8": bytes(colour[::-1]), "mono8": b"\x5a"}[encoding]
    at = at_first_event()
    data = pixel * (32 * 16)
    message = raw(data, encoding, 32, 16, 32 * len(pixel), log=at)
    with Image.open(io.BytesIO(shown(run, message).data)) as opened:
        found = opened.convert("RGB").getpixel((8, 8))
    expected = colour if len(pixel) == 3 else (0x5A,) * 3
    assert found == pytest.approx(expected, abs=4)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (compressed(FRONT, b"\xff\xd8 no picture", 1.0, 1.0), "it is neither JPEG nor PNG"),
        (compressed(FRONT, b"", 1.0, 1.0), "it is neither JPEG nor PNG"),
        (raw(b"x" * 8, "bayer_rggb8", 4, 2, 4), "the encoding 'bayer_rggb8' is not shown"),
        (raw(b"x" * 8, "rgb8", 40_000, 40_000, 4), "pixels are too many"),
        (raw(b"x" * 8, "rgb8", 40, 40, 4), "it cannot be shown ("),
    ],
)
def test_frame_that_cannot_be_shown_says_why(run: Path, message: RawMessage, why: str) -> None:
    at = round(at_first_event() * NS)
    data, topic, kind = message.data, message.topic, message.type
    picture = shown(run, RawMessage(topic, kind, data, at, at))
    assert picture.data == b""
    assert why in picture.problem
    assert picture.problem.isprintable()


def test_moment_without_a_frame_within_a_second_says_so(run: Path) -> None:
    film(run, FRONT)
    assert write_frames(run, "900", run / "frames") == ["no frame within 1 s"]


def test_run_without_cameras_has_no_pictures(run: Path) -> None:
    assert pictures_of(run, scored()) == []
    assert write_frames(run, "1", run / "frames") == ["no camera was recorded beside it"]
    assert not (run / "frames").exists()


def test_bag_that_cannot_be_read_takes_no_other_ones_pictures(filmed: Path) -> None:
    """A power cut leaves an empty one, and the recorder begins another."""
    whole = pictures_of(filmed, scored())
    (bag,) = filmed.glob("*_evidence")
    bag.rename(f"{bag}_2")
    bag.mkdir()
    (bag / "bag_0.mcap").touch()
    assert pictures_of(filmed, scored()) == whole


def test_where_no_evidence_can_be_read_the_frames_say_so(run: Path) -> None:
    (run / "run_evidence").mkdir()
    (run / "run_evidence" / "bag_0.mcap").touch()
    (problem,) = write_frames(run, "1", run / "frames")
    assert problem.endswith("bag_0.mcap: it is empty; it is left out")


def test_frames_have_names_that_a_zip_takes(run: Path) -> None:
    film(run, f"{FRONT}/left", f"{FRONT}/right")
    assert write_frames(run, "-0.25", run / "frames") == []
    names = [item.name for item in (run / "frames").iterdir()]
    assert len(names) == 2
    for name in names:
        assert is_safe_name(name)
        assert re.fullmatch(r"01_at_minus_0_250_s_.*_\d+_ms_(later|earlier)[.]jpg", name)


def test_report_has_the_pictures_in_it(filmed: Path) -> None:
    pictures = pictures_of(filmed, scored())
    page = report_html(scored(), "1", shown=pictures)
    assert page.count('<img src="data:image/jpeg;base64,') == len(pictures)
    assert '<a href="#moment-1"' in page


def test_without_pillow_the_report_says_what_to_install(
    filmed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    problems = {picture.problem for picture in pictures_of(filmed, scored())}
    assert len(problems) == 1
    assert "need Pillow: install madrob-console with its extra `report`" in problems.pop()
