"""Acts and a disk that does not answer: at once or on disk first, and never late."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import RunPath
from madrob_console.archive.run_journal import find_unfinished
from madrob_console.archive.scored import score_opened
from madrob_console.engine.durable_acts import DURABLE_WITHIN
from madrob_console.messages.codec import REFEREE_STATE_TOPIC, decode_text
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    Correct,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    TakeBack,
    Void,
)
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import rebuild
from madrob_console.referee.records import DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from scoring.protocol import Outcome, Side, Step
from tests.madrob_console.engine.drive import PULL, STEP, Drive, make_setup
from tests.madrob_console.engine.held_disk import HeldDisk

SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")
TOO_LONG = "the disk did not take it within 2 s: it is withdrawn"


class Hall:
    """An engine on a disk that can be held."""

    def __init__(self, results: Path, scenario: Scenario = Scenario.NOMINAL) -> None:
        self.disk = HeldDisk()
        self.results = results
        self.drive = Drive(results, scenario, keepers=self.disk.keepers())
        self.engine = self.drive.engine
        self.told: list[str | None] = []

    def submit(self, act: Act, name: str = "") -> None:
        self.engine.submit(act, self.told.append, id=name)

    def pass_time(self, duration: float) -> None:
        """Steps of the engine, with the machine's clock beside its own."""
        end = self.engine.now() + duration
        while (before := self.engine.now()) < end:
            self.engine.step(STEP)
            self.disk.now += self.engine.now() - before

    def journal(self, folder: Path | None = None) -> list[Entry]:
        folder = folder or self.engine.folder
        assert folder is not None
        return list(read_journal(folder / "journal.jsonl")[0])

    def states(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """What robot and testbed are told from now on."""
        types, told, publish = MessageTypes(), list[str](), self.drive.source.publish

        def hear(message: RawMessage) -> None:
            if message.topic == REFEREE_STATE_TOPIC:
                told.append(json.loads(decode_text(types, message.data))["phase"])
            publish(message)

        monkeypatch.setattr(self.drive.source, "publish", hear)
        return told


@pytest.fixture
def hall(tmp_path: Path) -> Hall:
    return Hall(tmp_path)


@pytest.mark.parametrize("act", [Abort("enough"), DeclareTimeout("gave up")])
def test_abort_and_declared_timeout_wait_for_no_disk(
    act: Act, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall = Hall(tmp_path, Scenario.NO_TOUCH)
    hall.drive.start(make_setup())
    hall.pass_time(1.0)
    hall.disk.held = True
    states = hall.states(monkeypatch)
    hall.submit(act)
    assert hall.told == [None]
    hall.pass_time(0.2)
    assert hall.engine.run.phase is Phase.STOPPED
    assert states == ["stopped"]
    wait = [act.name] if isinstance(act, Abort) else [act.name, "run stops"]
    assert hall.engine.unwritten[0] == len(wait)
    assert [entry.what for entry in hall.journal()][-1] == "run starts"
    hall.pass_time(10.0)
    assert hall.engine.unwritten[1] == pytest.approx(10.2, abs=0.1)
    assert hall.engine.scored is None
    hall.disk.come_back()
    hall.pass_time(0.1)
    assert hall.engine.unwritten == (0, 0.0)
    what = [entry.what for entry in hall.journal()]
    assert what[what.index("run starts") + 1 :] == [*wait, "result written"]
    assert hall.engine.scored is not None


def test_a_timeout_elapses_while_the_disk_is_silent(tmp_path: Path) -> None:
    hall = Hall(tmp_path, Scenario.NO_TOUCH)
    hall.drive.start(make_setup(timeout=8.0))
    hall.disk.held = True
    hall.pass_time(8.2)
    run = hall.engine.run
    assert (run.phase, run.outcome) == (Phase.STOPPED, Outcome.TIMEOUT)
    assert run.start is not None
    assert run.stop == run.start + 8.0


def test_a_note_is_taken_while_the_disk_is_silent_and_written_when_it_is_back(hall: Hall) -> None:
    hall.drive.start(make_setup())
    hall.disk.held = True
    hall.submit(AddNote("the disk hangs"))
    assert hall.told == [None]
    hall.disk.come_back()
    hall.pass_time(STEP)
    assert hall.journal()[-1].reason == "the disk hangs"


def test_a_run_that_is_left_with_a_line_on_its_way_is_soon_on_disk(hall: Hall) -> None:
    hall.drive.whole_run(make_setup())
    folder = hall.engine.folder
    hall.pass_time(1.0)
    hall.disk.held = True
    hall.submit(AddNote("afterwards"))
    while not hall.engine.situation().scored:
        hall.disk.answer_one()
        hall.pass_time(STEP)
    assert hall.engine.unwritten[0] == 1
    hall.submit(SetUp(make_setup(run_number=2)))
    assert hall.told == [None, None]
    hall.disk.come_back()
    hall.pass_time(3 * STEP)
    assert hall.journal(folder)[-1].what == "result written"
    assert not any("waits for the disk" in fault for fault in hall.engine.snapshot().faults)


def test_a_start_that_is_not_on_disk_in_time_is_withdrawn_for_good(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.prepare(make_setup())
    states = hall.states(monkeypatch)
    hall.disk.held = True
    hall.submit(Start())
    assert hall.told == []
    hall.pass_time(DURABLE_WITHIN + 2 * STEP)
    assert hall.told == [TOO_LONG]
    hall.pass_time(20.0)
    hall.disk.come_back()
    hall.pass_time(20.0)
    assert hall.told == [TOO_LONG]
    assert hall.engine.run.phase is Phase.READY
    assert states == []
    assert "start withdrawn" in hall.engine.log.lines[-1].text
    hall.drive.whole_run(make_setup())  # it had not begun: nothing of it is left
    hall.engine.close()


def in_the_middle(
    hall: Hall, monkeypatch: pytest.MonkeyPatch, happens: Callable[[], None]
) -> list[int]:
    """Let something happen while the disk syncs the next line of a journal."""
    fsync, seen = os.fsync, list[int]()

    def hangs(file: int) -> None:
        written = Path(f"/proc/self/fd/{file}").readlink()
        if written.name == "journal.jsonl" and not seen:
            seen.append(file)
            happens()
        fsync(file)

    monkeypatch.setattr(os, "fsync", hangs)
    return seen


def test_a_start_that_hangs_half_made_is_withdrawn_and_stays_on_record(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.prepare(make_setup())
    seen = in_the_middle(hall, monkeypatch, lambda: hall.pass_time(DURABLE_WITHIN + 2 * STEP))
    hall.submit(Start())
    assert seen
    assert hall.told == [TOO_LONG]
    hall.pass_time(10.0)
    assert hall.engine.run.phase is Phase.READY
    assert hall.engine.folder is None
    (folder,) = hall.results.glob("practice/subject_*")
    lines = hall.journal(folder)
    assert lines[-1].what == "withdrawn"
    assert lines[-1].details["act"] == "start"
    assert rebuild(lines).phase is Phase.READY
    assert find_unfinished(hall.results) == ()
    hall.submit(Start())
    hall.pass_time(1.0)
    assert hall.told[-1] is not None
    assert "use run 2" in hall.told[-1]
    hall.drive.whole_run(make_setup(run_number=2))
    hall.engine.close()


def test_while_a_start_is_written_the_state_says_so_and_nothing_else_begins(hall: Hall) -> None:
    hall.drive.prepare(make_setup())
    hall.disk.held = True
    hall.submit(Start())
    hall.pass_time(0.5)
    shown = hall.engine.snapshot()
    assert hall.engine.writing == "start"
    assert hall.engine.busy
    words = "the disk has not taken the start yet: wait for it"
    for act in (Start(), SetUp(make_setup(run_number=2)), ConfirmPose(), AddNote("hm")):
        hall.submit(act)
        assert hall.told.pop() in (words, "the run has not started", "the pose is confirmed")
        assert shown.refusals[act.name]
    assert shown.refusals["start"] == words
    assert "abort" not in shown.refusals
    hall.disk.come_back()
    hall.pass_time(STEP)
    assert hall.told == [None]
    assert hall.engine.run.phase is Phase.COUNTDOWN
    assert not hall.engine.writing


def test_an_abort_withdraws_a_start_that_is_being_written(hall: Hall) -> None:
    hall.drive.prepare(make_setup())
    hall.disk.held = True
    hall.submit(Start())
    hall.submit(Abort("person in the way"))
    assert hall.told == [
        "aborted before the countdown began: person in the way: it is withdrawn", None,
    ]  # fmt: skip
    hall.disk.come_back()
    hall.pass_time(5.0)
    assert hall.engine.run.phase is Phase.READY


def test_an_abort_that_comes_with_the_disks_answer_aborts_the_countdown(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.prepare(make_setup())
    states = hall.states(monkeypatch)
    hall.submit(Start())  # on disk, and nobody has told the engine yet
    hall.submit(Abort("stop"))
    hall.pass_time(STEP)
    assert hall.told == [None, None]
    assert hall.engine.run.outcome is Outcome.ABORTED
    assert states == ["countdown", "stopped"]


def test_a_countdown_begins_when_its_start_is_on_disk_and_never_in_the_past(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.prepare(make_setup(countdown=2.0))
    pressed = hall.engine.now()
    in_the_middle(hall, monkeypatch, lambda: hall.pass_time(1.5))
    hall.submit(Start())
    hall.pass_time(STEP)
    run = hall.engine.run
    assert hall.told == [None]
    assert run.countdown_began == pytest.approx(pressed + 1.5, abs=3 * STEP)
    assert run.start == run.countdown_began + 2.0  # type: ignore[operator]
    hall.drive.finish()
    folder, scored = hall.engine.folder, hall.engine.scored
    assert folder is not None
    assert scored is not None
    hall.engine.close()
    again = rebuild(hall.journal(folder), hall.engine.run.handle_zero)
    assert (again.countdown_began, again.start) == (run.countdown_began, run.start)
    assert score_opened(folder).result == scored.result


def test_a_start_is_judged_again_when_it_would_take_effect(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.prepare(make_setup())

    def nothing(timeout: float) -> list[RawMessage]:
        hall.drive.clock.sleep(timeout)
        return []

    def falls_silent() -> None:
        monkeypatch.setattr(hall.drive.source, "take_messages", nothing)
        hall.pass_time(1.5)

    in_the_middle(hall, monkeypatch, falls_silent)
    hall.submit(Start())
    hall.pass_time(STEP)
    assert hall.told[0] is not None
    assert "messages/s missing: it is withdrawn" in hall.told[0]
    assert hall.engine.run.phase is Phase.READY
    (folder,) = hall.results.glob("practice/subject_*")
    assert hall.journal(folder)[-1].what == "withdrawn"


def test_a_run_whose_countdown_never_began_is_not_asked_about(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine stops when the start is on disk, and nothing was made of it."""
    hall.drive.prepare(make_setup())
    monkeypatch.setattr(hall.disk, "deliver", lambda: None)
    hall.submit(Start())
    (folder,) = hall.results.glob("practice/subject_*")
    assert hall.journal(folder)[-1].what == "start"
    later = hall.results.with_name("later")
    shutil.copytree(hall.results, later)  # as it is left
    assert find_unfinished(later) == ()
    drive = Drive(later)
    assert drive.engine.next_run_number(3, 1, practice=True).result() == 2
    drive.whole_run(make_setup(run_number=2))
    drive.engine.close()


def test_a_signature_that_is_being_written_can_be_taken_back(hall: Hall) -> None:
    hall.drive.whole_run(make_setup())
    hall.disk.held = True
    hall.submit(SIGNED)
    hall.submit(Abort())
    assert hall.told == ["taken back by the referee: it is withdrawn", None]
    hall.disk.come_back()
    hall.pass_time(5.0)
    assert hall.engine.run.phase is Phase.STOPPED


@pytest.mark.parametrize("half_written", [False, True])
def test_a_signature_that_is_not_on_disk_in_time_is_none(
    hall: Hall, half_written: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.whole_run(make_setup())
    if half_written:
        in_the_middle(hall, monkeypatch, lambda: hall.pass_time(DURABLE_WITHIN + 2 * STEP))
        hall.submit(SIGNED)
    else:
        hall.disk.held = True
        hall.submit(SIGNED)
        hall.pass_time(DURABLE_WITHIN + 2 * STEP)
    assert hall.told == [TOO_LONG]
    hall.disk.come_back()
    hall.pass_time(5.0)
    assert hall.engine.run.phase is Phase.STOPPED
    lines = hall.journal()
    assert "finalise" not in [entry.what for entry in lines]
    assert lines[-1].what == "withdrawn"
    assert rebuild(lines).phase is Phase.STOPPED
    hall.drive.act(SIGNED, Reissue("appeal granted"), SIGNED)
    run = hall.engine.run
    assert (run.phase, run.issue) == (Phase.FINAL, 2)
    hall.engine.close()
    assert rebuild(hall.journal(), run.handle_zero).closure == run.closure


@pytest.mark.parametrize(
    "act",
    [
        Void("unsafe"),
        Correct(4, replace(PULL, starting_side=Side.CW), "typed wrongly"),
        TakeBack(DecisionKind.INCIDENT, 0.0, "my mistake"),
    ],
    ids=lambda act: act.name,
)
def test_what_is_put_right_takes_effect_on_disk_or_never(hall: Hall, act: Act) -> None:
    hall.drive.whole_run(make_setup())
    hall.drive.act(MarkIncident(IncidentKind.FALL))
    hall.pass_time(1.0)
    stood = hall.engine.run
    if isinstance(act, TakeBack):
        act = replace(act, made=stood.incidents[0].time)
    hall.disk.held = True
    hall.submit(act)
    hall.pass_time(1.0)
    assert hall.engine.run == stood
    hall.pass_time(DURABLE_WITHIN)
    assert hall.told == [TOO_LONG]
    hall.disk.come_back()
    hall.pass_time(5.0)
    assert hall.engine.run == stood
    assert rebuild(hall.journal(), stood.handle_zero, stood.zero_samples) == stood
    hall.disk.held = True
    hall.submit(act)
    hall.pass_time(1.0)
    hall.disk.come_back()
    hall.pass_time(5.0)
    assert hall.told == [TOO_LONG, None]
    assert hall.engine.run != stood
    assert rebuild(hall.journal(), stood.handle_zero, stood.zero_samples) == hall.engine.run
    assert check_run(RunPath(hall.drive.folder)).found == ()


def test_what_the_disk_refuses_is_no_part_of_the_journal(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.drive.whole_run(make_setup())

    def broken(_file: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as sick:
        sick.setattr(os, "fsync", broken)
        hall.submit(SIGNED)
        hall.pass_time(STEP)
    assert hall.told == [
        "the journal cannot be written (Input/output error): see to the disk, then try again"
    ]
    assert hall.engine.run.phase is Phase.STOPPED
    assert rebuild(hall.journal()).phase is Phase.STOPPED


def test_an_abort_wins_over_a_restart_that_is_being_written(hall: Hall) -> None:
    hall.drive.prepare(make_setup(countdown=5.0))
    hall.drive.act(Start())
    hall.pass_time(1.0)
    hall.disk.held = True
    hall.submit(RestartCountdown("robot not ready"))
    hall.submit(Abort("enough"))
    words = ["the run has stopped: it is withdrawn", None]
    assert hall.told == words
    assert hall.engine.run.phase is Phase.STOPPED
    hall.disk.come_back()
    hall.pass_time(STEP)
    assert hall.told == words
    lines = hall.journal()
    assert "restart the countdown" not in [entry.what for entry in lines]
    assert rebuild(lines).outcome is Outcome.ABORTED


def test_a_countdown_restarts_when_that_is_on_disk(hall: Hall) -> None:
    hall.drive.prepare(make_setup(countdown=5.0))
    hall.drive.act(Start())
    hall.pass_time(1.0)
    first = hall.engine.run.start
    hall.disk.held = True
    hall.submit(RestartCountdown("robot not ready"))
    hall.pass_time(1.0)
    assert hall.engine.run.start == first
    hall.disk.come_back()
    hall.pass_time(STEP)
    assert hall.engine.run.start == pytest.approx(hall.engine.now() + 5.0, abs=2 * STEP)
    hall.drive.finish()
    assert rebuild(hall.journal()).start == hall.engine.run.start


def test_a_silent_disk_is_asked_for_nothing_new(hall: Hall) -> None:
    hall.drive.whole_run(make_setup())
    hall.drive.act(SIGNED)
    hall.disk.held = True
    hall.submit(AddNote("a line that hangs"))
    hall.pass_time(7.0)
    hall.submit(Reissue("appeal granted"))
    words = "the disk has not answered for 7 s: nothing new until it does"
    assert hall.told == [None, words]
    assert hall.engine.snapshot().refusals["re-issue"] == words


def test_a_result_that_is_slow_to_write_stops_no_clock(hall: Hall) -> None:
    hall.drive.whole_run(make_setup())
    hall.disk.held = True
    hall.submit(Rule(Step.TOUCH, confirmed=False, reason="seen"))
    hall.submit(AddNote("twice"))
    hall.pass_time(10.0)
    assert hall.told == [None, None]
    assert hall.engine.busy
    assert hall.engine.snapshot().refusals["finalise"] == "the result is being written"
    hall.disk.come_back()
    hall.pass_time(0.1)
    assert not hall.engine.busy
    hall.drive.act(SIGNED)
    folder = hall.drive.folder
    stored = json.loads((folder / "result.json").read_text())
    assert stored["notes"][0]["text"] == "twice"
    assert stored["rulings"][0]["reason"] == "seen"
    hall.engine.close()


def test_an_act_that_comes_twice_is_done_once_and_answered_twice(hall: Hall) -> None:
    hall.drive.prepare(make_setup())
    hall.disk.held = True
    hall.submit(Start(), "a")
    hall.submit(Start(), "a")
    assert hall.told == []
    hall.disk.come_back()
    hall.pass_time(STEP)
    assert hall.told == [None, None]
    for _ in range(2):
        hall.submit(AddNote("once"), "b")
    assert hall.told == [None] * 4
    assert [note.text for note in hall.engine.run.notes] == ["once"]
    hall.submit(ConfirmPose(), "c")
    hall.submit(ConfirmPose(), "c")
    assert hall.told[-1] == hall.told[-2] is not None


def test_a_bag_that_is_slow_to_close_stops_no_clock(hall: Hall) -> None:
    hall.drive.start(make_setup(timeout=3.0))
    hall.pass_time(1.0)
    hall.submit(Abort("enough"))
    hall.disk.held = True
    hall.pass_time(30.0)
    shown = hall.engine.snapshot()
    assert hall.engine.busy
    assert shown.result is None
    assert shown.refusals["set up"] == "the result of the last run is being written"
    hall.disk.come_back()
    hall.pass_time(0.1)
    assert hall.engine.snapshot().result is not None
    assert not hall.engine.busy
