"""The pictures of a run: at each event and each mark of the referee the nearest of each camera."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from madrob_console.archive.folders import PICTURES_FOLDER, PICTURES_INDEX
from madrob_console.archive.moments import Moment, moments_called, moments_of
from madrob_console.archive.nearest_frames import FARTHEST, SIDE, Cameras, has_evidence
from madrob_console.archive.run_journal import evidence_removed
from madrob_console.archive.scored import Scored, score_opened
from madrob_console.common.clock import seconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import atomic_writes, replaced_folder
from madrob_console.common.names import terminal_safe
from madrob_console.common.plain_files import read_all
from madrob_console.common.stored_json import decode
from madrob_console.messages.mapping import TopicMapping
from recorder import RecorderError

if TYPE_CHECKING:
    from madrob_console.archive.picture import Jpeg
    from recorder.bag import RawMessage

INDEX_FORMAT: Final = 1

FAR = 0.1
"""A frame farther from its moment may show something else, s: three periods at 30 Hz."""

MOST_PICTURES = 200
"""The most pictures of a run; later moments have none."""

WORKING_TIME = 60.0
"""Time to find and decode, s; what is left then has no picture."""

_LONGEST_NAME = 36  # of what happened, and of a camera: a file's name has 255 at most
_LARGEST_INDEX = 4_000_000
_LARGEST_PICTURE = 1_000_000
_NOT_PLAIN = re.compile(r"[^0-9A-Za-z]+")


class PictureEntry(msgspec.Struct, frozen=True, kw_only=True):
    """A picture in the index, or why there is none. Times in s since the epoch.

    Attributes:
        moment: its number in the run, from 1.
        event: the moment's name, as in file names; `words` for people.
        since_start: s.
        file: beside the index; empty = there is none.
        width, height: of the file, pixels.
        log_time: when the frame was received.
        difference: how much later than the moment that was, s.
    """

    moment: int
    event: str
    words: str
    time: float
    since_start: float
    topic: str
    file: str = ""
    width: int = 0
    height: int = 0
    log_time: float | None = None
    difference: float | None = None
    problem: str = ""


class PictureIndex(msgspec.Struct, frozen=True, kw_only=True):
    """The content of `index.json`; `problems` says what else is wrong with the evidence."""

    pictures: tuple[PictureEntry, ...] = ()
    problems: tuple[str, ...] = ()
    format: int = INDEX_FORMAT


@dataclass(frozen=True, slots=True)
class RunPictures:
    """The pictures of a run (JPEG by name) with their index."""

    index: PictureIndex
    files: Mapping[str, bytes] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.index.pictures or self.index.problems)


NO_PICTURES = RunPictures(PictureIndex())

NO_PILLOW = "pictures need Pillow: install madrob-console with its extra `report`"

_NONE_MADE = (NO_PICTURES, RunPictures(PictureIndex(problems=(NO_PILLOW,))))


def events_of(scored: Scored) -> list[tuple[str, float]]:
    """By EUROBENCH's names, with times in s since the epoch."""
    return [(event.event.value, event.time) for event in scored.result.events]


def moments_in(scored: Scored) -> tuple[Moment, ...]:
    return moments_of(events_of(scored), scored.run, scored.result.start)


def pictures_of(
    folder: Path,
    moments: Sequence[Moment],
    mappings: Sequence[TopicMapping],
    monotonic: Callable[[], float] = time.monotonic,
    *,
    name_distance: bool = False,
) -> RunPictures:
    """The nearest frame of each camera at each moment, decoded; none without evidence.

    A wrong picture of a camera is reported in one line and harms nothing else. `monotonic` is real
    time, s. With `name_distance` a file's name has the distance of its frame, as is needed without
    the index.
    """
    if not has_evidence(folder):
        return NO_PICTURES
    if not has_pillow():
        return _NONE_MADE[1]
    try:
        cameras = Cameras(folder, mappings)
        return _Maker(cameras, monotonic, name_distance=name_distance).pictures(moments)
    except MadrobError as error:
        return RunPictures(PictureIndex(problems=(terminal_safe(str(error)),)))


def has_pillow() -> bool:
    return find_spec("PIL") is not None


def stored_pictures(folder: Path) -> RunPictures:
    """The pictures made before; none where they cannot be read."""
    place = folder / PICTURES_FOLDER
    try:
        index = decode(read_all(place / PICTURES_INDEX, _LARGEST_INDEX), PictureIndex)
    except (OSError, MadrobError):
        return NO_PICTURES
    files = {}
    for entry in index.pictures[:MOST_PICTURES]:
        if entry.file and Path(entry.file).name == entry.file:
            try:
                files[entry.file] = read_all(place / entry.file, _LARGEST_PICTURE)
            except OSError:
                continue
    return RunPictures(index, files)


def run_pictures(folder: Path, scored: Scored) -> RunPictures:
    """The pictures of a run from its evidence; without evidence or Pillow, those made before."""
    pictures = pictures_of(folder, moments_in(scored), scored.record.mappings)
    return stored_pictures(folder) or pictures if pictures in _NONE_MADE else pictures


def renewed_pictures(folder: Path, scored: Scored) -> RunPictures:
    """As `run_pictures`, written to the pictures folder of the run in place of those before."""
    pictures = pictures_of(folder, moments_in(scored), scored.record.mappings)
    if pictures in _NONE_MADE:
        return stored_pictures(folder) or pictures
    _write(folder / PICTURES_FOLDER, pictures)
    return pictures


def write_frames(folder: Path, at: str, output: Path) -> Sequence[str]:
    """Write the nearest frame of each camera to an instant into a folder; else why there is none.

    `at` as for `moments_called`.
    """
    if not has_evidence(folder):
        removed = evidence_removed(folder)
        return [f"its evidence was {removed}" if removed else "it was recorded without evidence"]
    try:
        scored = score_opened(folder)
        moments = moments_called(at, events_of(scored), scored.run, scored.result.start)
        pictures = pictures_of(folder, moments, scored.record.mappings, name_distance=True)
        if pictures.files:
            output.mkdir(exist_ok=True)
            atomic_writes(output, pictures.files)
            return []
    except OSError as error:
        return [f"{output}: cannot be made ({error.strerror})"]
    except MadrobError as error:
        return [str(error)]
    return [*pictures.index.problems, *map(nothing_near, pictures.index.pictures)] or [
        "it has no camera"
    ]


def _write(place: Path, pictures: RunPictures) -> None:
    if place.is_symlink() or (place.exists() and not (place / PICTURES_INDEX).is_file()):
        raise MadrobError(f"{place}: is no folder of pictures; move it away")
    index = msgspec.json.format(msgspec.json.encode(pictures.index), indent=2)
    replaced_folder(place, {**pictures.files, PICTURES_INDEX: index + b"\n"})


class _Maker:
    """Finds and decodes until `WORKING_TIME` is up."""

    def __init__(
        self, cameras: Cameras, monotonic: Callable[[], float], *, name_distance: bool
    ) -> None:
        self._cameras = cameras
        self._name_distance = name_distance
        self._names = _file_names([camera.name for camera in cameras.topics])
        self._monotonic = monotonic
        self._until = monotonic() + WORKING_TIME
        self._decoded: dict[tuple[str, int], Jpeg | str] = {}
        self._files: dict[str, bytes] = {}
        self._left_out = 0

    def pictures(self, moments: Sequence[Moment]) -> RunPictures:
        entries = [
            entry for numbered in enumerate(moments, start=1) for entry in self._at(*numbered)
        ]
        problems = [terminal_safe(problem) for problem in self._cameras.problems]
        if self._left_out:
            problems.append(
                f"{self._left_out} pictures were not made: at most {MOST_PICTURES}, and "
                f"{WORKING_TIME:g} s of work; a replay writes single ones"
            )
        index = PictureIndex(pictures=tuple(entries), problems=tuple(problems))
        return RunPictures(index, self._files)

    def _at(self, number: int, moment: Moment) -> Iterator[PictureEntry]:
        log = moment.time if moment.logged else self._cameras.log_time(moment.time)
        for camera in self._cameras.topics:
            if len(self._files) >= MOST_PICTURES or self._monotonic() > self._until:
                self._left_out += 1
                continue
            entry = PictureEntry(
                moment=number,
                event=moment.name,
                words=moment.words,
                time=moment.time,
                since_start=moment.since_start,
                topic=camera.name,
            )
            try:
                frame = self._cameras.nearest(camera, log)
            except RecorderError as error:
                yield msgspec.structs.replace(entry, problem=terminal_safe(str(error)))
                continue
            yield entry if frame is None else self._of_frame(entry, frame, log)

    def _of_frame(self, entry: PictureEntry, frame: RawMessage, log: float) -> PictureEntry:
        received = seconds(frame.receive_ns)
        received_entry = msgspec.structs.replace(
            entry, log_time=received, difference=received - log
        )
        picture = self._picture(frame)
        if isinstance(picture, str):
            return msgspec.structs.replace(received_entry, problem=picture)
        ms = _ms(received_entry)
        side = "" if not ms else "_later" if ms > 0 else "_earlier"
        distance = f"_{abs(ms)}_ms{side}" if self._name_distance else ""
        name = f"{entry.moment:02d}_{_plain(entry.event)}_{self._names[entry.topic]}{distance}.jpg"
        self._files[name] = picture.data
        return msgspec.structs.replace(
            received_entry, file=name, width=picture.width, height=picture.height
        )

    def _picture(self, frame: RawMessage) -> Jpeg | str:
        key = frame.topic, frame.receive_ns
        if key not in self._decoded:
            self._decoded[key] = self._decode(frame)
        return self._decoded[key]

    def _decode(self, message: RawMessage) -> Jpeg | str:
        from madrob_console.archive.picture import MOST_BYTES, PictureError, decoded, jpeg

        try:
            return jpeg(decoded(message, SIDE), MOST_BYTES)
        except PictureError as error:
            return terminal_safe(str(error))


def nothing_near(entry: PictureEntry) -> str:
    if entry.file:
        return ""
    return entry.problem or f"no frame within {FARTHEST:g} s"


def is_far(entry: PictureEntry) -> bool:
    return abs(entry.difference or 0.0) > FAR


def difference_words(entry: PictureEntry) -> str:
    """`-12 ms` where the frame is earlier than its moment; `389 ms LATER` if far."""
    ms = _ms(entry)
    if is_far(entry):
        return f"{abs(ms)} ms {'LATER' if ms > 0 else 'EARLIER'}"
    return f"{ms:+d} ms" if ms else "0 ms"


def _ms(entry: PictureEntry) -> int:
    return round(1000 * (entry.difference or 0.0))


def _file_names(topics: Sequence[str]) -> dict[str, str]:
    names: dict[str, str] = {}
    for topic in topics:
        name = plain = _plain(topic)
        number = 1
        while name in names.values():
            number += 1
            name = f"{plain}_{number}"
        names[topic] = name
    return names


def _plain(text: str) -> str:
    return _NOT_PLAIN.sub("_", text).strip("_")[:_LONGEST_NAME] or "unnamed"
