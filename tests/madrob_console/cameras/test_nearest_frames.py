"""The frame of each camera that is nearest to an instant."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.cameras.nearest_frames import FARTHEST, Camera, CameraFrame, Cameras
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.messages.header_stamp import header_stamp
from recorder.bag import evidence_file_name
from recorder.message import RawMessage
from tests.madrob_console.cameras.frames import NS, compressed, film, span, stream
from tests.madrob_console.recorded_runs import completed
from tests.recorder.samples import add_evidence, strings

FRONT, SIDE = "/camera/front/image/compressed", "/camera/side"
OFFSET = 0.132


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run without evidence that a test may change."""
    return Path(shutil.copytree(completed(), tmp_path / completed().name))


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filmed") / completed().name
    shutil.copytree(completed(), folder)
    film(folder, FRONT, SIDE, offset=OFFSET)
    return folder


@contextmanager
def cameras(folder: Path) -> Iterator[Cameras]:
    with Cameras(folder, DEFAULT_MAPPINGS) as found:
        yield found


def only(found: Cameras) -> Camera:
    (camera,) = found.cameras
    return camera


def nearest(found: Cameras, time: float) -> CameraFrame:
    frame = found.nearest(found.cameras[0], time)
    assert frame is not None
    return frame


def test_no_other_frame_is_nearer_by_the_testbed_s_clock(filmed: Path) -> None:
    begin, end = span(filmed)
    stamps = {
        topic: [header_stamp(one.data) for one in stream(topic, begin, end)]
        for topic in (FRONT, SIDE)
    }

    @given(part=st.floats(0, 1))
    def none_is_nearer(found: Cameras, part: float) -> None:
        time = begin + part * (end - begin)
        for camera in found.cameras:
            frame = found.nearest(camera, time)
            assert frame is not None
            assert frame.stamp is not None
            assert camera.clock is not None
            offset = camera.clock.offset(frame.log)
            assert offset == pytest.approx(OFFSET, abs=0.006)
            sent = stamps[camera.topic]
            best = min((stamp - offset - time for stamp in sent if stamp is not None), key=abs)
            assert frame.difference == pytest.approx(best, abs=2e-6)

    with cameras(filmed) as found:
        none_is_nearer(found)


def test_what_is_said_of_the_clock_stands_beside_the_frame(filmed: Path) -> None:
    with cameras(filmed) as found:
        words = nearest(found, span(filmed)[0] + 5).clock_words
    assert words.startswith("camera clock +0.1")
    assert words.endswith("s against the testbed's")


def test_a_frame_that_is_too_far_is_not_that_instant_s(filmed: Path) -> None:
    begin, end = span(filmed)
    with cameras(filmed) as found:
        camera = found.cameras[0]
        assert found.nearest(camera, begin - FARTHEST - 0.5) is None
        assert found.nearest(camera, end + FARTHEST + 0.5) is None
        for time in (float("nan"), float("inf"), -1e300, 0.0, 1e12):
            assert found.nearest(camera, time) is None


def _changed(messages: list[RawMessage], stamp: float) -> list[RawMessage]:
    return [compressed(m.topic, b"no picture", stamp, m.receive_ns / NS) for m in messages]


def test_frames_without_a_stamp_are_found_by_their_reception(run: Path) -> None:
    begin, end = span(run)
    sent = _changed(stream(FRONT, begin, end), stamp=0.0)
    add_evidence(run, sent)
    with cameras(run) as found:
        time = begin + 7.0
        frame = nearest(found, time)
        logged = time + (time - found.of_testbed(time))
        best = min((m.receive_ns / NS - logged for m in sent), key=abs)
        assert frame.stamp is None
        assert frame.difference == pytest.approx(best, abs=1e-5)
        assert "time of reception" in frame.clock_words


def test_a_camera_whose_clock_is_years_away_is_found(run: Path) -> None:
    film(run, FRONT, offset=-1_600_000_000.0)
    with cameras(run) as found:
        assert abs(nearest(found, span(run)[0] + 5).difference) < 0.04


def test_a_camera_that_stops_and_comes_again_is_found_on_both_sides(run: Path) -> None:
    begin, end = span(run)
    sent = [m for m in stream(FRONT, begin, end) if not 5 < m.receive_ns / NS - begin < 9]
    add_evidence(run, sent)
    with cameras(run) as found:
        assert nearest(found, begin + 5.5).difference < -0.4
        assert found.nearest(only(found), begin + 7) is None
        assert nearest(found, begin + 8.5).difference > 0.4


def test_evidence_that_is_torn_gives_the_frames_before_it(run: Path) -> None:
    begin, end = span(run)
    file = add_evidence(run, stream(FRONT, begin, end, size=(1280, 960)))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with cameras(run) as found:
        assert abs(nearest(found, begin + 2).difference) < 0.04
        assert found.nearest(only(found), end - 1) is None
        assert "was not finished" in found.problems[0]


def test_what_is_no_recording_and_what_is_no_camera_is_passed_over(run: Path) -> None:
    (run / evidence_file_name(run.name, 0)).write_bytes(b"garbage")
    add_evidence(run, strings(["a", "b"]), number=1)
    begin, end = span(run)
    add_evidence(run, stream(SIDE, begin, end), number=2)
    with cameras(run) as found:
        assert [camera.topic for camera in found.cameras] == [SIDE]
        assert "does not begin like an MCAP file" in found.problems[0]


def test_without_a_testbed_s_stamp_the_log_times_are_the_clock(run: Path) -> None:
    film(run, FRONT)
    with Cameras(run, ()) as found:
        frame = nearest(found, span(run)[0] + 5)
        assert frame.camera.clock is None
        assert "time of reception" in frame.clock_words
