"""The camera frame nearest to an instant, by the times of reception."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from statistics import median

from madrob_console.common.clock import nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import HEAD, header_stamp
from madrob_console.messages.fields import begins_with_header
from madrob_console.messages.mapping import TopicMapping
from madrob_console.messages.types import types_of
from recorder import RecorderError
from recorder.bag import RawMessage, Topic, is_evidence
from recorder.reader import Bag
from scoring.protocol import Signal

PICTURE_TYPES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")

FARTHEST = 1.0
"""The largest distance of a frame from its instant, s."""

MOST_CAMERAS = 16
"""Of more cameras, the first by name are used."""

_STAMPS_LOOKED_AT, _MESSAGES_LOOKED_AT = 100, 10_000
_LATEST = 2**62  # ns: what lies behind is no time


def has_evidence(folder: Path) -> bool:
    try:
        return any(is_evidence(item.name) for item in folder.iterdir())
    except OSError:
        return False


class Cameras:
    """The cameras of a run's evidence.

    The topics of `mappings` carry the testbed's signals, whose clock is that of all events.
    """

    def __init__(self, folder: Path, mappings: Sequence[TopicMapping]) -> None:
        try:
            self._evidence = Bag(folder, evidence=True)
            self._delay = _delay_of_testbed(folder, mappings)
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        cameras = [topic for topic in self._evidence.topics() if topic.type in PICTURE_TYPES]
        cameras.sort(key=lambda topic: topic.name)
        self.topics = tuple(cameras[:MOST_CAMERAS])
        self._problems = []
        if len(cameras) > MOST_CAMERAS:
            self._problems.append(f"{len(cameras)} cameras: {MOST_CAMERAS} are shown")

    @property
    def problems(self) -> list[str]:
        """What is wrong with the evidence, as far as it was read, a line each."""
        torn = self._evidence.problem
        return [*self._problems, *([] if torn is None else [torn])]

    def log_time(self, time: float) -> float:
        """The log time of an instant by the testbed's clock, both in s since the epoch."""
        return time + self._delay

    def nearest(self, camera: Topic, log: float) -> RawMessage | None:
        """The frame received nearest to a log time, s since the epoch.

        None where none is within `FARTHEST`. Raises RecorderError where it cannot be read.
        """
        if not FARTHEST <= log < seconds(_LATEST):
            return None
        return self._evidence.nearest(camera.name, nanoseconds(log), nanoseconds(FARTHEST))


def _delay_of_testbed(folder: Path, mappings: Sequence[TopicMapping]) -> float:
    """Log time less stamp, s; 0 without stamps.

    From the door, the source of most events, else the first signal with stamps. Its first messages
    tell it: what is stamped after a step of the clock is scored as if there had been none.
    """
    recording = Bag(folder)
    topics = {topic.name: topic for topic in recording.topics()}
    by_use = sorted(mappings, key=lambda mapping: mapping.signal is not Signal.DOOR)
    names = [
        mapping.topic
        for mapping in by_use
        if mapping.topic in topics and _is_stamped(topics[mapping.topic])
    ]
    delays: defaultdict[str, list[float]] = defaultdict(list)
    for message in islice(recording.messages(), _MESSAGES_LOOKED_AT if names else 0):
        stamp = header_stamp(message.data[:HEAD]) if message.topic in names else None
        if stamp is not None:
            delays[message.topic].append(seconds(message.receive_ns) - stamp)
            if len(delays[names[0]]) == _STAMPS_LOOKED_AT:
                break
    return next((median(delays[name]) for name in names if delays[name]), 0.0)


def _is_stamped(topic: Topic) -> bool:
    try:
        return begins_with_header(types_of([topic]), topic.type)
    except MadrobError:  # nobody knows its type
        return False


SIDE = 960
"""The most pixels in a row and in a column of a picture that is kept."""
