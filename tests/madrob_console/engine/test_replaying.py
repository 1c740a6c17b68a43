"""What a referee and a team can rely on when they look at a recorded run once more."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive import score
from madrob_console.archive.comparison import EQUAL
from madrob_console.engine.shown.playback import (
    Faster,
    JumpTo,
    PlaybackCommand,
    PlayOrPause,
    SetSpeed,
    Skip,
    Slower,
)
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.referee.on_record import TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome
from tests.madrob_console.engine.deck import Deck
from tests.madrob_console.recorded_runs import INCIDENT_AT, STOP_AT, appealed


@pytest.fixture(scope="module")
def folder() -> Path:
    return appealed()


# ---------------------------------------------------------------- what is shown


def test_at_its_end_a_replay_shows_the_stored_result_to_the_last_digit(folder: Path) -> None:
    deck = Deck(folder, speed=0)
    shown = deck.to_the_end()
    stored = json.loads((folder / "result.json").read_text())
    assert shown.result == next(score(folder)).result
    values = {str(name): i.value for name, i in shown.result.indicators.items()}
    assert values == {name: i["value"] for name, i in stored["indicators"].items()}
    assert (deck.at.comparison, deck.at.agrees) == (EQUAL, True)
    assert shown.result_source == "replay"


def test_the_referees_decisions_are_shown_when_they_were_made(folder: Path) -> None:
    deck = Deck(folder)
    deck.do(JumpTo(INCIDENT_AT - 0.1))
    assert [w.reason for w in deck.shown.run.waivers] == ["spring is warm"]
    assert (deck.shown.run.incidents, deck.shown.run.notes) == ((), ())
    deck.do(JumpTo(INCIDENT_AT + 0.1))
    assert [mark.note for mark in deck.shown.run.incidents] == ["frame"]
    assert deck.shown.log[-2].text == "incident: collision: frame"
    assert deck.shown.log[-2].relative == pytest.approx(INCIDENT_AT, abs=0.03)
    assert deck.shown.run.phase is Phase.RUNNING
    deck.do(JumpTo(STOP_AT + 0.2))
    assert (deck.shown.run.phase, deck.shown.run.outcome) == (Phase.STOPPED, Outcome.TIMEOUT)
    assert deck.shown.result is None


def test_after_the_end_the_later_decisions_stand_on_the_result(folder: Path) -> None:
    shown = Deck(folder).to_the_end()
    assert shown.run.phase is Phase.FINAL
    assert shown.run.closure is not None
    assert (shown.run.closure.team_word, shown.run.issue) == (TeamWord.ACKNOWLEDGED, 2)
    assert [ruling.reason for ruling in shown.run.rulings] == ["a draught", "video"]
    assert [line.text for line in shown.log if line.origin == "referee"][-5:] == [
        "referee denies step 3: a draught",
        "finalise: they saw it differently",
        "re-issue: appeal granted",
        "referee confirms step 3: video",
        "finalise",
    ]


def test_what_sensors_say_is_worked_out_up_to_the_time_that_is_shown(folder: Path) -> None:
    deck = Deck(folder)
    deck.do(JumpTo(2.0))
    before = deck.shown
    deck.do(JumpTo(4.5))
    assert deck.shown.steps[2].final is not None
    assert deck.shown.door.is_open
    deck.do(JumpTo(2.0))
    assert deck.shown.steps[2].final is None
    assert replace(deck.shown, log=()) == replace(before, log=())
    assert [line.text for line in deck.shown.log] == [line.text for line in before.log]


def test_what_was_up_before_the_countdown_is_no_false_start_in_the_replay_either(
    folder: Path,
) -> None:
    deck = Deck(folder)  # the handle was not zeroed: it counts as pressed all the time
    deck.do(JumpTo(-0.1))
    assert deck.shown.run.phase is Phase.COUNTDOWN
    assert deck.shown.run.false_starts == ()


# ---------------------------------------------------------------- controls


def test_it_plays_as_fast_as_is_asked(folder: Path) -> None:
    deck = Deck(folder)
    for speed in (1.0, 0.5, 2.0, 5.0):
        deck.do(SetSpeed(speed))
        before = deck.at.position
        deck.let_pass(0.4)
        assert deck.at.position - before == pytest.approx(0.4 * speed, abs=0.02 * speed + 0.02)


def test_as_fast_as_possible_can_be_left_where_it_is(folder: Path) -> None:
    deck = Deck(folder, speed=0, work=0.002)
    deck.step(5)
    deck.do(SetSpeed(1.0))
    before = deck.at.position
    deck.let_pass(0.5)
    assert deck.at.position - before == pytest.approx(0.5, abs=0.15)


def test_the_speed_keys_go_through_all_speeds_and_stop_at_the_ends(folder: Path) -> None:
    deck = Deck(folder)
    deck.do(*[Slower()] * 3)
    found = [deck.at.speed]
    for _ in range(6):
        deck.do(Faster())
        found.append(deck.at.speed)
    assert found == [0.5, 1.0, 2.0, 5.0, 10.0, 10.0, 10.0]


def test_paused_it_stands_still_until_it_goes_on(folder: Path) -> None:
    deck = Deck(folder)
    deck.let_pass(1.0)
    deck.do(PlayOrPause())
    before = deck.shown
    deck.let_pass(5.0)
    assert deck.shown == before
    deck.do(PlayOrPause())
    deck.let_pass(1.0)
    assert before.playback is not None
    assert deck.at.position == pytest.approx(before.playback.position + 1.0, abs=0.03)


def test_a_step_is_one_sample_of_the_door_there_and_back(folder: Path) -> None:
    deck = Deck(folder)
    deck.do(JumpTo(3.5), Skip(0.02))
    first = deck.shown
    deck.do(Skip(0.02))
    second = deck.shown
    assert first.playback is not None
    assert deck.at.paused
    assert deck.at.position == pytest.approx(first.playback.position + 0.02)
    door = [next(t for t in s.topics if t.topic == "/madrob/door/angle") for s in (first, second)]
    assert door[1].received == door[0].received + 1
    deck.do(Skip(-0.02))
    assert replace(deck.shown, log=()) == replace(first, log=())


def test_steps_that_come_faster_than_they_are_done_add_up(folder: Path) -> None:
    deck = Deck(folder)
    deck.do(JumpTo(4.0))
    for _ in range(5):
        assert deck.engine.control(Skip(-0.5)) is None
    deck.do(Skip(0.0))
    assert deck.at.position == pytest.approx(1.5, abs=0.011)


def test_a_jump_out_of_the_recording_is_refused_in_words(folder: Path) -> None:
    deck = Deck(folder)
    for time in (-60.0, 60.0, float("nan"), float("inf")):
        refused = deck.engine.control(JumpTo(time))
        assert refused is not None
        assert "the recording goes from -2.0 to 6.1 s" in refused
    for skip in (float("nan"), float("-inf"), 1e308):
        assert deck.engine.control(Skip(skip)) == "give a number of seconds"
    for speed in (-1.0, float("nan"), float("inf")):
        assert "use 0 to 1000" in str(deck.engine.control(SetSpeed(speed)))
    assert deck.at.jumping_to is None


def test_at_the_end_it_stays_until_it_is_sent_back(folder: Path) -> None:
    deck = Deck(folder)
    deck.to_the_end()
    end = deck.at.position
    deck.let_pass(2.0)
    assert deck.at.position == end == deck.at.end
    assert "goes back" in str(deck.engine.control(PlayOrPause()))
    deck.do(Skip(-1.0))
    assert deck.at.position == pytest.approx(end - 1.0)
    assert deck.shown.result is None


def test_a_machine_that_slept_skips_nothing(folder: Path) -> None:
    deck = Deck(folder)
    deck.let_pass(0.5)
    position = deck.at.position
    deck.world.now += 3600.0
    deck.step()
    assert deck.at.position <= position + 0.15


def test_long_work_comes_in_slices_so_that_keys_are_heeded(folder: Path) -> None:
    work = 0.002
    deck = Deck(folder, work=work)
    assert deck.engine.control(JumpTo(5.0)) is None
    while deck.at.jumping_to is not None:
        began = deck.world.now
        deck.step()
        assert deck.world.now - began <= 10 * work
    assert deck.at.position == pytest.approx(5.0, abs=0.011)


def test_a_pause_ends_a_jump_where_it_is(folder: Path) -> None:
    deck = Deck(folder, work=0.002)
    deck.engine.control(JumpTo(5.0))
    deck.step(2)
    deck.do(PlayOrPause())
    assert deck.at.paused
    assert deck.at.position < 5.0


COMMANDS = st.lists(
    st.one_of(
        st.builds(PlayOrPause),
        st.builds(Faster),
        st.builds(Slower),
        st.builds(SetSpeed, st.sampled_from([0.0, 3.0, 1000.0])),
        st.builds(Skip, st.sampled_from([0.02, -0.02, 1.0, -1.0, 0.3])),
        st.builds(JumpTo, st.floats(-2.0, 6.0)),
    ),
    max_size=6,
)


def same_whatever_was_pressed(folder: Path, commands: list[PlaybackCommand], at: float) -> None:
    straight, pressed = Deck(folder), Deck(folder)
    straight.do(JumpTo(at))
    for command in commands:
        pressed.engine.control(command)
        pressed.step(3)
    pressed.do(JumpTo(at))
    assert essence(pressed.shown) == essence(straight.shown)
    assert essence(pressed.to_the_end()) == essence(straight.to_the_end())


def essence(shown: Snapshot) -> Snapshot:
    """Without the numbers of the log's lines and what the keys have set."""
    lines = tuple(replace(line, number=0) for line in shown.log)
    return replace(shown, log=lines, playback=None)


@settings(max_examples=2)
@given(commands=COMMANDS, at=st.floats(-2.0, 6.0))
def test_what_is_shown_at_a_time_depends_on_no_key(
    folder: Path, commands: list[PlaybackCommand], at: float
) -> None:
    same_whatever_was_pressed(folder, commands, at)


@pytest.mark.slow
def test_what_is_shown_at_a_time_depends_on_no_key_at_length(
    folder: Path, request: pytest.FixtureRequest
) -> None:
    @settings(max_examples=request.config.getoption("--runs"))
    @given(commands=COMMANDS, at=st.floats(-2.0, 6.0))
    def prove(commands: list[PlaybackCommand], at: float) -> None:
        same_whatever_was_pressed(folder, commands, at)

    prove()
