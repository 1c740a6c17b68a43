"""The frame of each camera that is nearest to an instant."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive.nearest_frames import (
    FARTHEST,
    FEWEST,
    Arrival,
    Camera,
    CameraClock,
    CameraFrame,
    Cameras,
    LowestDelay,
)
from madrob_console.messages.codec import DEFAULT_MAPPINGS, header_stamp
from recorder.bag import RawMessage, evidence_file_name
from tests.madrob_console.archive.frames import NS, compressed, film, span, stream
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


BEGIN = 1_700_000_000.0


def arrivals(
    count: int,
    rate: float,
    *,
    ahead: float,
    jitter: float,
    seed: int,
    delay: float = 0.002,
    gain: float = 0.0,
) -> Iterator[Arrival]:
    """Messages of a clock that is `ahead` and gains `gain` s/s."""
    random = Random(seed)
    for number in range(count):
        sent = BEGIN + number / rate
        stamp = sent + ahead + gain * (sent - BEGIN)
        held_up = random.expovariate(1 / jitter) if jitter else 0.0
        yield Arrival(stamp, sent + delay + held_up)


offsets = st.floats(-7200, 7200)
jitters = st.floats(0, 0.03)


@given(offset=offsets, ahead=offsets, one=jitters, two=jitters, seed=st.integers(0, 10**6))
@settings(max_examples=200, deadline=None)
def test_a_known_offset_is_found_within_what_is_said_of_it(
    offset: float, ahead: float, one: float, two: float, seed: int
) -> None:
    camera = LowestDelay(arrivals(300, 15, ahead=ahead + offset, jitter=one, seed=seed))
    testbed = LowestDelay(arrivals(1000, 50, ahead=ahead, jitter=two, seed=seed + 1))
    clock = CameraClock(camera, testbed)
    at = BEGIN + 10
    assert abs(clock.offset(at) - offset) <= clock.spread(at)
    assert clock.spread(at) <= 0.0002 + 0.4 * (one + two)
    assert clock.camera.steps == 0


@given(
    gain=st.floats(1e-4, 2e-3) | st.floats(-2e-3, -1e-4),
    jitter=st.floats(0, 0.005),
    seed=st.integers(0, 10**6),
)
@settings(max_examples=60, deadline=None)
def test_a_clock_that_gains_is_told_and_followed(gain: float, jitter: float, seed: int) -> None:
    ahead = 0.5
    camera = LowestDelay(arrivals(1800, 15, ahead=ahead, jitter=jitter, seed=seed, gain=gain))
    testbed = LowestDelay(arrivals(6000, 50, ahead=0, jitter=0.001, seed=seed))
    clock = CameraClock(camera, testbed)
    assert clock.drift == pytest.approx(gain, rel=0.25, abs=2e-5)
    for since in (0.0, 60.0, 119.0):
        truth = ahead + gain * since
        assert clock.offset(BEGIN + since) == pytest.approx(truth, abs=0.004)
    assert f"gains {60000 * clock.drift:+.1f} ms a minute" in clock.words(BEGIN)


def test_a_steady_clock_is_not_said_to_drift() -> None:
    for seed in range(50):
        delay = LowestDelay(arrivals(1800, 15, ahead=3, jitter=0.01, seed=seed))
        assert delay.drift == 0.0


def test_a_clock_that_is_stepped_has_an_offset_before_and_after_it() -> None:
    before = list(arrivals(300, 15, ahead=0.1, jitter=0.003, seed=1))
    after = [Arrival(a.stamp + 2.0 + 20.0, a.log + 20.0) for a in before]
    camera = LowestDelay([*before, *after])
    testbed = LowestDelay(arrivals(2000, 50, ahead=0, jitter=0.001, seed=2))
    clock = CameraClock(camera, testbed)
    assert clock.offset(BEGIN + 5) == pytest.approx(0.1, abs=0.002)
    assert clock.offset(BEGIN + 30) == pytest.approx(2.1, abs=0.002)
    assert camera.steps == 1
    assert "stepped once during the recording" in clock.words(BEGIN)


def test_wrong_stamps_now_and_then_are_no_step_and_move_nothing() -> None:
    good = list(arrivals(600, 15, ahead=0.1, jitter=0.003, seed=3))
    wrong = [a._replace(stamp=a.stamp - 500) if n % 40 == 7 else a for n, a in enumerate(good)]
    delay = LowestDelay(wrong)
    assert delay.steps == 0
    assert delay.at(BEGIN) == pytest.approx(LowestDelay(good).at(BEGIN), abs=0.001)


def test_frames_that_come_in_bursts_after_a_hold_up_move_nothing() -> None:
    good = list(arrivals(600, 15, ahead=0.0, jitter=0.002, seed=4))
    held = [
        a._replace(log=max(a.log, BEGIN + 22.0)) if 20 <= a.log - BEGIN < 22 else a for a in good
    ]
    assert LowestDelay(held).at(BEGIN) == pytest.approx(LowestDelay(good).at(BEGIN), abs=0.001)


def test_a_constant_delay_looks_like_a_clock_that_is_behind() -> None:
    camera = LowestDelay(arrivals(300, 15, ahead=0.0, jitter=0.001, seed=5, delay=0.102))
    testbed = LowestDelay(arrivals(1000, 50, ahead=0.0, jitter=0.001, seed=6, delay=0.002))
    assert CameraClock(camera, testbed).offset(BEGIN) == pytest.approx(-0.1, abs=0.001)


def test_the_words_say_offset_and_spread() -> None:
    camera = LowestDelay(arrivals(300, 15, ahead=0.132, jitter=0.0, seed=7))
    testbed = LowestDelay(arrivals(300, 15, ahead=0.0, jitter=0.0, seed=8))
    words = CameraClock(camera, testbed).words(BEGIN)
    assert words == "camera clock +0.132 s +- 0.000 s against the testbed's"


def test_too_few_messages_tell_nothing() -> None:
    with pytest.raises(ValueError, match="4 messages"):
        LowestDelay([Arrival(BEGIN, BEGIN)] * (FEWEST - 1))


numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12)


@given(st.lists(st.builds(Arrival, numbers, numbers), min_size=FEWEST, max_size=80), numbers)
@settings(max_examples=200, deadline=None)
def test_any_stamps_at_all_give_numbers(found: list[Arrival], at: float) -> None:
    delay = LowestDelay(found)
    assert delay.at(at) == delay.at(at)
    assert delay.spread(at) > 0
