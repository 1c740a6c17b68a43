"""What a referee can rely on when a false start holds the countdown."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive import score
from madrob_console.archive.check import EQUAL
from madrob_console.cli.session import UnattendedRun
from madrob_console.engine.requests import JumpTo
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.referee.acts import Abort, AcceptFalseStart, RestartCountdown, Start
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.run import Phase
from scoring.protocol import EventName, Outcome
from tests.madrob_console.engine.deck import Deck
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, set_value
from tests.madrob_console.engine.test_public_state import Hall, pull_the_handle

LONG = 10.0
"""s that a countdown is held, longer than it takes."""


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[Hall]:
    hall = Hall(tmp_path)
    yield hall
    hall.engine.close()


def hold(hall: Hall) -> float:
    """A run whose countdown of 2 s is held after half a second; returns what is left of it, s."""
    hall.prepare(make_setup())
    hall.act(Start())
    hall.wait(0.5)
    pull_the_handle(hall)
    left = hall.engine.snapshot().remaining
    assert left is not None
    assert 0.5 < left < 1.5
    return left


def same_everywhere(hall: Hall) -> None:
    """The run is completed; scored again and replayed it is the same."""
    hall.finish()
    scored = hall.engine.scored
    assert scored is not None
    assert scored.result.outcome is Outcome.COMPLETED
    assert next(score(hall.folder)).result == scored.result
    deck = Deck(hall.folder)
    deck.to_the_end()
    assert (deck.at.comparison, deck.at.agrees) == (EQUAL, True)


def test_nothing_starts_while_a_false_start_waits(hall: Hall) -> None:
    left = hold(hall)
    hall.wait(LONG)
    shown = hall.engine.snapshot()
    assert shown.run.phase is Phase.COUNTDOWN
    assert shown.remaining == left
    assert shown.elapsed == pytest.approx(-left)
    last = hall.published(REFEREE_STATE_TOPIC)[-2:]
    assert [state["phase"] for state in last] == ["countdown", "countdown"]
    assert [state["start_time"] is None for state in last] == [False, True]
    assert [line.relative for line in hall.engine.log.lines][-1] is None


def test_an_accepted_false_start_lets_the_countdown_go_on_where_it_was(hall: Hall) -> None:
    left = hold(hall)
    hall.wait(LONG)
    hall.act(AcceptFalseStart("nothing gained"))
    accepted = hall.engine.now()
    assert hall.engine.snapshot().remaining == pytest.approx(left)
    hall.wait_until(lambda: hall.engine.run.phase is Phase.RUNNING)
    assert hall.engine.run.start == pytest.approx(accepted + left, abs=1e-6)
    start = hall.engine.run.start
    assert [state["start_time"] for state in hall.published(REFEREE_STATE_TOPIC)][-2:] == [
        start
    ] * 2
    same_everywhere(hall)
    deck = Deck(hall.folder)
    deck.do(JumpTo(-left - 1.0))
    shown = deck.shown
    assert shown.run.phase is Phase.COUNTDOWN
    assert shown.remaining == pytest.approx(left, abs=0.03)


def test_a_countdown_that_begins_again_after_a_hold_is_whole(hall: Hall) -> None:
    hold(hall)
    hall.wait(LONG)
    hall.act(RestartCountdown())
    assert hall.engine.snapshot().remaining == pytest.approx(2.0, abs=0.1)
    same_everywhere(hall)
    assert hall.engine.run.undecided_false_start is None


def push_the_door(hall: Hall) -> None:
    hall.faulty.fake(DOOR, partial(set_value, value=0.4))
    hall.wait(0.3)
    hall.faulty.heal(DOOR)
    hall.wait(0.3)


def test_all_while_it_is_held_is_one_question_and_a_later_touch_another(hall: Hall) -> None:
    left = hold(hall)
    push_the_door(hall)
    hall.wait(LONG)
    pull_the_handle(hall)
    assert [mark.event for mark in hall.engine.run.false_starts] == [
        EventName.HANDLE_IS_TOUCHED,
        EventName.DOOR_OPENS,
    ]
    assert hall.engine.snapshot().remaining == left
    hall.act(AcceptFalseStart("the team set it up again"))
    assert {mark.accepted for mark in hall.engine.run.false_starts} == {"the team set it up again"}
    assert hall.engine.run.held is None
    hall.wait(0.1)
    pull_the_handle(hall)
    assert hall.engine.run.held is not None
    assert [mark.accepted is None for mark in hall.engine.run.false_starts] == [False, False, True]


def test_a_false_start_that_comes_with_the_start_holds_it(hall: Hall) -> None:
    hall.prepare(make_setup())
    hall.act(Start())
    hall.wait(1.8)
    assert hall.engine.run.start is not None
    hall.faulty.fake(HANDLE, partial(set_value, value=40.0))
    hall.clock.sleep(0.4)  # the engine stands still
    hall.engine.step(STEP)
    hall.faulty.heal(HANDLE)
    run = hall.engine.run
    assert (run.phase, run.held) == (Phase.COUNTDOWN, run.start)
    hall.wait(LONG)
    hall.act(AcceptFalseStart("nothing gained"))
    assert hall.engine.run.phase is Phase.RUNNING
    same_everywhere(hall)


def test_a_false_start_heard_of_after_the_start_is_undecided(hall: Hall) -> None:
    hall.prepare(make_setup())
    hall.act(Start())
    hall.wait(1.95)
    hall.faulty.deliver(lambda at_ns: at_ns + 60_000_000)
    hall.faulty.fake(HANDLE, partial(set_value, value=40.0))
    hall.wait(0.3)
    hall.faulty.heal(HANDLE)
    run = hall.engine.run
    assert (run.phase, run.held) == (Phase.RUNNING, None)
    assert run.undecided_false_start is not None
    assert run.start is not None
    assert run.undecided_false_start.time < run.start
    same_everywhere(hall)


def test_an_abort_while_it_is_held_ends_the_run_before_its_start(hall: Hall) -> None:
    left = hold(hall)
    hall.wait(LONG)
    hall.act(Abort("robot unsafe"))
    hall.finish()
    run = hall.engine.run
    assert (run.outcome, run.held) == (Outcome.ABORTED, None)
    assert hall.engine.snapshot().elapsed == pytest.approx(-left)
    assert next(score(hall.folder)).result == hall.engine.scored.result  # type: ignore[union-attr]


def test_an_engine_that_ends_while_it_is_held_leaves_a_run_that_never_began(
    hall: Hall, tmp_path: Path
) -> None:
    left = hold(hall)
    hall.wait(LONG)
    hall.wait_for_disk()
    entries, _ = read_journal(hall.folder / "journal.jsonl")
    assert [entry.what for entry in entries][-2:] == [Change.FALSE_START, Change.COUNTDOWN_HELD]
    assert rebuild(entries).held == hall.engine.run.held
    killed = shutil.copytree(hall.folder, tmp_path / "killed" / hall.folder.name)
    other = Drive(tmp_path / "killed")
    assert other.open(killed) is None
    other.finish()
    run = other.engine.run
    assert (run.outcome, run.phase, run.held) == (Outcome.INTERRUPTED, Phase.STOPPED, None)
    assert not any(step.done for step in other.engine.snapshot().steps)
    assert run.start is not None
    assert run.stop is not None
    assert run.start - run.stop == pytest.approx(left, abs=0.1)
    other.engine.close()


@pytest.mark.parametrize("accept", [None, "a sensor test"])
def test_a_run_without_screens_goes_on_after_a_false_start_only_if_told_so(
    hall: Hall,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    accept: str | None,
) -> None:
    monkeypatch.setattr(hall.engine, "open", lambda: None)  # it is open
    began = hall.engine.now()

    def pulled(message: Any) -> None:  # noqa: ANN401  of ROS
        if began + 2.0 < hall.engine.now() < began + 2.6:
            set_value(message, 40.0)

    hall.faulty.fake(HANDLE, pulled)
    run = UnattendedRun(hall.engine, None)
    practice = replace(make_setup(), practice=True)
    outcome = run.go(lambda simulated: practice, 20.0, None, accept)
    assert outcome is (Outcome.ABORTED if accept is None else Outcome.COMPLETED)
    (mark,) = hall.engine.run.false_starts
    assert mark.accepted == accept
    told = "--accept-false-start WHY lets a false start pass" in capsys.readouterr().out
    assert told is (accept is None)
