"""What the referee publishes for robots, as its schemas say; the robot's answer to the start."""

from __future__ import annotations

import jsonschema
import pytest

from madrob_console.engine import state_schemas
from madrob_console.engine.snapshot import Weight
from madrob_console.messages.codec import (
    REFEREE_ELAPSED_TOPIC,
    REFEREE_EVENT_TOPIC,
    REFEREE_LEVEL_TOPIC,
    REFEREE_RUNNING_TOPIC,
    REFEREE_STATE_TOPIC,
    ROBOT_FINISHED_TOPIC,
    ROBOT_STARTED_TOPIC,
    encode_text,
)
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    RestartCountdown,
    Rule,
    Void,
)
from madrob_console.referee.flags import data_remarks
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase
from madrob_console.ui.panes.notices import banner
from scoring.protocol import Outcome, Step
from tests.madrob_console.engine.drive import FaultyDrive, document, make_setup, signed
from tests.madrob_console.engine.spoilt import HANDLE, Fault

TYPES = MessageTypes()
EMPTY = TYPES.encode("std_msgs/msg/Empty", TYPES.make("std_msgs/msg/Empty"))


PLAIN = (REFEREE_RUNNING_TOPIC, REFEREE_LEVEL_TOPIC, REFEREE_ELAPSED_TOPIC)


DETAILS = {
    Change.COUNTDOWN_BEGINS: {"time"},
    Change.COUNTDOWN_HELD: {"time"},
    Change.RUN_STARTS: {"event", "time"},
    Change.ROBOT_STARTS: {"time"},
    Change.ROBOT_SAYS: {"time"},
    Change.EVENT: {"event", "time"},
    Change.FALSE_START: {"event", "time"},
    Change.TIMEOUT_ELAPSED: {"time"},
    Change.RUN_STOPS: {"outcome", "time"},
    Change.FAULT: {"kind", "time"},
    Change.RESULT_WRITTEN: {"issue"},
}
"""What the guide's page for robots promises in the details of a line."""


def make_every_kind_of_run(hall: FaultyDrive) -> None:
    hall.count_down(make_setup())
    hall.wait(0.5)
    hall.touch()
    hall.act(RestartCountdown("it touched the handle"))
    hall.hear(ROBOT_STARTED_TOPIC, EMPTY, after=0.25)
    hall.hear(ROBOT_FINISHED_TOPIC, encode_text(TYPES, "done"), after=0.5)
    hall.finish()
    hall.act(signed(hall.engine.snapshot()), Void("a person in the way"))
    hall.count_down(make_setup(run_number=2))
    hall.wait(0.5)
    hall.touch()
    hall.act(AcceptFalseStart("it stood still again"))
    hall.wait_until(lambda: hall.engine.run.phase is Phase.RUNNING)
    hall.act(Abort("robot unsafe"))
    hall.finish()
    hall.count_down(make_setup(run_number=3, timeout=5.0))
    hall.wait_until(lambda: hall.engine.run.phase is Phase.RUNNING)
    hall.source.spoil(HANDLE, Fault.DIES)
    hall.finish()


def test_all_that_is_published_in_any_phase_is_as_the_schemas_say(
    hall: FaultyDrive,
) -> None:
    make_every_kind_of_run(hall)
    published = {
        "state": hall.published(REFEREE_STATE_TOPIC),
        "event": hall.published(REFEREE_EVENT_TOPIC),
    }
    for name, messages in published.items():
        schema = state_schemas()[name]
        for message in messages:
            jsonschema.validate(message, schema)
    assert {state["phase"] for state in published["state"]} == set(Phase)
    assert {None, "completed", "aborted", "timeout"} == {s["outcome"] for s in published["state"]}
    details = {
        what: [set(e["details"]) for e in published["event"] if e["what"] == what]
        for what in DETAILS
    }
    assert all(details.values())
    assert [what for what, told in details.items() if set.intersection(*told) < DETAILS[what]] == []
    (start, *_) = (e for e in published["event"] if e["what"] == Change.RUN_STARTS)
    running = next(s for s in published["state"] if s["phase"] == Phase.RUNNING)
    assert start["details"] == {"event": "benchmark_start", "time": running["start_time"]}


def test_the_schema_of_the_state_has_the_keys_of_the_state_alone(hall: FaultyDrive) -> None:
    (state, *_) = hall.published(REFEREE_STATE_TOPIC)
    jsonschema.validate(state, state_schemas()["state"])
    (part,) = (p for p in state_schemas()["state"]["$defs"].values() if "properties" in p)
    assert part["required"] == list(part["properties"]) == list(state)


def test_the_robot_s_words_stand_in_screen_journal_bag_and_result_and_decide_nothing(
    hall: FaultyDrive,
) -> None:
    hall.count_down(make_setup(timeout=20.0))
    hall.hear(ROBOT_STARTED_TOPIC, EMPTY, 0.031)
    gives_up = encode_text(TYPES, "\x1b[31mI gave\nup" + "p" * 100)
    hall.hear(ROBOT_FINISHED_TOPIC, gives_up, 0.5)
    hall.wait_until(lambda: hall.engine.run.phase is Phase.RUNNING)
    hall.wait(1.0)
    words = "I gave up" + "p" * 51
    text, _ = banner(hall.engine.snapshot())
    assert f"the robot says '{words}'; F9 declares the timeout" in text
    (line,) = (one for one in hall.engine.log.lines if "robot says" in one.text)
    assert (line.text, line.weight) == (f"robot says: {words}", Weight.NOTICE)
    assert line.relative == pytest.approx(0.5, abs=1e-6)
    assert hall.same_everywhere().outcome is Outcome.COMPLETED  # the robot went on
    stored, scored = document(hall.folder), hall.scored()
    assert stored["robot_start"] - hall.start_time == pytest.approx(0.031, abs=1e-6)
    assert "the robot answered to the start 0.031 s after it" in stored["quality"]["remarks"]
    assert data_remarks(scored.result.quality) == stored["quality"]["remarks"]
    assert (scored.run.robot_start, scored.run.robot_words) == (stored["robot_start"], words)
    assert hall.recorded(ROBOT_STARTED_TOPIC) == [EMPTY]
    assert hall.recorded(ROBOT_FINISHED_TOPIC) == [gives_up]


def test_standard_types_say_whether_the_run_goes_on_how_long_and_the_level(
    hall: FaultyDrive,
) -> None:
    hall.wait(0.1)
    hall.whole_run(make_setup())
    hall.wait(2.0)
    published = {topic: hall.published(topic) for topic in PLAIN}
    elapsed = published[REFEREE_ELAPSED_TOPIC]
    assert published == {
        REFEREE_RUNNING_TOPIC: [False, False, True, False],
        REFEREE_LEVEL_TOPIC: [0, 0, 1, 3, 4, 5, 6],
        REFEREE_ELAPSED_TOPIC: [n / 10 for n in range(len(elapsed))],
    }
    assert elapsed[-1] > 13.0
    for topic in PLAIN:
        said = [m.data for m in hall.source.published if m.topic == topic]
        before = int(topic != REFEREE_ELAPSED_TOPIC)  # the engine's first ones
        assert hall.recorded(topic) == said[before:]
    hall.act(Rule(Step.LOCK, confirmed=False, reason="it was not locked"))
    hall.wait(2.0)
    assert hall.published(REFEREE_LEVEL_TOPIC)[-1] == 5  # as the result that was written anew
