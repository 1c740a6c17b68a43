"""The camera frame nearest to an instant, by the times of reception."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from statistics import median

from madrob_console.common.clock import nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import HEAD, TopicMapping, begins_with_header, header_stamp
from madrob_console.messages.message_types import types_of
from recorder.bag import RawMessage, Topic, is_evidence
from recorder.errors import RecorderError
from recorder.mcap_reader import DamageError
from recorder.reader import Bag, Seeker, bag_files
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
        self._problems: list[str] = []
        self._files: list[Seeker] = []
        try:
            for path in bag_files(folder, evidence=True)[0]:
                self._open(path)
            self._delay = _delay_of_testbed(folder, mappings)
        except (OSError, RecorderError) as error:
            raise MadrobError(str(error)) from None
        self.topics = self._cameras_of_files()

    def _open(self, path: Path) -> None:
        try:
            self._files.append(Seeker(path))
        except (DamageError, OSError) as error:
            self._problems.append(f"{path.name}: {error}")

    @property
    def problems(self) -> list[str]:
        """What is wrong with the evidence, as far as it was read, a line each."""
        torn = [f"{file.path.name}: {file.problem}" for file in self._files if file.problem]
        return [*self._problems, *torn]

    def log_time(self, time: float) -> float:
        """The log time of an instant by the testbed's clock, both in s since the epoch."""
        return time + self._delay

    def nearest(self, camera: Topic, log: float) -> RawMessage | None:
        """The frame received nearest to a log time, s since the epoch.

        None where none is within `FARTHEST`. Raises RecorderError where it cannot be read.
        """
        if not FARTHEST <= log < seconds(_LATEST):
            return None
        at_ns, within_ns = nanoseconds(log), nanoseconds(FARTHEST)
        nearest = (file.nearest(camera.name, at_ns, within_ns) for file in self._files)
        frames = (message for message in nearest if message is not None)
        return min(frames, key=lambda frame: abs(frame.receive_ns - at_ns), default=None)

    def _cameras_of_files(self) -> tuple[Topic, ...]:
        cameras: dict[str, Topic] = {}
        for file in self._files:
            for topic in file.topics:
                if topic.type in PICTURE_TYPES:
                    cameras.setdefault(topic.name, topic)
        if len(cameras) > MOST_CAMERAS:
            self._problems.append(f"{len(cameras)} cameras: {MOST_CAMERAS} are shown")
        return tuple(cameras[name] for name in sorted(cameras)[:MOST_CAMERAS])


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
