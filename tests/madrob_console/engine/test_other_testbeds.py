"""Testbeds with messages of their own, recorded and scored as one with the protocol's messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from madrob_console.cli.main import main
from madrob_console.common.clock import Clock
from madrob_console.config.settings import parse_settings
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping, describe_topic
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import RawMessage, Topic
from scoring.indicator_table import IndicatorName
from scoring.protocol import Signal
from scoring.result import Result
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.test_papers import ROOT, fenced

GRAM, MM = 0.00980665, 0.001
RANGE, JOINTS = "sensor_msgs/msg/Range", "sensor_msgs/msg/JointState"
SIGNAL_OF = {mapping.topic: mapping.signal for mapping in DEFAULT_MAPPINGS}

GUIDE = (ROOT / "madrob_console/guide/testbed.md").read_text(encoding="utf-8")
(ORIGINAL,) = (block for block in fenced(GUIDE, "toml") if "/madrob/door/state" in block)


PACKAGE = {
    "Door": "float64 angle\nfloat64 velocity\nfloat64 duty_cycle\nuint8 mode\nuint8 status\n",
    "Handle": "float64 force\nfloat64 kappa\nfloat64 offset\nuint8 calibration_status\n",
    "Passage": "sensor_msgs/Range[] ranges\nbool status_ok\n",
}
"""Messages with the fields of the original testbed's."""


class OtherSource(SimulatedSource):
    """A testbed whose load cell counts grams, and whose lasers count mm; in the usual messages."""

    mapped: Sequence[TopicMapping] = DEFAULT_MAPPINGS

    def __init__(
        self, testbed: SimulatedTestbed, clock: Clock, types: MessageTypes, _: object
    ) -> None:
        self.kinds = types
        for name, text in PACKAGE.items():
            parts = [self.kinds.definition(kind) for kind in ("std_msgs/msg/Header", RANGE)]
            nested = zip(("std_msgs/Header", "sensor_msgs/Range"), parts, strict=True)
            full = "".join(f"{'=' * 80}\nMSG: {kind}\n{part}\n" for kind, part in nested)
            self.kinds.register(f"madrob_msgs/msg/{name}", f"std_msgs/Header header\n{text}{full}")
        super().__init__(testbed, clock, types, DEFAULT_MAPPINGS)

    def take_messages(self, timeout: float) -> list[RawMessage]:
        return [self._converted(message) for message in super().take_messages(timeout)]

    def _converted(self, message: RawMessage) -> RawMessage:
        content, signal = (
            self.kinds.decode(message.type, message.data),
            SIGNAL_OF.get(message.topic),
        )
        topic, made = message.topic, content
        if signal is Signal.DOOR:
            topic, made = self.door(content)
        elif signal is Signal.HANDLE:
            topic, made = self.handle(content, round(content.wrench.force.x / GRAM))
        elif signal is not None and signal is not Signal.LATCH:
            ranges = [float(round(distance / MM)) for distance in content.ranges.tolist()]
            made = self.strip(content, ranges)
        kind = made.__msgtype__
        data = self.kinds.encode(kind, made)
        return RawMessage(topic, kind, data, message.publish_ns, message.receive_ns)

    def door(self, content: Message) -> tuple[str, Message]:
        return "/madrob/door/angle", content

    def handle(self, content: Message, grams: int) -> tuple[str, Message]:
        content.wrench.force.x = grams * GRAM
        return "/madrob/handle/force", content

    def strip(self, content: Message, ranges: list[float]) -> Message:
        content.ranges = (np.array(ranges, dtype=np.float32) * MM).astype(np.float32)
        return content

    def topics(self) -> tuple[Topic, ...]:
        own = tuple(describe_topic(self.kinds, m.topic, m.type) for m in self.mapped)
        mapped = {topic.name for topic in own} | SIGNAL_OF.keys()
        return (*own, *(topic for topic in super().topics() if topic.name not in mapped))

    def status(self) -> tuple[TopicStatus, ...]:
        return tuple(TopicStatus(m.topic, m.type, 1) for m in self.mapped)


class OriginalSource(OtherSource):
    """The original testbed: states in a package of its own."""

    mapped = parse_settings(ORIGINAL).mappings()

    def door(self, content: Message) -> tuple[str, Message]:
        angle = float(content.position[0])
        return "/madrob/door/state", self.made("Door", content, angle=angle)

    def handle(self, content: Message, grams: int) -> tuple[str, Message]:
        return "/madrob/handle/state", self.made("Handle", content, force=float(grams))

    def strip(self, content: Message, ranges: list[float]) -> Message:
        limits = {"min_range": content.range_min / MM, "max_range": content.range_max / MM}
        parts = [
            self.kinds.make(RANGE, header=content.header, range=distance, **limits)
            for distance in ranges
        ]
        return self.made("Passage", content, ranges=parts)

    def made(self, name: str, content: Message, **fields: object) -> Message:
        return self.kinds.make(f"madrob_msgs/msg/{name}", header=content.header, **fields)


def result_of(source: type[OtherSource], results: Path) -> Result:
    """Of a whole run, that the command line checks."""
    driver = type("OtherDrive", (Drive,), {"SOURCE": source})
    drive: Drive = driver(results, mappings=source.mapped)
    drive.whole_run(make_setup())
    assert drive.engine.snapshot().faults == ()
    drive.engine.close()
    assert main(["score", "--check", str(drive.folder)]) == 0
    return drive.scored().result


def test_other_messages_of_the_same_testbed_score_to_the_same_digits(tmp_path: Path) -> None:
    kinds = (OriginalSource, OtherSource)
    ours, theirs = (result_of(kind, tmp_path / kind.__name__) for kind in kinds)
    values, others = (
        {name: (one.value, one.doubts) for name, one in result.indicators.items()}
        for result in (ours, theirs)
    )
    assert values == others
    assert values[IndicatorName.CAPABILITY_LEVEL] == (6, ())
    assert None not in [value for value, _ in values.values()]
    assert [(e.event, e.since_start) for e in ours.events] == [
        (e.event, e.since_start) for e in theirs.events
    ]
