"""Runs to be scored: recorded in virtual time, or put together from one that was."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

from madrob_console.archive.folders import RunName
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.archive.scored import read_recorded_run
from madrob_console.common.clock import NS, nanoseconds
from madrob_console.messages.codec import REFEREE_EVENT_TOPIC, encode_text
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from recorder.writer import BagWriter
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, make_setup

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
"""Behind the four bytes that say how a message is encoded."""


def simulated_run(results: Path, scenario: Scenario = Scenario.NOMINAL, seed: int = 0) -> Path:
    """Record a run of about 20 s in virtual time; returns its folder."""
    drive = Drive(results, scenario, seed)
    drive.whole_run(make_setup(timeout=20.0))
    drive.engine.close()
    assert drive.engine.folder is not None
    return drive.engine.folder


def copies(run: Path, count: int) -> list[Path]:
    """A run folder and so many beside it that there are `count`, each with another run number."""
    others = [
        run.with_name(run.name.replace("run_001", f"run_{number:03d}"))
        for number in range(2, count + 1)
    ]
    for other in others:
        shutil.copytree(run, other)
    return [run, *others]


def long_bag(run: Path, folder: Path, length: float, density: int = 1) -> Path:
    """A bag of a run that ends by its timeout: what `run` measured, again and again.

    Args:
        run: a completed run's folder; the door is closed at both its ends.
        folder: the bag is made in it.
        length: of the new run, s.
        density: each message comes so many times, evenly spread: sensors of so many times the rate.
    """
    recorded = read_recorded_run(run)
    record, start, stop = recorded.record, recorded.run.start, recorded.run.stop
    assert start is not None
    assert stop is not None
    long = replace(record, setup=replace(record.setup, timeout=length))
    target = folder / RunName(3, 1, 1).folder_name(0.0)
    folder.mkdir()
    entries = [entry for entry in recorded.entries if entry.time <= start]
    details = {"outcome": Outcome.TIMEOUT, "time": start + length}
    entries.append(Entry(start + length, Origin.CLOCK, Change.RUN_STOPS, details=details))
    types = MessageTypes()
    sensors = {mapping.topic for mapping in record.mappings}
    one = [m for m in recorded.bag.messages() if m.topic in sensors]
    cycle = [m for m in one if nanoseconds(start) <= m.receive_ns < nanoseconds(stop)]
    records = {RECORD_NAME: long.to_metadata()}
    with BagWriter(target, recorded.bag.topics(), records, block_when_full=True) as writer:
        for entry in entries[:-1]:
            writer.put_message(_line(entry, types))
        for message in _repeated(_dense(cycle, density), stop - start, length):
            writer.put_message(message)
        writer.put_message(_line(entries[-1], types))
    return target


def _line(entry: Entry, types: MessageTypes) -> RawMessage:
    at = nanoseconds(entry.time)
    data = encode_text(types, entry.to_json())
    return RawMessage(REFEREE_EVENT_TOPIC, "std_msgs/msg/String", data, at, at)


def _dense(messages: list[RawMessage], density: int) -> list[RawMessage]:
    step = NS // 50 // density
    dense = [_later(message, copy * step) for message in messages for copy in range(density)]
    return sorted(dense, key=lambda message: message.receive_ns)


def _repeated(cycle: list[RawMessage], period: float, length: float) -> Iterator[RawMessage]:
    """The cycle over and over, and a second more than the run's length for its post-roll."""
    end = cycle[0].receive_ns + nanoseconds(length + 1.0)
    for number in count():
        delay = number * nanoseconds(period)
        for message in cycle:
            later = _later(message, delay)
            if later.receive_ns > end:
                return
            yield later


def _later(message: RawMessage, delay: int) -> RawMessage:
    """The same message, measured and sent `delay` ns later."""
    sec, nanosec = _STAMP.unpack_from(message.data, _STAMP_AT)
    stamp = _STAMP.pack(*divmod(sec * NS + nanosec + delay, NS))
    data = message.data[:_STAMP_AT] + stamp + message.data[_STAMP_AT + _STAMP.size :]
    times = message.publish_ns + delay, message.receive_ns + delay
    return RawMessage(message.topic, message.type, data, *times)
