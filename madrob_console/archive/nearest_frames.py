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

# The clock offset of a camera, from stamps and reception times.
#
# Both are times of one machine, whose log times are steady. A message is seldom logged before it
# was stamped. So the lowest delay (log time minus stamp) is the clock offset plus the shortest
# transport time. The lowest delays of two cameras differ by the offset of their clocks. The
# transport time itself cannot be told: a camera whose pictures all come 0.1 s late looks like one
# whose clock is 0.1 s behind.


FEWEST = 5
"""With fewer messages no clock offset is estimated."""

STEP = 0.5
"""A lasting change of the delay by more than this is a clock step, s."""

LEAST_DRIFT = 0.002
"""A smaller change over the whole recording is not reported, s."""

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
    """A time without a clock step; its lowest delay is `low` at `at`."""

    begin: float
    at: float
    low: float
    slope: float
    spread: float


class LowestDelay:
    """The lowest delay of a stream of messages over time. `drift` (s/s) is 0 within the jitter.

    Raises:
        ValueError: fewer than `FEWEST` arrivals.
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
        """Log time minus stamp of a message that was not held up, s."""
        piece = self._piece_at(log)
        return piece.low + piece.slope * (log - piece.at)

    def spread(self, log: float) -> float:
        """How far `at` may be off because delays vary, s."""
        return self._piece_at(log).spread

    def _piece_at(self, log: float) -> _Piece:
        return self._pieces[max(0, bisect_right(self._begins, log) - 1)]


@dataclass(frozen=True, slots=True)
class CameraClock:
    """A camera's clock beside the testbed's, by the delays of their messages."""

    camera: LowestDelay
    testbed: LowestDelay

    def offset(self, log: float) -> float:
        """How far the camera's clock is ahead of the testbed's at a log time, s."""
        return self.testbed.at(log) - self.camera.at(log)

    def spread(self, log: float) -> float:
        """How far `offset` may be off because delays vary, s; a constant delay is not in it."""
        return math.hypot(self.camera.spread(log), self.testbed.spread(log))

    @property
    def drift(self) -> float:
        """s/s; positive when the camera's clock gains on the testbed's."""
        return self.testbed.drift - self.camera.drift

    def words(self, log: float) -> str:
        """`camera clock +0.132 s +- 0.008 s against the testbed's`, then drift and steps."""
        apart = f"{self.offset(log):+.3f} s +- {self.spread(log):.3f} s"
        told = [f"camera clock {apart} against the testbed's"]
        if self.drift:
            told.append(f"gains {1000 * 60 * self.drift:+.1f} ms a minute")
        if self.camera.steps:
            times = "once" if self.camera.steps == 1 else f"{self.camera.steps} times"
            told.append(f"stepped {times} during the recording")
        return ", ".join(told)


def _unstepped(arrivals: Sequence[Arrival]) -> list[Sequence[Arrival]]:
    """Cut at each clock step; no part has fewer than `FEWEST` messages."""
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
    """The drift, from the lowest delay of each part of the time; 0 where jitter explains it."""
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
    """Without the lowest tenth: occasional wrong stamps are outliers."""
    return sorted(delays)[len(delays) // 10 :]


def _quantile(level: Sequence[float], part: float) -> float:
    return level[int(part * (len(level) - 1))]


PICTURE_TYPES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")

FARTHEST = 1.0
"""The largest distance of a frame from its instant, s."""

MOST_CAMERAS = 16
"""Of more cameras, the first by name are used."""

_HELD_UP = 2.0  # s: a frame that comes so late is still found
_CHUNKS_LOOKED_AT = 48  # for the stamps from which a clock is estimated
_STAMPS_LOOKED_AT = 2000
_LATEST = 2**62  # ns: what lies behind is no time


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A topic of pictures; `clock` is None where it has too few stamps."""

    topic: str
    type: str
    clock: CameraClock | None


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """A picture that was found, and not read yet; times in s since the epoch.

    `difference` is how much later it is than the instant, by the testbed's clock, s.
    """

    camera: Camera
    stamp: float | None
    log: float
    difference: float
    found: Found

    @property
    def clock_words(self) -> str:
        clock = self.camera.clock
        if clock is None:
            return "camera clock unknown, too few stamps: time of reception"
        if self.stamp is None:
            return "the frame has no stamp: time of reception"
        return clock.words(self.log)


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
        """A log time, as in the referee's marks, by the testbed's clock, s since the epoch."""
        return log - (0.0 if self._testbed is None else self._testbed.at(log))

    def nearest(self, camera: Camera, time: float) -> CameraFrame | None:
        """The frame nearest to an instant (by the testbed's clock, s since the epoch).

        None where none is within `FARTHEST`. Raises RecorderError where it cannot be read.
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
        """RecorderError if it cannot be read, or has more than `limit` bytes."""
        return self._frames.message(frame.found, limit)

    def _time(self, camera: Camera, found: Found) -> float:
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
        """From the door, the source of most events, else the first signal with stamps."""
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
    """None where too few messages of the topic have stamps."""
    found = bag.spread(name, _CHUNKS_LOOKED_AT)
    step = max(1, len(found) // _STAMPS_LOOKED_AT)
    arrivals = []
    for one in found[::step]:
        with suppress(RecorderError):
            stamp = header_stamp(bag.head(one, HEAD))
            if stamp is not None:
                arrivals.append(Arrival(stamp, seconds(one.log_ns)))
    return LowestDelay(arrivals) if len(arrivals) >= FEWEST else None


SIDE = 960
"""The most pixels in a row and in a column of a picture that is kept."""
