"""The camera frame nearest to an instant, by the times of reception."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Self

from madrob_console.common.clock import nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import HEAD, TopicMapping, begins_with_header, header_stamp
from madrob_console.messages.message_types import types_of
from recorder.bag import RawMessage, Topic, is_evidence
from recorder.errors import RecorderError
from recorder.seeking import Found, Seeker
from scoring.protocol import Signal

PICTURE_TYPES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")

FARTHEST = 1.0
"""The largest distance of a frame from its instant, s."""

MOST_CAMERAS = 16
"""Of more cameras, the first by name are used."""

_STAMPS_LOOKED_AT = 100
_LATEST = 2**62  # ns: what lies behind is no time


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """A picture that was found, and not read yet; received `difference` s after the instant."""

    found: Found
    difference: float

    @property
    def log(self) -> float:
        """When it was received, s since the epoch."""
        return seconds(self.found.log_ns)


def has_evidence(folder: Path) -> bool:
    try:
        return any(is_evidence(item.name) for item in folder.iterdir())
    except OSError:
        return False


class Cameras:
    """The cameras of a run's evidence, open to look for frames; a context manager.

    The topics of `mappings` carry the testbed's signals, whose clock is that of all events.
    """

    def __init__(
        self,
        folder: Path,
        mappings: Sequence[TopicMapping],
        wanted: Callable[[str], bool] = lambda _topic: True,
    ) -> None:
        with ExitStack() as undo:
            try:
                self._frames = undo.enter_context(Seeker(folder, evidence=True))
                self.problems = list(self._frames.problems)
                self._delay = _delay_of_testbed(folder, mappings)
            except RecorderError as error:
                raise MadrobError(str(error)) from None
            self.topics = self._found_cameras(wanted)
            self._open = undo.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._open.close()

    def log_time(self, time: float) -> float:
        """The log time of an instant by the testbed's clock, both in s since the epoch."""
        return time + self._delay

    def nearest(self, camera: Topic, log: float) -> CameraFrame | None:
        """The frame received nearest to a log time, s since the epoch.

        None where none is within `FARTHEST`. Raises RecorderError where it cannot be read.
        """
        begin, end = log - FARTHEST, log + FARTHEST
        if not 0 <= begin < end < seconds(_LATEST):
            return None
        there = self._frames.between(camera.name, nanoseconds(begin), nanoseconds(end))
        frames = (CameraFrame(found, seconds(found.log_ns) - log) for found in there)
        return min(frames, key=lambda frame: abs(frame.difference), default=None)

    def message(self, frame: CameraFrame, limit: int) -> RawMessage:
        """RecorderError if it cannot be read, or has more than `limit` bytes."""
        return self._frames.message(frame.found, limit)

    def _found_cameras(self, wanted: Callable[[str], bool]) -> tuple[Topic, ...]:
        topics = sorted(
            (t for t in self._frames.topics() if t.type in PICTURE_TYPES and wanted(t.name)),
            key=lambda topic: topic.name,
        )
        if len(topics) > MOST_CAMERAS:
            self.problems.append(f"{len(topics)} cameras: {MOST_CAMERAS} are shown")
        return tuple(topics[:MOST_CAMERAS])


def _delay_of_testbed(folder: Path, mappings: Sequence[TopicMapping]) -> float:
    """Log time less stamp, s; 0 without stamps.

    From the door, the source of most events, else the first signal with stamps. Its first messages
    tell it: what is stamped after a step of the clock is scored as if there had been none.
    """
    with Seeker(folder) as recording:
        topics = {topic.name: topic for topic in recording.topics()}
        for mapping in sorted(mappings, key=lambda one: one.signal is not Signal.DOOR):
            topic = topics.get(mapping.topic)
            if topic is not None and _is_stamped(topic):
                delays = _first_delays(recording, topic.name)
                if delays:
                    return median(delays)
    return 0.0


def _is_stamped(topic: Topic) -> bool:
    try:
        return begins_with_header(types_of([topic]), topic.type)
    except MadrobError:  # nobody knows its type
        return False


def _first_delays(recording: Seeker, name: str) -> list[float]:
    delays = []
    for one in recording.first(name)[:_STAMPS_LOOKED_AT]:
        with suppress(RecorderError):
            stamp = header_stamp(recording.head(one, HEAD))
            if stamp is not None:
                delays.append(seconds(one.log_ns) - stamp)
    return delays


SIDE = 960
"""The most pixels in a row and in a column of a picture that is kept."""
