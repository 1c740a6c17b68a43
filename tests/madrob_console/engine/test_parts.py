"""What crosses the socket of the state: what has changed, encoded once, and all of it at first."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import msgspec
import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine import wire
from madrob_console.engine.client import OWN, SIGN_OF_LIFE, Incoming, Outgoing
from madrob_console.engine.requests import Role
from madrob_console.engine.snapshot import Pulse, RightToAct, Snapshot
from tests.madrob_console.engine.drive import Drive, make_setup

RIGHT = RightToAct(Role.WATCH, "ada@hall")


def state_of(frame: bytes) -> wire.State:
    message = wire.message_of(frame[wire.LENGTH.size :])
    assert isinstance(message, wire.State)
    return message


@pytest.fixture
def snapshot(tmp_path: Path) -> Snapshot:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    shown = drive.engine.snapshot()
    drive.engine.close()
    assert shown.result is not None
    return shown


def test_a_screen_shows_what_the_engine_has(snapshot: Snapshot) -> None:
    sent, screen = Outgoing(), Incoming()
    sent.show(snapshot, 0.0)
    assert screen.apply_state(wire.State({OWN: wire.raw(RIGHT)})) is None
    assert screen.apply_state(state_of(sent.since(0))) == replace(snapshot, right=RIGHT)


def test_only_what_has_changed_crosses(snapshot: Snapshot) -> None:
    sent, screen = Outgoing(), Incoming()
    sent.show(snapshot, 0.0)
    screen.apply_state(wire.State({OWN: wire.raw(RightToAct())}))
    screen.apply_state(state_of(sent.since(0)))
    later = replace(snapshot, time=snapshot.time + 0.1, faults=("the door is on fire",))
    sent.show(later, 0.1)
    news = state_of(sent.since(1))
    assert set(news.parts) == {"time", "faults"}
    assert screen.apply_state(news) == later


def test_a_screen_that_was_held_up_gets_the_latest_of_each_part(snapshot: Snapshot) -> None:
    sent = Outgoing()
    sent.show(snapshot, 0.0)
    one = replace(snapshot, faults=("one",), disk_free=1)
    two = replace(one, faults=("two",))
    sent.show(one, 0.1)
    sent.show(two, 0.2)
    parts = state_of(sent.since(1)).parts
    assert {name: msgspec.msgpack.decode(raw) for name, raw in parts.items()} == {
        "faults": ["two"],
        "disk_free": 1,
    }
    assert set(state_of(sent.since(2)).parts) == {"faults"}


def test_however_many_screens_there_are_it_is_encoded_once(snapshot: Snapshot) -> None:
    sent = Outgoing()
    sent.show(snapshot, 0.0)
    assert sent.since(0) is sent.since(0)


def test_nothing_crosses_but_a_sign_of_life_where_nothing_happens(snapshot: Snapshot) -> None:
    sent = Outgoing()
    sent.show(snapshot, 0.0)
    versions, size = set(), 0
    for tick in range(1, 101):  # ten seconds
        sent.show(replace(snapshot, time=snapshot.time + tick / 10), tick / 10)
        if sent.version not in versions and sent.version > 1:
            size += len(sent.since(sent.version - 1))
        versions.add(sent.version)
    assert len(versions) <= 10.0 / SIGN_OF_LIFE + 1
    assert size < 1_000


def test_of_a_core_that_stands_still_only_its_age_crosses(snapshot: Snapshot) -> None:
    sent = Outgoing()
    sent.show(snapshot, 0.0)
    size = 0
    for tick in range(1, 101):  # ten seconds
        before = sent.version
        sent.show(replace(snapshot, pulse=Pulse(core=tick // 10)), tick / 10)
        if sent.version > before:
            size += len(sent.since(before))
    assert state_of(sent.since(sent.version - 1)).parts.keys() == {"pulse"}
    assert size < 2_000


def test_a_paused_replay_whose_time_stands_still_gives_signs_of_life(snapshot: Snapshot) -> None:
    sent = Outgoing()
    sent.show(snapshot, 0.0)
    sent.show(replace(snapshot), SIGN_OF_LIFE)
    assert sent.version == 2
    assert state_of(sent.since(1)).parts == {}


def test_every_part_is_of_the_state_and_has_its_type(snapshot: Snapshot) -> None:
    for name in ("time", "run", "log", "result"):
        with pytest.raises(MadrobError, match="not a message of an engine"):
            Incoming().apply_state(wire.State({name: wire.raw("no")}))
    with pytest.raises(MadrobError, match="not a message of an engine"):
        Incoming().apply_state(wire.State({"rm -rf": wire.raw(1)}))
    assert OWN in {field.name for field in fields(snapshot)}
