"""What the cameras saw: at each event and mark of the referee the nearest frame of each camera."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

from madrob_console.archive.moments import Moment, moments_called, moments_of
from madrob_console.archive.scored import Scored, score_opened
from madrob_console.common.clock import NS, nanoseconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import atomic_writes
from madrob_console.common.names import terminal_safe
from madrob_console.messages.types import standard_types
from recorder import Bag, RawMessage, RecorderError

SIDE = 960
"""The most pixels in a row of a picture, and in a column of one that is made smaller."""

FARTHEST = 1.0
"""The largest distance of a frame from its moment, s."""

MOST_PICTURES = 100
"""The most pictures of a run; later moments have none."""

NO_PILLOW = "pictures need Pillow: install madrob-console with its extra `report`"

_PACKED = "sensor_msgs/msg/CompressedImage"
_RAW = "sensor_msgs/msg/Image"
_ENCODINGS = {"rgb8": ("RGB", "RGB"), "bgr8": ("RGB", "BGR"), "mono8": ("L", "L")}
"""By the names of `sensor_msgs/image_encodings.hpp`: Pillow's mode and raw mode."""

_JPEG = b"\xff\xd8"
_MOST_PIXELS = 24_000_000
_NOT_PLAIN = re.compile(r"[^0-9A-Za-z]+")


@dataclass(frozen=True, slots=True)
class Picture:
    """The frame of a camera that was received nearest to a moment, or why there is none.

    Attributes:
        moment: its number in the run, from 1, and itself.
        data: JPEG or PNG; empty = there is none.
        difference: how much later than the moment the frame was received, s.
        problem: why there is none, in words.
    """

    number: int
    moment: Moment
    topic: str
    data: bytes = b""
    difference: float = 0.0
    problem: str = ""

    @property
    def file_type(self) -> str:
        return "jpeg" if self.data.startswith(_JPEG) else "png"

    @property
    def difference_words(self) -> str:
        return f"{1000 * self.difference:+.0f} ms"

    @property
    def file_name(self) -> str:
        side = "earlier" if self.difference < 0 else "later"
        distance = f"{1000 * abs(self.difference):.0f} ms {side}"
        words = f"{self.number:02d} {self.moment.name} {self.topic} {distance}"
        suffix = ".jpg" if self.file_type == "jpeg" else ".png"
        return _NOT_PLAIN.sub("_", words) + suffix


def pictures_of(folder: Path, scored: Scored) -> list[Picture]:
    """Return the pictures of a run, camera by camera of each moment; none without evidence."""
    moments = moments_of(_events(scored), scored.run, scored.result.start)
    try:
        return _pictures(folder, moments)
    except MadrobError:  # its evidence cannot be read
        return []


def write_frames(folder: Path, at: str, output: Path) -> Sequence[str]:
    """Write the nearest frame of each camera to an instant into a folder; else why there is none.

    `at` as for `moments_called`.
    """
    try:
        scored = score_opened(folder)
        moments = moments_called(at, _events(scored), scored.run, scored.result.start)
        pictures = _pictures(folder, moments)
        files = {picture.file_name: picture.data for picture in pictures if picture.data}
        if files:
            output.mkdir(exist_ok=True)
            atomic_writes(output, files)
            return []
    except OSError as error:
        return [f"{output}: cannot be made ({error.strerror})"]
    except MadrobError as error:
        return [str(error)]
    return [picture.problem for picture in pictures] or ["no camera was recorded beside it"]


def _events(scored: Scored) -> list[tuple[str, float]]:
    """By EUROBENCH's names, with times in s since the epoch."""
    return [(event.event.value, event.time) for event in scored.result.events]


def _pictures(folder: Path, moments: Sequence[Moment]) -> list[Picture]:
    try:
        bag = Bag(folder, evidence=True)
    except RecorderError as error:
        raise MadrobError(str(error)) from None
    cameras = sorted(topic.name for topic in bag.topics() if topic.type in (_PACKED, _RAW))
    if not cameras and bag.problem is not None:
        raise MadrobError(bag.problem)
    pictures: list[Picture] = []
    for number, moment in enumerate(moments, start=1):
        if len(pictures) < MOST_PICTURES:
            pictures += _at(bag, cameras, number, moment)
    return pictures


def _at(bag: Bag, cameras: Sequence[str], number: int, moment: Moment) -> Iterator[Picture]:
    for camera in cameras:
        at_ns = nanoseconds(moment.time)
        frame = bag.nearest(camera, at_ns, nanoseconds(FARTHEST))
        if frame is None:
            problem = f"no frame within {FARTHEST:g} s"
            yield Picture(number, moment, camera, problem=problem)
            continue
        difference = (frame.receive_ns - at_ns) / NS
        try:
            data = _shown(frame)
        except Exception as error:  # noqa: BLE001 - damaged pictures raise what they like
            problem = f"it cannot be shown ({terminal_safe(str(error))[:100]})"
            yield Picture(number, moment, camera, b"", difference, problem)
        else:
            yield Picture(number, moment, camera, data, difference)


def _shown(frame: RawMessage) -> bytes:
    """Return a frame as it is, or as a JPEG if it is raw or too large; raises what Pillow does."""
    if find_spec("PIL") is None:
        raise MadrobError(NO_PILLOW)
    from PIL import Image, UnidentifiedImageError

    content = standard_types().decode(frame.type, frame.data)
    data = bytes(content.data)
    if frame.type == _PACKED:
        try:
            picture: Image.Image = Image.open(BytesIO(data), formats=("JPEG", "PNG"))
        except UnidentifiedImageError:  # it names an object in memory
            raise MadrobError("it is neither JPEG nor PNG") from None
        _refuse_large(*picture.size)
        if picture.width <= SIDE:
            return data
    else:
        size = int(content.width), int(content.height)
        _refuse_large(*size)
        if content.encoding not in _ENCODINGS:
            raise MadrobError(f"the encoding {content.encoding[:40]!r} is not shown")
        mode, raw_mode = _ENCODINGS[content.encoding]
        picture = Image.frombytes(mode, size, data, "raw", raw_mode, int(content.step))
    picture.thumbnail((SIDE, SIDE))
    file = BytesIO()
    picture.convert("RGB").save(file, "JPEG", quality=80)
    return file.getvalue()


def _refuse_large(width: int, height: int) -> None:
    if width * height > _MOST_PIXELS:
        raise MadrobError(f"{width} x {height} pixels are too many")
