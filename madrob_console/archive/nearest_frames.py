"""The camera frame nearest to an instant, and the clock offset of each camera."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import NamedTuple, Self

from madrob_console.common.clock import nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import HEAD, TopicMapping, begins_with_header, header_stamp
from madrob_console.messages.message_types import types_of
from recorder.bag import RawMessage, Topic, is_evidence
from recorder.errors import RecorderError
from recorder.seeking import Found, Seeker
from scoring.protocol import Signal

# How a camera's clock stands beside the testbed's, by stamps and reception.
#
# Both reach the same machine, whose log times are steady. A message is never logged before it was
# stamped but by a clock that is off, and seldom much later: the lowest of its delays, log time
# minus stamp, is the clock's offset and the shortest time on the way. The two lowest delays apart
# are the two clocks apart. How long messages are on their way at least nobody can tell from this:
# a camera whose pictures all come 0.1 s late looks like one whose clock is 0.1 s behind.


FEWEST = 5
"""Fewer messages tell nothing of a clock."""

STEP = 0.5
"""A delay that changes by more than this, and stays so, is a clock that was stepped, s."""

LEAST_DRIFT = 0.002
"""A change over the whole recording below this is not told, s."""

_LOW, _HIGH = 0.05, 0.2
_WINDOWS = 8
_NEIGHBOURS = 5  # median of so many: one wrong stamp is no step
_NORMAL = 1.4826  # from the median deviation to the standard deviation
_RESOLUTION = 0.0001  # s


class Arrival(NamedTuple):
    """When a message was stamped, and when it was logged, s since the epoch."""

    stamp: float
    log: float


@dataclass(frozen=True, slots=True)
class _Piece:
    """A time within which the clock was not stepped; its lowest delay is `low` at `at`."""

    begin: float
    at: float
    low: float
    slope: float
    spread: float


class LowestDelay:
    """The lowest delay of a stream of messages, as it changes with time.

    Args:
        arrivals: of its messages, in any order, at least `FEWEST`.

    Attributes:
        steps: how often its clock was stepped.
        drift: by how much the delay grows, s/s; 0 = by nothing that could be told from jitter.

    Raises:
        ValueError: there are fewer.
    """

    def __init__(self, arrivals: Iterable[Arrival]) -> None:
        found = sorted(arrivals, key=lambda one: one.log)
        if len(found) < FEWEST:
            raise ValueError(f"{len(found)} messages tell nothing of a clock")
        pieces = [_piece(part) for part in _unstepped(found)]
        self._pieces = pieces
        self._begins = [piece.begin for piece in pieces]
        self.steps = len(pieces) - 1
        self.drift = max((piece.slope for piece in pieces), key=abs)

    def at(self, log: float) -> float:
        """Log time minus stamp of a message that came without hold-up, s."""
        piece = self._piece_at(log)
        return piece.low + piece.slope * (log - piece.at)

    def spread(self, log: float) -> float:
        """How far `at` may be off for what varies, s."""
        return self._piece_at(log).spread

    def _piece_at(self, log: float) -> _Piece:
        return self._pieces[max(0, bisect_right(self._begins, log) - 1)]


@dataclass(frozen=True, slots=True)
class CameraClock:
    """A camera's clock beside the testbed's.

    Attributes:
        camera: the delays of its frames.
        testbed: those of the testbed's messages.
    """

    camera: LowestDelay
    testbed: LowestDelay

    def offset(self, log: float) -> float:
        """How far the camera's clock is ahead of the testbed's at a log time, s."""
        return self.testbed.at(log) - self.camera.at(log)

    def spread(self, log: float) -> float:
        """How far `offset` may be off for what varies, s; a constant delay is not in it."""
        return math.hypot(self.camera.spread(log), self.testbed.spread(log))

    @property
    def drift(self) -> float:
        """By how much the camera's clock gains on the testbed's, s/s."""
        return self.testbed.drift - self.camera.drift

    def words(self, log: float) -> str:
        """`camera clock +0.132 s +- 0.008 s against the testbed's`, drift and steps behind it."""
        apart = f"{self.offset(log):+.3f} s +- {self.spread(log):.3f} s"
        told = [f"camera clock {apart} against the testbed's"]
        if self.drift:
            told.append(f"gains {1000 * 60 * self.drift:+.1f} ms a minute")
        if self.camera.steps:
            times = "once" if self.camera.steps == 1 else f"{self.camera.steps} times"
            told.append(f"stepped {times} during the recording")
        return ", ".join(told)


def _unstepped(arrivals: Sequence[Arrival]) -> list[Sequence[Arrival]]:
    """Cut where the clock was stepped; no part is too short for a clock."""
    delays = [one.log - one.stamp for one in arrivals]
    cuts = [0]
    for place in range(FEWEST, len(delays) - FEWEST + 1):
        if abs(delays[place] - delays[place - 1]) <= STEP or place - cuts[-1] < FEWEST:
            continue
        before = median(delays[max(cuts[-1], place - _NEIGHBOURS) : place])
        if abs(median(delays[place : place + _NEIGHBOURS]) - before) > STEP:
            cuts.append(place)
    return [arrivals[a:b] for a, b in pairwise([*cuts, len(arrivals)])]


def _piece(arrivals: Sequence[Arrival]) -> _Piece:
    delays = [one.log - one.stamp for one in arrivals]
    middle = (arrivals[0].log + arrivals[-1].log) / 2
    slope = _slope(arrivals, delays)
    level = sorted(
        delay - slope * (one.log - middle) for one, delay in zip(arrivals, delays, strict=True)
    )
    low = _quantile(level, _LOW)
    spread = max(_RESOLUTION, _quantile(level, _HIGH) - low)
    return _Piece(arrivals[0].log, middle, low, slope, spread)


def _slope(arrivals: Sequence[Arrival], delays: Sequence[float]) -> float:
    """The drift, by the lowest delays of parts of the time; 0 where jitter explains it."""
    size = len(arrivals) // _WINDOWS
    if size < FEWEST:
        return 0.0
    lows = []
    for number in range(_WINDOWS):
        part = slice(number * size, (number + 1) * size)
        times = [one.log for one in arrivals[part]]
        lows.append((median(times), min(_trimmed(delays[part]))))
    slopes = [
        (b[1] - a[1]) / (b[0] - a[0])
        for number, a in enumerate(lows)
        for b in lows[number + 1 :]
        if b[0] > a[0]
    ]
    if not slopes:
        return 0.0
    slope = median(slopes)
    level = median(low - slope * at for at, low in lows)
    noise = _NORMAL * median(abs(low - slope * at - level) for at, low in lows)
    change = abs(slope) * (lows[-1][0] - lows[0][0])
    return slope if change > max(LEAST_DRIFT, 4 * noise) else 0.0


def _trimmed(delays: Sequence[float]) -> Sequence[float]:
    """Without the lowest tenth: a wrong stamp now and then is no clock."""
    return sorted(delays)[len(delays) // 10 :]


def _quantile(level: Sequence[float], part: float) -> float:
    return level[int(part * (len(level) - 1))]


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


# What cameras saw: the frames nearest to an event, decoded, and how their clocks stand.
#
# Nothing is scored from it.


SIDE = 960
"""Of a picture that is kept, the most pixels in a row and in a column."""
