"""Testbeds that differ: clocks of a simulation or another machine, messages of their own."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.cli.main import main
from madrob_console.common.clock import NS, Clock
from madrob_console.config.settings import parse_settings
from madrob_console.messages.codec import describe_topic
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import Message, MessageTypes
from madrob_console.referee.acts import Start, Waive
from madrob_console.referee.records import CheckName
from madrob_console.testbeds.ros.subscriptions import arrivals
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import RawMessage, Topic
from scoring.indicator_table import IndicatorName
from scoring.protocol import Signal
from scoring.result import Result
from tests.madrob_console.engine.drive import Drive, FaultyDrive, make_setup
from tests.madrob_console.engine.spoilt import HANDLE, Edit, Fault, shift_stamp
from tests.test_papers import ROOT, fenced

BEGIN = 100 * NS


PERIOD = NS // 50


@given(
    count=st.integers(1, 20),
    begin=st.integers(0, 5),
    stepped=st.integers(0, 25),
    jump=st.integers(-2 * NS, 2 * NS),
    wait=st.integers(1, 5 * PERIOD),
)
def test_arrivals_are_steady_whenever_the_clock_that_notes_them_is_stepped(
    count: int, begin: int, stepped: int, jump: int, wait: int
) -> None:
    """Of a topic without a header they are its samples' times."""
    times = [BEGIN + (begin + number) * PERIOD for number in range(count)]
    before, now = times[0] - PERIOD, times[-1] + wait
    ahead = [jump * (at >= BEGIN + stepped * PERIOD) for at in (*times, now)]
    noted = [at + by for at, by in zip(times, ahead, strict=False)]
    found = arrivals(noted, before, now, now, now + ahead[-1])
    assert all(earlier < later for earlier, later in pairwise((before, *found)))
    assert found[-1] <= now
    errors = [abs(one - at) for one, at in zip(found, times, strict=True)]
    assert max(errors) <= (max(wait, PERIOD) if len({*ahead}) > 1 else 0)


@pytest.mark.parametrize("off", [-1.7e9, 11.0])
def test_stamps_of_another_clock_are_named_first_with_what_to_do_never_waived(
    off: float, hall: FaultyDrive
) -> None:
    words = "set the clock: stamps are of another clock"
    shift_stamps(hall, [off])
    hall.set_up()
    assert hall.check(CheckName.CLOCK) == f"failed: {words}"
    assert hall.engine.perform(Start()) == f"{words} (and 1 more)"
    refused = hall.engine.perform(Waive(CheckName.CLOCK, "looks fine"))
    assert refused == f"the check 'clock skew' cannot be waived: {words}"
    shift_stamps(hall, [0.0])
    hall.wait(2.1)
    hall.act(Start())


def test_a_wild_stamp_now_and_then_is_of_no_other_clock(hall: FaultyDrive) -> None:
    shift_stamps(hall, [0.0, 1000.0])
    hall.source.spoil(HANDLE, Fault.ZERO_STAMPS)
    hall.set_up()
    assert hall.check(CheckName.CLOCK).startswith("failed: set the clocks: stamps differ by 100")
    hall.act(Waive(CheckName.CLOCK, "known testbed fault"))


def shift_stamps(drive: FaultyDrive, off: Sequence[float]) -> None:
    """From now on the stamps of each topic are off by these times in turn, s."""

    def shifting() -> Edit:
        shifts = cycle([round(each * NS) for each in off])
        return lambda content: shift_stamp(content, next(shifts))

    for topic in drive.topics():
        drive.source.fake(topic, shifting())


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
        topic, converted = message.topic, content
        if signal is Signal.DOOR:
            topic, converted = self.door(content)
        elif signal is Signal.HANDLE:
            topic, converted = self.handle(content, round(content.wrench.force.x / GRAM))
        elif signal is not None and signal is not Signal.LATCH:
            ranges = [float(round(distance / MM)) for distance in content.ranges.tolist()]
            converted = self.strip(content, ranges)
        kind = converted.__msgtype__
        data = self.kinds.encode(kind, converted)
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
