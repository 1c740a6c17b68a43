"""The frame of each camera that is nearest to an instant."""

from __future__ import annotations

import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.nearest_frames import FARTHEST, Cameras
from madrob_console.common.clock import seconds
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from recorder.writer import BagWriter
from tests.madrob_console.archive.frames import (
    FRONT,
    NS,
    SIDE_CAMERA,
    film,
    span,
    stream,
)
from tests.recorder.samples import (
    START_NS,
    add_evidence,
    door_messages,
    door_topics,
    encode,
)


def cameras(folder: Path) -> Cameras:
    return Cameras(folder, DEFAULT_MAPPINGS)


def apart(found: Cameras, time: float, camera: int = 0) -> float:
    """By how much later than an instant the nearest frame of a camera was received, s."""
    frame = found.nearest(found.topics[camera], time)
    return math.nan if frame is None else seconds(frame.receive_ns) - time


def test_no_other_frame_was_received_nearer(filmed: Path) -> None:
    begin, end = span(filmed)
    received = {
        topic: [seconds(one.receive_ns) for one in stream(topic, begin, end)]
        for topic in (FRONT, SIDE_CAMERA)
    }

    @given(part=st.floats(0, 1))
    def none_is_nearer(found: Cameras, part: float) -> None:
        time = begin + part * (end - begin)
        for number, camera in enumerate(found.topics):
            best = min((log - time for log in received[camera.name]), key=abs)
            assert apart(found, time, number) == best

    found = cameras(filmed)
    none_is_nearer(found)


def test_a_frame_that_is_too_far_is_not_that_instant_s(filmed: Path) -> None:
    begin, end = span(filmed)
    found = cameras(filmed)
    far = begin - FARTHEST - 0.5, end + FARTHEST + 0.5
    for time in (*far, float("nan"), float("inf"), -1e300, 0.0, 1e12):
        assert found.nearest(found.topics[0], time) is None


def test_evidence_that_is_torn_or_damaged_gives_the_frames_that_are_whole(run: Path) -> None:
    begin, end = span(run)
    file = add_evidence(run, stream(FRONT, begin, end, size=(1280, 960)))
    data = bytearray(file.read_bytes())
    file.write_bytes(data[: len(data) // 2])
    found = cameras(run)
    assert len(found.topics) == 1
    assert abs(apart(found, begin + 2)) < 0.04
    assert math.isnan(apart(found, end - 1))
    assert found.problems[0].endswith("what comes before that is read")
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    found = cameras(run)
    assert found.problems == []
    distances = [abs(apart(found, time)) for time in np.arange(begin, end - 0.1, 0.1)]
    assert 0.5 < np.nanmax(distances) <= FARTHEST
    assert np.nanmedian(distances) < 0.04
    assert re.search(r"_evidence_0.mcap: a chunk .* \(byte \d+\)", found.problems[0])


@pytest.mark.parametrize("step", [0.0, 2.0])
@pytest.mark.parametrize("ahead", [0.0, 3.0, -1_600_000_000.0])
def test_an_event_is_where_its_message_was_received_whatever_the_door_s_clock_says(
    ahead: float, step: float, tmp_path: Path
) -> None:
    bag = tmp_path / "run"
    with BagWriter(bag, door_topics(), {}) as writer:
        for number, message in enumerate(door_messages(1000)):
            stamp = message.publish_ns + round(NS * (ahead + step * (number > 2000)))
            data = encode(message.type, stamp, number)
            writer.put_message(msgspec.structs.replace(message, data=data, publish_ns=stamp))
    begin = seconds(START_NS)
    add_evidence(bag, stream(FRONT, begin, begin + 20))
    found = cameras(bag)
    assert found.log_time(begin + ahead + 15) == pytest.approx(begin + 15, abs=0.001)


def test_without_a_testbed_s_stamp_the_log_times_are_the_clock(run: Path) -> None:
    film(run, FRONT)
    found = Cameras(run, ())
    assert found.log_time(span(run)[0] + 5) == span(run)[0] + 5
