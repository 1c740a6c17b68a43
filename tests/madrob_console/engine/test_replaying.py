"""What a referee and a team can rely on when they look at a recorded run once more."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive import score
from madrob_console.archive.appeal import EQUAL
from madrob_console.common.errors import MadrobError
from madrob_console.engine.playback import (
    Faster,
    JumpTo,
    PlaybackCommand,
    PlayOrPause,
    SetSpeed,
    Skip,
    Slower,
)
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.acts import ACTS, Abort, DeclareTimeout, Finalise, Rule, SetUp, Start
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome, Step
from tests.madrob_console.engine.drive import Deck, document, make_setup
from tests.madrob_console.recorded_runs import INCIDENT_AT, STOP_AT, appealed, without_digests
from tests.slowly import slow_but_for

DOOR = "/madrob/door/angle"
NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def folder() -> Path:
    return appealed()


@pytest.fixture
def deck(folder: Path) -> Deck:
    return Deck(folder)


# ---------------------------------------------------------------- what is shown


def test_at_its_end_a_replay_shows_the_stored_result_to_the_last_digit(folder: Path) -> None:
    deck = Deck(folder, speed=0)
    shown, stored = deck.to_the_end(), document(folder)
    scored = next(score(folder)).result
    assert (shown.result, shown.result_source) == (scored, "replay")
    values = {str(name): i.value for name, i in scored.indicators.items()}
    assert values == {name: i["value"] for name, i in stored["indicators"].items()}
    assert (deck.at.comparison, deck.at.agrees) == (EQUAL, True)
    # the later decisions stand on it
    assert shown.run.closure is not None
    assert (shown.run.closure.team_word, shown.run.issue) == (TeamWord.ACKNOWLEDGED, 2)
    assert [line.text for line in shown.log if line.origin == "referee"][-5:] == [
        "referee denies step 3: a draught",
        "result signed by R. Eferee, protested by the team: they saw it differently",
        "re-issue: appeal granted",
        "referee confirms step 3: video",
        "result signed by R. Eferee, acknowledged by the team",
    ]


def test_what_sensors_and_referee_say_is_shown_as_it_was_at_that_time(deck: Deck) -> None:
    def shown_at(time: float) -> Snapshot:
        deck.do(JumpTo(time))
        return deck.shown

    counting = shown_at(-0.1).run  # what was up before the countdown is no false start
    assert (counting.phase, counting.false_starts) == (Phase.COUNTDOWN, ())
    before = shown_at(INCIDENT_AT - 0.1)
    assert [w.reason for w in before.run.waivers] == ["spring is warm"]
    assert (before.run.incidents, before.run.notes, before.steps[2].final) == ((), (), None)
    after = shown_at(INCIDENT_AT + 0.1)
    assert [mark.note for mark in after.run.incidents] == ["frame"]
    assert after.log[-2].text == "incident: collision: frame"
    assert after.log[-2].relative == pytest.approx(INCIDENT_AT, abs=0.03)
    late, stopped = shown_at(STOP_AT - 0.5), shown_at(STOP_AT + 0.2)
    assert (late.run.phase, late.door.is_open) == (Phase.RUNNING, True)
    assert late.steps[2].final is not None
    assert (stopped.run.outcome, stopped.result) == (Outcome.TIMEOUT, None)
    assert essence(shown_at(INCIDENT_AT - 0.1)) == essence(before)


# ---------------------------------------------------------------- controls


def test_it_plays_as_fast_as_is_asked(folder: Path) -> None:
    deck = Deck(folder, speed=0, work=0.002)
    deck.step(5)  # as fast as possible, which can be left where it is
    for speed in (1.0, 0.5, 2.0, 5.0):
        deck.do(SetSpeed(speed))
        before = deck.at.position
        deck.let_pass(0.4)
        assert deck.at.position - before == pytest.approx(0.4 * speed, abs=0.04 * speed + 0.02)
    deck.do(*[Slower()] * 5)
    found = [deck.at.speed]
    for _ in range(6):
        deck.do(Faster())
        found.append(deck.at.speed)
    assert found == [0.5, 1.0, 2.0, 5.0, 10.0, 10.0, 10.0]


def test_paused_it_stands_still_and_a_machine_that_slept_skips_nothing(
    deck: Deck,
) -> None:
    deck.let_pass(1.0)
    deck.do(PlayOrPause())
    before, position = deck.shown, deck.at.position
    deck.let_pass(5.0)
    assert deck.shown == before
    deck.do(PlayOrPause())
    deck.let_pass(1.0)
    assert deck.at.position == pytest.approx(position + 1.0, abs=0.03)
    deck.world.now += 3600.0
    deck.step()
    assert deck.at.position <= position + 1.15


def test_a_step_is_one_sample_of_the_door_there_and_back_and_steps_add_up(deck: Deck) -> None:
    deck.do(JumpTo(3.5), Skip(0.02))
    first, position = deck.shown, deck.at.position
    deck.do(Skip(0.02))
    assert deck.at.paused
    assert deck.at.position == pytest.approx(position + 0.02)
    door = [next(t for t in s.topics if t.topic == DOOR) for s in (first, deck.shown)]
    assert door[1].received == door[0].received + 1
    deck.do(Skip(-0.02))
    assert essence(deck.shown) == essence(first)
    for _ in range(5):
        assert deck.engine.control(Skip(-0.4)) is None
    deck.do(Skip(0.0))
    assert deck.at.position == pytest.approx(position - 2.0, abs=0.011)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        *((JumpTo(to), "the recording goes from -2.0 to 6.1 s") for to in (-60.0, 60.0, NAN, INF)),
        *((Skip(by), "give a number of seconds") for by in (NAN, -INF, 1e308)),
        *((SetSpeed(speed), "use 0 to 1000") for speed in (-1.0, NAN, INF, 1001.0)),
    ],
)
def test_what_leads_out_of_the_recording_is_refused_in_words(
    folder: Path, command: PlaybackCommand, words: str
) -> None:
    deck = Deck(folder)
    assert words in str(deck.engine.control(command))
    assert deck.at.jumping_to is None
    if isinstance(command, SetSpeed):
        with pytest.raises(MadrobError, match=words):
            Deck(folder, command.speed)


def test_at_the_end_it_stays_until_it_is_sent_back(deck: Deck) -> None:
    deck.to_the_end()
    end = deck.at.position
    deck.let_pass(2.0)
    assert deck.at.position == end == deck.at.end
    assert "goes back" in str(deck.engine.control(PlayOrPause()))
    deck.do(Skip(-1.0))
    assert deck.at.position == pytest.approx(end - 1.0)
    assert deck.shown.result is None


def test_long_work_comes_in_slices_so_that_keys_are_heeded(folder: Path) -> None:
    work = 0.002
    deck = Deck(folder, work=work)
    for stops in (False, True):
        assert deck.engine.control(JumpTo(5.0 - 4.0 * stops)) is None
        while deck.at.jumping_to is not None:
            began = deck.world.now
            deck.step()
            assert deck.world.now - began <= 10 * work
            if stops:
                deck.do(PlayOrPause())  # a pause ends a jump where it is
        assert deck.at.position == pytest.approx(5.0, abs=0.011) or stops
    assert deck.at.paused
    assert deck.at.position < 1.0


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


def essence(shown: Snapshot) -> Snapshot:
    """Without the numbers of the log's lines and what the keys have set."""
    lines = tuple(replace(line, number=0) for line in shown.log)
    return replace(shown, log=lines, playback=None)


@pytest.mark.slow
def test_what_is_shown_at_a_time_depends_on_no_key(
    folder: Path, request: pytest.FixtureRequest
) -> None:
    @settings(max_examples=request.config.getoption("--runs"))
    @given(commands=COMMANDS, at=st.floats(-2.0, 6.0))
    def prove(commands: list[PlaybackCommand], at: float) -> None:
        straight, pressed = Deck(folder), Deck(folder)
        straight.do(JumpTo(at))
        for command in commands:
            pressed.engine.control(command)
            pressed.step(3)
        pressed.do(JumpTo(at))
        assert essence(pressed.shown) == essence(straight.shown)
        assert essence(pressed.to_the_end()) == essence(straight.to_the_end())

    prove()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The same run, to be spoilt."""
    return shutil.copytree(appealed(), tmp_path / appealed().name)


# ---------------------------------------------------------------- nobody's record


def everything_in(root: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path): (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
        for path in root.rglob("*")
    }


def test_a_replay_writes_nothing_anywhere_near_the_results(copy: Path) -> None:
    before = everything_in(copy.parent)
    deck = Deck(copy)
    deck.do(JumpTo(4.0), JumpTo(1.0))
    deck.to_the_end()
    deck.engine.close()
    assert everything_in(copy.parent) == before


def test_no_act_does_anything_and_each_is_refused_with_the_reason(deck: Deck) -> None:
    deck.do(JumpTo(4.0))
    before = deck.shown
    acts = (Abort("x"), DeclareTimeout(), Rule(Step.TOUCH, confirmed=True, reason="x"))
    for act in (*acts, SetUp(make_setup()), Finalise(TeamWord.ABSENT, "me"), Start()):
        assert "nothing can be done to the run" in str(deck.engine.perform(act))
    assert set(deck.shown.refusals) >= {act.name for act in ACTS}
    assert deck.shown == before
    assert "leave it to open another one" in str(deck.engine.opening_refusal())


# ---------------------------------------------------------------- appeals


@pytest.mark.parametrize(
    ("edit", "words", "agrees"),
    [
        (lambda value: value + 1e-12, "equals the stored result to 1e-9: ", True),
        (lambda value: value * (1 + 2e-9), "differs from the stored result: ", False),
    ],
)
def test_a_stored_result_that_the_bag_does_not_give_is_told_value_by_value(
    copy: Path, edit: Callable[[float], float], words: str, agrees: bool
) -> None:
    without_digests(copy)  # else it would be told as a changed file
    stored = document(copy)
    indicator = stored["indicators"]["execution_time"]
    measured, indicator["value"] = indicator["value"], edit(indicator["value"])
    (copy / "result.json").write_text(json.dumps(stored))
    deck = Deck(copy)
    deck.to_the_end()
    told = f"execution time {measured!r}, stored {indicator['value']!r}"
    assert deck.at.comparison.startswith(f"{words}{told}")
    assert deck.at.agrees is agrees


@pytest.mark.parametrize(
    ("content", "told"),
    [("{", "result.json is damaged"), (None, "no stored result lies beside the recording")],
)
def test_without_a_usable_stored_result_it_says_so(
    copy: Path, content: str | None, told: str
) -> None:
    path = copy / "result.json"
    path.unlink()
    if content is not None:
        path.write_text(content)
    deck = Deck(copy)
    deck.to_the_end()
    assert told in deck.at.comparison


def test_a_journal_that_lost_a_line_is_told_from_the_one_in_the_bag(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(line for line in lines if "collision" not in line))
    assert any("the journal lacks 1 of the" in fault for fault in Deck(copy).shown.faults)


# ---------------------------------------------------------------- bad recordings


@pytest.mark.parametrize("share", slow_but_for([0.4, 0.8], 0.4))
def test_a_torn_bag_is_played_to_where_it_ends_and_that_is_said(copy: Path, share: float) -> None:
    (bag,) = copy.glob("*.mcap")
    os.truncate(bag, int(bag.stat().st_size * share))
    deck = Deck(copy)
    assert any("what comes before that is read" in fault for fault in deck.shown.faults)
    shown, scored = deck.to_the_end(), next(score(copy)).result
    assert (shown.result, shown.run.phase) == (scored, Phase.FINAL)
    assert any("what comes before" in remark for remark in scored.quality.remarks)
