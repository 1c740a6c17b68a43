"""What a referee can rely on when a false start holds the countdown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive.collection import matches
from madrob_console.archive.history import History
from madrob_console.cli.unattended_run import UnattendedRun
from madrob_console.engine.playback import JumpTo
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.referee.acts import (
    Abort,
    AcceptDoubts,
    AcceptFalseStart,
    Finalise,
    Reissue,
    RestartCountdown,
    Start,
)
from madrob_console.referee.flags import waiting_doubts
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import EventName, Outcome
from tests.madrob_console.engine.drive import Deck, Drive, FaultyDrive, document, make_setup
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, set_value

LONG = 3.0
"""s that a countdown is held, longer than it takes."""
SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")


def hold(hall: FaultyDrive) -> float:
    """A run whose countdown of 2 s is held after half a second; returns what is left of it, s."""
    hall.prepare(make_setup())
    hall.act(Start())
    hall.wait(0.5)
    hall.touch()
    left = hall.engine.snapshot().remaining
    assert left is not None
    assert 0.5 < left < 1.5
    return left


def test_a_held_countdown_goes_on_where_it_was_once_all_is_accepted_or_begins_anew(
    hall: FaultyDrive,
) -> None:
    left = hold(hall)
    hall.touch(DOOR, 0.4)  # all while it is held is one question
    hall.wait(LONG)
    shown, states = hall.engine.snapshot(), hall.published(REFEREE_STATE_TOPIC)
    assert (shown.run.phase, shown.remaining) == (Phase.COUNTDOWN, left)
    assert shown.elapsed == pytest.approx(-left)
    assert [mark.event for mark in shown.run.false_starts] == [
        EventName.HANDLE_IS_TOUCHED,
        EventName.DOOR_OPENS,
    ]
    assert [state["start_time"] is None for state in states[-2:]] == [False, True]
    assert [line.relative for line in hall.engine.log.lines][-1] is None
    hall.act(AcceptFalseStart("nothing gained"))
    again = hall.engine.snapshot()
    assert (again.run.held, again.remaining) == (None, pytest.approx(left))
    assert {mark.accepted for mark in again.run.false_starts} == {"nothing gained"}
    assert hall.start_time == pytest.approx(again.time + left, abs=1e-6)
    assert hall.published(REFEREE_STATE_TOPIC)[-1]["start_time"] == hall.start_time
    hall.wait(0.1)
    hall.touch()  # a later touch is another one
    marks = hall.engine.run.false_starts
    assert [mark.accepted is None for mark in marks] == [False, False, True]
    hall.wait(LONG)
    hall.act(RestartCountdown())
    assert hall.engine.snapshot().remaining == pytest.approx(2.0, abs=0.1)
    assert hall.same_everywhere().outcome is Outcome.COMPLETED
    assert hall.engine.run.undecided_false_start is None
    deck = Deck(hall.folder)
    deck.do(JumpTo(-2.5))
    assert (deck.shown.run.phase, deck.shown.run.held is None) == (Phase.COUNTDOWN, False)


def test_an_undecided_false_start_is_signed_only_by_who_knows_of_it(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    hall.prepare(make_setup())
    hall.act(Start())
    hall.wait(1.95)
    hall.source.deliver(lambda at_ns: at_ns + 60_000_000)  # it is heard of after the start
    hall.touch()
    run = hall.engine.run
    assert (run.phase, run.held) == (Phase.RUNNING, None)
    assert run.undecided_false_start is not None
    assert run.undecided_false_start.time < hall.start_time
    assert hall.same_everywhere().outcome is Outcome.COMPLETED
    words = "1 false start UNDECIDED (handle touched)"

    def flagged() -> str:
        """In the words of result, list and screen, which are the same."""
        stored = document(hall.folder)["flags"][0]["words"]
        (listed,) = History(tmp_path).refresh()
        assert stored == listed.flags[0].words == hall.engine.snapshot().flags[0].words
        assert matches(listed, "undecided") is (stored == words)
        return str(stored)

    hall.act(AcceptDoubts(waiting_doubts(hall.engine.situation().indicators, ()), "late messages"))
    refused = hall.engine.perform(SIGNED)
    assert refused == f"decide it first, or sign it knowing so: {words}"
    hall.act(replace(SIGNED, undecided=(words,)))
    assert flagged() == words
    hall.act(Reissue("it was seen"), AcceptFalseStart("a draught"), SIGNED)
    assert flagged() == "1 false start accepted"
    assert document(hall.folder)["false_starts"][0]["accepted"] == "a draught"


def test_a_run_that_is_aborted_or_cut_off_while_it_is_held_never_began(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    left = hold(hall)
    hall.wait(LONG)
    killed = hall.cut_off_copy(tmp_path / "killed")
    entries, _ = read_journal(killed / "journal.jsonl")
    assert [entry.what for entry in entries][-2:] == [Change.FALSE_START, Change.COUNTDOWN_HELD]
    assert rebuild(entries).held == hall.engine.run.held
    hall.act(Abort("robot unsafe"))
    other = Drive(tmp_path / "killed")
    assert other.open(killed) is None
    for drive, outcome in ((hall, Outcome.ABORTED), (other, Outcome.INTERRUPTED)):
        drive.finish()
        shown = drive.engine.snapshot()
        assert (shown.run.outcome, shown.run.held) == (outcome, None)
        assert shown.elapsed == pytest.approx(-left, abs=0.1)
        assert drive.rescored() == shown.result
        assert not any(step.done for step in shown.steps)
        drive.engine.close()


@pytest.mark.parametrize("accept", [None, "a sensor test"])
def test_a_run_without_screens_goes_on_after_a_false_start_only_if_told_so(
    hall: FaultyDrive,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    accept: str | None,
) -> None:
    monkeypatch.setattr(hall.engine, "open", lambda: None)  # it is open
    began = hall.engine.now()

    def pulled(message: Any) -> None:  # noqa: ANN401  of ROS
        if began + 2.0 < hall.engine.now() < began + 2.6:
            set_value(message, 40.0)

    hall.source.fake(HANDLE, pulled)
    run = UnattendedRun(hall.engine, None)
    practice = replace(make_setup(), practice=True)
    outcome = run.go(lambda simulated: practice, 20.0, None, accept)
    assert outcome is (Outcome.ABORTED if accept is None else Outcome.COMPLETED)
    (mark,) = hall.engine.run.false_starts
    assert mark.accepted == accept
    told = "--accept-false-start WHY lets a false start pass" in capsys.readouterr().out
    assert told is (accept is None)
