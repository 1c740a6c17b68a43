"""The frame of each camera that is nearest to an instant of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from madrob_console.cameras.camera_clock import FEWEST, Arrival, CameraClock, LowestDelay
from madrob_console.clock import nanoseconds, seconds
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import TopicMapping
from madrob_console.messages.header_stamp import HEAD, begins_with_header, header_stamp
from madrob_console.messages.message_types import types_of
from recorder.bag import Topic, is_evidence
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.seeking import Found, Seeker
from scoring.protocol import Signal

PICTURE_TYPES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
"""Types of messages that are pictures."""

FARTHEST = 1.0
"""A frame that is farther from an instant is not that instant's, s."""

MOST_CAMERAS = 16
"""Of more cameras the first by name are looked at."""

_HELD_UP = 2.0  # s: a frame that comes so late is still found
_CHUNKS_LOOKED_AT = 48  # for the stamps from which a clock is estimated
_STAMPS_LOOKED_AT = 2000
_LATEST = 2**62  # ns: what lies behind is no time


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A topic of pictures.

    Attributes:
        topic: its name.
        type: of its messages.
        clock: beside the testbed's; None = too few stamps to tell.
    """

    topic: str
    type: str
    clock: CameraClock | None


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """A picture that was found, and not read yet.

    Attributes:
        camera: whose.
        stamp: of its header, s since the epoch; None = it has none.
        log: when it was logged, s since the epoch.
        difference: how much later it is than the instant, by the testbed's clock, s.
        found: where it lies.
    """

    camera: Camera
    stamp: float | None
    log: float
    difference: float
    found: Found

    @property
    def clock_words(self) -> str:
        """How its time was told from the camera's clock."""
        clock = self.camera.clock
        if clock is None:
            return "camera clock unknown, too few stamps: time of reception"
        if self.stamp is None:
            return "the frame has no stamp: time of reception"
        return clock.words(self.log)


def has_evidence(folder: Path) -> bool:
    """Whether a run folder has evidence in its bag, pictures or other."""
    try:
        return any(is_evidence(item.name) for item in folder.iterdir())
    except OSError:
        return False


class Cameras:
    """The cameras of a run's evidence, open to look for frames; a context manager.

    Args:
        folder: of the run.
        mappings: which topics carry the testbed's signals: theirs is the clock of all events.
        wanted: takes a topic's name; the cameras to look at.

    Attributes:
        cameras: by topic.
        problems: what of the evidence cannot be used, in words.

    Raises:
        MadrobError: the evidence cannot be read.
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
                self._testbed = self._delay_of_testbed(folder, mappings)
            except RecorderError as error:
                raise MadrobError(str(error)) from None
            self._stamps: dict[tuple[int, int, int], float | None] = {}
            self.cameras = tuple(self._found_cameras(wanted))
            self._open = undo.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._open.close()

    def of_testbed(self, log: float) -> float:
        """A log time, as the referee's marks have it, by the testbed's clock, s since the epoch."""
        return log - (0.0 if self._testbed is None else self._testbed.at(log))

    def nearest(self, camera: Camera, time: float) -> CameraFrame | None:
        """The frame that is nearest to an instant; None where none is within `FARTHEST`.

        Args:
            camera: whose.
            time: the instant by the testbed's clock, as events have it, s since the epoch.

        Raises:
            RecorderError: the evidence cannot be read.
        """
        logged = time + (0.0 if self._testbed is None else self._testbed.at(time))
        begin, end = logged - FARTHEST, logged + FARTHEST + _HELD_UP
        if not 0 <= begin < end < seconds(_LATEST):
            return None
        there = self._frames.between(camera.topic, nanoseconds(begin), nanoseconds(end))
        looked_at: dict[int, float] = {}

        def difference(number: int) -> float:
            if number not in looked_at:
                looked_at[number] = self._time(camera, there[number]) - time
            return looked_at[number]

        low, high = 0, len(there)
        while low < high:  # frames come in the order of their stamps
            middle = (low + high) // 2
            low, high = (middle + 1, high) if difference(middle) < 0 else (low, middle)
        for number in range(max(0, low - 2), min(len(there), low + 2)):  # but for a few
            difference(number)
        if not looked_at:
            return None
        number = min(looked_at, key=lambda one: abs(looked_at[one]))
        if abs(looked_at[number]) > FARTHEST:
            return None
        found = there[number]
        stamp, log = self._stamp(found), seconds(found.log_ns)
        return CameraFrame(camera, stamp, log, looked_at[number], found)

    def message(self, frame: CameraFrame, limit: int) -> RawMessage:
        """The message of a frame, of at most `limit` bytes.

        Raises:
            RecorderError: it cannot be read, or it is larger.
        """
        return self._frames.message(frame.found, limit)

    def _time(self, camera: Camera, found: Found) -> float:
        """When a frame was taken, by the testbed's clock."""
        stamp, log = self._stamp(found), seconds(found.log_ns)
        if stamp is None or camera.clock is None:
            return self.of_testbed(log)
        return stamp - camera.clock.offset(log)

    def _stamp(self, found: Found) -> float | None:
        if found.key not in self._stamps:
            self._stamps[found.key] = None
            with suppress(RecorderError):  # who wants its picture is told
                self._stamps[found.key] = header_stamp(self._frames.head(found, HEAD))
        return self._stamps[found.key]

    def _found_cameras(self, wanted: Callable[[str], bool]) -> Iterator[Camera]:
        topics = sorted(
            (t for t in self._frames.topics() if t.type in PICTURE_TYPES and wanted(t.name)),
            key=lambda topic: topic.name,
        )
        if len(topics) > MOST_CAMERAS:
            self.problems.append(f"{len(topics)} cameras: {MOST_CAMERAS} are shown")
        for topic in topics[:MOST_CAMERAS]:
            delay, clock = _delay(self._frames, topic.name), None
            if delay is not None and self._testbed is not None:
                clock = CameraClock(delay, self._testbed)
            yield Camera(topic.name, topic.type, clock)

    def _delay_of_testbed(
        self, folder: Path, mappings: Sequence[TopicMapping]
    ) -> LowestDelay | None:
        """Of the door, from which most events come; else of the first signal that has stamps."""
        with Seeker(folder) as recording:
            topics = {topic.name: topic for topic in recording.topics()}
            by_signal = sorted(mappings, key=lambda one: one.signal is not Signal.DOOR)
            for mapping in by_signal:
                topic = topics.get(mapping.topic)
                if topic is not None and _is_stamped(topic):
                    delay = _delay(recording, topic.name)
                    if delay is not None:
                        return delay
        return None


def _is_stamped(topic: Topic) -> bool:
    try:
        return begins_with_header(types_of([topic]), topic.type)
    except MadrobError:  # nobody knows its type
        return False


def _delay(bag: Seeker, name: str) -> LowestDelay | None:
    """The lowest delay of a topic; None where too few of its messages have stamps."""
    found = bag.spread(name, _CHUNKS_LOOKED_AT)
    step = max(1, len(found) // _STAMPS_LOOKED_AT)
    arrivals = []
    for one in found[::step]:
        with suppress(RecorderError):
            stamp = header_stamp(bag.head(one, HEAD))
            if stamp is not None:
                arrivals.append(Arrival(stamp, seconds(one.log_ns)))
    return LowestDelay(arrivals) if len(arrivals) >= FEWEST else None
