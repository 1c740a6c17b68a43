"""Recordings made for a calibration: from bags to samples, from proposals to settings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.config import Settings, parse_settings
from madrob_console.config.settings_example import toml_value
from madrob_console.messages.codec import Decoder
from madrob_console.messages.mapping import TopicMapping
from madrob_console.messages.types import MessageError, MessageTypes
from recorder.reader import Bag
from scoring.calibration import HandleProposal, MaskProposal, propose_masks
from scoring.protocol import ScoringError, Side, Signal, Strip
from scoring.samples import HandleSample, Sample
from scoring.series import signals_of

_SWEPT = (Signal.DOOR, *(Signal.of_strip(strip) for strip in Strip))


class CalibrationRecording:
    """The samples of some signals in a bag, which must have all topics of the mappings.

    Raises:
        RecorderError: there is no bag to read.
        MadrobError: a topic is not in it, or its type cannot be read.
    """

    def __init__(self, path: Path, mappings: Iterable[TopicMapping]) -> None:
        self.path = path
        self._bag: Bag = Bag(path)
        self._mappings = tuple(mappings)
        self._types = MessageTypes()
        topics = {topic.name: topic for topic in self._bag.topics()}
        for mapping in self._mappings:
            topic = topics.get(mapping.topic)
            if topic is None:
                raise self._missing(mapping)
            if topic.definition and not self._types.knows(topic.type):
                self._types.register(topic.type, topic.definition)

    @property
    def problem(self) -> str | None:
        """Why the bag is not complete; the rest of it was read."""
        return self._bag.problem

    def samples(self) -> Iterator[Sample]:
        """The samples in the order of the bag."""
        decoder = Decoder(self._mappings, self._types)
        counts: Counter[Signal] = Counter()
        for message in self._bag.messages():
            try:
                sample = decoder.decode(message)
            except MessageError as error:
                raise MadrobError(f"{self.path}: {error}") from None
            if sample is not None:
                counts[sample.signal] += 1
                yield sample
        for mapping in self._mappings:
            if not counts[mapping.signal]:
                raise self._missing(mapping)

    def _missing(self, mapping: TopicMapping) -> MadrobError:
        return MadrobError(
            f"{self.path}: no messages on {mapping.topic} ({mapping.signal.value}): record this "
            "topic, too, or correct its name in the settings"
        )


def sweep_recordings(paths: Sequence[Path], settings: Settings) -> list[CalibrationRecording]:
    mappings = [m for m in settings.mappings() if m.signal in _SWEPT]
    return [CalibrationRecording(path, mappings) for path in paths]


def masks_of(recordings: Sequence[CalibrationRecording], settings: Settings) -> MaskProposal:
    """The masks that all recordings together show."""
    sweeps = [signals_of(recording.samples()) for recording in recordings]
    try:
        return propose_masks(sweeps, settings.scoring_thresholds())
    except ScoringError as error:
        raise MadrobError(f"{recordings[0].path}: {error}") from None


def handle_mapping(settings: Settings) -> TopicMapping:
    return next(m for m in settings.mappings() if m.signal is Signal.HANDLE)


def handle_recording(path: Path, mapping: TopicMapping) -> CalibrationRecording:
    """A recording of the published numbers, without scale and offset."""
    return CalibrationRecording(path, [replace(mapping, scale=1.0, offset=0.0)])


def forces_of(recording: CalibrationRecording) -> list[float]:
    return [sample.force for sample in recording.samples() if isinstance(sample, HandleSample)]


def masks_toml(proposal: MaskProposal) -> str:
    low, high = proposal.swept
    lines = [
        f"# Door swept from {low:.3f} to {high:.3f} rad.",
        "# sensor                readings  of the panel  first, rad  last, rad  strays",
    ]
    for view in proposal.views:
        name = f"# {view.name:<20}  {view.readings:>8}  "
        if view.first is None or view.last is None:
            lines.append(f"{name}never sees the panel: no mask; {view.strays} strays")
            continue
        angles = f"{view.first:>10.4f}  {view.last:>9.4f}"
        lines.append(f"{name}{view.under:>12}  {angles}  {view.strays:>6}")
    lines.append("# These lines belong into the table [thresholds] of the settings file.")
    lines.append("[thresholds]")
    if proposal.lintel_height is None:
        lines.append("# lintel_height stays: no sensor sees the floor")
    else:
        lines.append(_line("lintel_height", proposal.lintel_height))
    lines += [
        _line("mask_from", proposal.mask_from),
        _line("mask_to_cw", proposal.mask_to(Side.CW)),
        _line("mask_to_ccw", proposal.mask_to(Side.CCW)),
    ]
    return _checked(lines)


def handle_toml(proposal: HandleProposal, mapping: TopicMapping) -> str:
    unit = abs(proposal.scale)
    lines = [
        f"# {name}: {level.samples} samples, median {level.median:.6g}, "
        f"noise {level.noise * unit:.3f} N"
        for name, level in (("rest", proposal.rest), ("weight", proposal.weight))
    ]
    if proposal.scale * mapping.scale < 0:
        lines += [
            "# WRONG SIGN: positive must push towards CCW, and the settings so far have it the",
            "# other way round. Unless --towards named the wrong side, this scale mends it.",
        ]
    lines += [
        "# This replaces the [[topics]] of the handle force in the settings file, if it has one.",
        "[[topics]]",
        *(_line(key, value) for key, value in _handle_topic(proposal, mapping).items()),
    ]
    return _checked(lines)


def _handle_topic(proposal: HandleProposal, mapping: TopicMapping) -> dict[str, object]:
    return {
        "signal": mapping.signal,
        "topic": mapping.topic,
        "type": mapping.type,
        "field": mapping.field,
        "scale": float(f"{proposal.scale:.9g}"),
        "offset": float(f"{proposal.offset:.9g}"),
    }


def _line(key: str, value: object) -> str:
    return f"{key} = {toml_value(value)}"


def _checked(lines: Iterable[str]) -> str:
    text = "\n".join(lines) + "\n"
    try:
        parse_settings(text)
    except MadrobError as error:
        raise MadrobError(f"the proposal fits no settings: {error}") from None
    return text
