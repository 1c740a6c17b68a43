"""Testbeds with messages of their own, recorded and scored as one with the protocol's messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

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
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.test_papers import ROOT, fenced

GRAM, MM = 0.00980665, 0.001
RANGE, JOINTS = "sensor_msgs/msg/Range", "sensor_msgs/msg/JointState"
SIGNAL_OF = {mapping.topic: mapping.signal for mapping in DEFAULT_MAPPINGS}

GUIDE = (ROOT / "madrob_console/guide/testbed.md").read_text(encoding="utf-8")
(ORIGINAL,) = (block for block in fenced(GUIDE, "toml") if "/madrob/door/state" in block)

LAB = """
[[topics]]
signal = "door angle"
topic = "/lab/joints"
type = "sensor_msgs/msg/JointState"
field = "position[name=door]"

[[topics]]
signal = "handle force"
topic = "/lab/force"
type = "std_msgs/msg/Float64"
field = "data"
scale = -1.0
offset = 100.0
unit = "gf"
""" + "".join(
    f"""
[[topics]]
signal = "passage {side} {hand}"
topics = [{", ".join(f'"/lab/{side}_{hand}_{place}"' for place in range(4))}]
type = "sensor_msgs/msg/Range"
field = "range"
unit = "mm"
"""
    for side in ("cw", "ccw")
    for hand in ("left", "right")
)

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
        self._count = 0

    def take_messages(self, timeout: float) -> list[RawMessage]:
        return [
            RawMessage(topic, kind, self.kinds.encode(kind, made), one.publish_ns, one.receive_ns)
            for one in super().take_messages(timeout)
            for topic, kind, made in self._converted(one)
        ]

    def _converted(self, one: RawMessage) -> list[tuple[str, str, Message]]:
        message, signal = self.kinds.decode(one.type, one.data), SIGNAL_OF.get(one.topic)
        self._count += 1
        if signal is Signal.DOOR:
            return [self.door(message.header, float(message.position[0]))]
        if signal is Signal.HANDLE:
            return [self.handle(message.header, round(message.wrench.force.x / GRAM))]
        if signal is None or signal is Signal.LATCH:
            return [(one.topic, one.type, message)]
        ranges = [float(round(distance / MM)) for distance in message.ranges.tolist()]
        limits = (message.range_min / MM, message.range_max / MM)
        return self.strip(one.topic.rpartition("/")[2], message.header, ranges, limits)

    def door(self, header: Message, angle: float) -> tuple[str, str, Message]:
        made = self.kinds.make(JOINTS, header=header, name=["door"], position=np.array([angle]))
        return "/madrob/door/angle", JOINTS, made

    def handle(self, header: Message, grams: int) -> tuple[str, str, Message]:
        kind = "geometry_msgs/msg/WrenchStamped"
        made = self.kinds.make(kind, header=header)
        made.wrench.force.x = self.newtons(grams)
        return "/madrob/handle/force", kind, made

    def newtons(self, grams: int) -> float:
        return grams * GRAM

    def strip(
        self, name: str, header: Message, ranges: list[float], limits: tuple[float, float]
    ) -> list[tuple[str, str, Message]]:
        low, high = (limit * MM for limit in limits)
        kind, metres = "sensor_msgs/msg/LaserScan", np.array(ranges, dtype=np.float32) * MM
        made = self.kinds.make(
            kind,
            header=header,
            range_min=low,
            range_max=high,
            ranges=metres.astype(np.float32),
        )
        return [(f"/madrob/passage/{name}", kind, made)]

    def range(self, header: Message, distance: float, limits: tuple[float, float]) -> Message:
        low, high = limits
        return self.kinds.make(RANGE, header=header, range=distance, min_range=low, max_range=high)

    def topics(self) -> tuple[Topic, ...]:
        own = tuple(describe_topic(self.kinds, m.topic, m.type) for m in self.mapped)
        mapped = {topic.name for topic in own} | SIGNAL_OF.keys()
        return (*own, *(topic for topic in super().topics() if topic.name not in mapped))

    def status(self) -> tuple[TopicStatus, ...]:
        return tuple(TopicStatus(m.topic, m.type, 1) for m in self.mapped)


class OriginalSource(OtherSource):
    """The original testbed: states in a package of its own."""

    mapped = parse_settings(ORIGINAL).mappings()

    def door(self, header: Message, angle: float) -> tuple[str, str, Message]:
        kind = "madrob_msgs/msg/Door"
        return "/madrob/door/state", kind, self.kinds.make(kind, header=header, angle=angle)

    def handle(self, header: Message, grams: int) -> tuple[str, str, Message]:
        kind = "madrob_msgs/msg/Handle"
        made = self.kinds.make(kind, header=header, force=float(grams))
        return "/madrob/handle/state", kind, made

    def strip(
        self, name: str, header: Message, ranges: list[float], limits: tuple[float, float]
    ) -> list[tuple[str, str, Message]]:
        kind = "madrob_msgs/msg/Passage"
        parts = [self.range(header, distance, limits) for distance in ranges]
        return [
            (f"/madrob/passage/{name}", kind, self.kinds.make(kind, header=header, ranges=parts))
        ]


class LabSource(OtherSource):
    """Joints in changing order, a handle without a header, and a topic for each laser."""

    mapped = parse_settings(LAB).mappings()

    def door(self, header: Message, angle: float) -> tuple[str, str, Message]:
        joints = [("lock", 0.5), ("door", angle)][:: 1 if self._count % 2 else -1]
        names, positions = zip(*joints, strict=True)
        made = self.kinds.make(
            JOINTS, header=header, name=list(names), position=np.array(positions)
        )
        return "/lab/joints", JOINTS, made

    def handle(self, header: Message, grams: int) -> tuple[str, str, Message]:
        kind = "std_msgs/msg/Float64"
        return "/lab/force", kind, self.kinds.make(kind, data=100.0 - grams)

    def strip(
        self, name: str, header: Message, ranges: list[float], limits: tuple[float, float]
    ) -> list[tuple[str, str, Message]]:
        return [
            (f"/lab/{name}_{place}", RANGE, self.range(header, distance, limits))
            for place, distance in enumerate(ranges)
        ]


class LabInUsualMessages(OtherSource):
    """The same forces without their header: as old as their reception."""

    def handle(self, header: Message, grams: int) -> tuple[str, str, Message]:
        kind = "std_msgs/msg/Float64"
        force = (100.0 - grams) * -GRAM + 100.0 * GRAM
        return "/madrob/handle/force", kind, self.kinds.make(kind, data=force)

    mapped = parse_settings(
        '[[topics]]\nsignal = "handle force"\ntype = "std_msgs/msg/Float64"\nfield = "data"\n'
    ).mappings()


@pytest.mark.parametrize(
    ("other", "usual"), [(OriginalSource, OtherSource), (LabSource, LabInUsualMessages)]
)
def test_other_messages_of_the_same_testbed_score_to_the_same_digits(
    other: type[OtherSource], usual: type[OtherSource], tmp_path: Path
) -> None:
    results = []
    for number, kind in enumerate((other, usual)):
        drive = driven(kind, tmp_path / str(number))
        drive.whole_run(make_setup())
        assert drive.engine.snapshot().faults == ()
        drive.engine.close()
        assert main(["score", "--check", str(drive.folder)]) == 0
        results.append(drive.scored().result)
    ours, theirs = results
    assert [one.value for one in ours.indicators.values()] == [
        one.value for one in theirs.indicators.values()
    ]
    assert all(one.value is not None for one in ours.indicators.values())
    assert ours.indicators[IndicatorName.CAPABILITY_LEVEL].value == 6
    assert [(e.event, e.since_start) for e in ours.events] == [
        (e.event, e.since_start) for e in theirs.events
    ]
    assert not [words for one in ours.indicators.values() for words in one.doubts]


def driven(kind: type[OtherSource], results: Path) -> Drive:
    driver = type("OtherDrive", (Drive,), {"SOURCE": kind})
    drive = driver(results, mappings=kind.mapped)
    assert isinstance(drive, Drive)
    return drive
