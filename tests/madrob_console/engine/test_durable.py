"""Acts x phases x disks, and any acts on what fails: all that is answered is on the disk."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest
from hypothesis import Phase as Part
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import score_opened
from madrob_console.archive.unfinished_runs import find_unfinished
from madrob_console.engine.core.run_tracker import IN_FLIGHT
from madrob_console.referee.acts import (
    ACT_CALLED,
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    Correct,
    DecideProtest,
    DeclareTimeout,
    FileProtest,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    TakeBack,
    Void,
    WithdrawProtest,
    ZeroHandle,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.journal import read_journal
from madrob_console.referee.protests import ProtestEnd
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Condition, Outcome, Side, Step
from tests.madrob_console.engine.drive import PULL, STEP, make_setup
from tests.madrob_console.engine.held_disk import HeldDrive, HeldScorer
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, STRIP

SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")
FILED = FileProtest("it was slower", "Delft")
TOO_LONG = "the disk did not take it within 2 s: it is withdrawn"


class Hall(HeldDrive):
    """It can be brought to any phase."""

    def bring_to(self, phase: Phase) -> None:
        """A run that goes on so far; a fall is noted in it."""
        self.prepare(make_setup(countdown=60.0 if phase is Phase.COUNTDOWN else 1.0))
        if phase is Phase.READY:
            return
        self.act(Start())
        self.pass_time(1.5)
        if phase in (Phase.COUNTDOWN, Phase.RUNNING):
            return
        self.act(MarkIncident(IncidentKind.FALL), DeclareTimeout("gave up"))
        self.finish()
        if phase is Phase.FINAL:
            self.act(SIGNED)


@pytest.fixture
def hall(tmp_path: Path) -> Hall:
    return Hall(tmp_path)


def in_the_middle(
    monkeypatch: pytest.MonkeyPatch, happens: Callable[[], None], seen: list[int]
) -> None:
    """Let something happen while the disk syncs the next line of a journal."""
    fsync = os.fsync

    def hangs(file: int) -> None:
        if Path(f"/proc/self/fd/{file}").readlink().name == JOURNAL_FILE and not seen:
            seen.append(file)
            happens()
        fsync(file)

    monkeypatch.setattr(os, "fsync", hangs)


def silent(hall: Hall, act: Act, _: pytest.MonkeyPatch) -> str:
    hall.disk.held = True
    hall.submit(act)
    hall.too_long()
    hall.disk.come_back()
    return TOO_LONG


def hangs_half_way(hall: Hall, act: Act, monkeypatch: pytest.MonkeyPatch) -> str:
    seen: list[int] = []
    in_the_middle(monkeypatch, hall.too_long, seen)
    hall.submit(act)
    hall.pass_time(STEP)
    assert seen
    return TOO_LONG


def refuses(hall: Hall, act: Act, monkeypatch: pytest.MonkeyPatch) -> str:
    def broken(_file: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", broken)
    hall.submit(act)
    hall.pass_time(STEP)
    return "Input/output error"


def slow_and_the_referee_takes_it_back(hall: Hall, act: Act, _: pytest.MonkeyPatch) -> str:
    hall.disk.held = True
    hall.submit(act)
    hall.submit(Abort())
    assert hall.told.pop() is None
    hall.disk.come_back()
    return ": it is withdrawn"


IN_VAIN = (silent, hangs_half_way, refuses, slow_and_the_referee_takes_it_back)
WAITS_FOR_THE_DISK: list[tuple[Phase, Act]] = [
    (Phase.READY, Start()),
    (Phase.COUNTDOWN, RestartCountdown("robot not ready")),
    (Phase.STOPPED, SIGNED),
    (Phase.STOPPED, Void("unsafe")),
    (Phase.STOPPED, Correct(4, replace(PULL, starting_side=Side.CW), "typed wrongly")),
    (Phase.STOPPED, TakeBack(DecisionKind.INCIDENT, 0.0, "my mistake")),
    (Phase.STOPPED, DecideProtest(1, ProtestEnd.UPHELD, "seen", "R. Eferee")),
    (Phase.STOPPED, WithdrawProtest(1, "satisfied")),
    (Phase.FINAL, FILED),
    (Phase.FINAL, Void("unsafe")),
    (Phase.FINAL, Reissue("appeal granted")),
]


@pytest.mark.parametrize(
    ("phase", "act"), WAITS_FOR_THE_DISK, ids=[f"{p}-{a.name}" for p, a in WAITS_FOR_THE_DISK]
)
def test_what_waits_for_the_disk_is_done_once_it_is_there_or_refused_and_never_comes(
    hall: Hall, phase: Phase, act: Act, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.bring_to(phase)
    if isinstance(act, TakeBack):
        act = replace(act, made=hall.engine.run.incidents[0].time)
    if isinstance(act, DecideProtest | WithdrawProtest):
        hall.act(FILED)
    hall.pass_time(1.0)
    for disk in IN_VAIN[: 3 if hall.engine.run.active else 4]:
        stood, published = hall.engine.run, hall.phases
        with monkeypatch.context() as patch:
            words = disk(hall, act, patch)
        hall.pass_time(2.5)
        assert [words in str(told) for told in hall.told] == [True], (disk, hall.told)
        hall.told.clear()
        assert (hall.engine.run, hall.phases) == (stood, published), disk
        never_happened(hall, act)
    hall.disk.held = True
    stood = hall.engine.run
    hall.submit(act)
    hall.pass_time(1.0)
    assert (hall.told, hall.engine.run) == ([], stood)
    assert (hall.engine.writing, hall.engine.busy) == (act.name, True)
    shown = hall.engine.snapshot().refusals
    words = f"the disk has not taken the {act.name} yet: wait for it"
    assert shown[act.name] == words
    assert Abort.name not in shown
    hall.submit(AddNote("meanwhile"))
    assert hall.told.pop() == (None if stood.active else words)
    back = hall.engine.now()
    hall.disk.come_back()
    hall.pass_time(0.1)
    assert hall.told == [None]
    run = hall.engine.run
    assert (run != stood, hall.engine.writing) == (True, "")
    assert [line.what for line in hall.lines()].count(act.name) == 1
    assert hall.told_by_journal() == replace(run, journal=None)
    if run.active:
        assert run.countdown_began == pytest.approx(back, abs=3 * STEP)
    else:
        assert check_run(RunPath(hall.folder)).differences == ()
    hall.engine.close()


def never_happened(hall: Hall, act: Act) -> None:
    """The journal says so; what a start has made of its run stays, and its number is used."""
    if not isinstance(act, Start):
        assert act.name not in [line.what for line in hall.lines()]
        assert hall.told_by_journal() == hall.engine.run
        return
    assert hall.engine.folder is None
    results = hall.engine.config.results
    for journal in results.glob(f"practice/*/{JOURNAL_FILE}"):
        *lines, last = read_journal(journal)[0]
        assert (last.what, last.details["act"]) == (Change.WITHDRAWN, act.name)
        assert rebuild([*lines, last]).phase is Phase.READY
    assert find_unfinished(results) == ()
    number = hall.engine.next_run_number(3, 1, practice=True).result()
    assert number > len(list(results.glob("practice/subject_*")))
    setup = hall.engine.run.setup
    assert setup is not None
    if number > setup.run_number:
        hall.submit(act)
        hall.pass_time(STEP)
        assert f"use run {number}" in str(hall.told.pop())
    hall.act(SetUp(make_setup(run_number=number)), ConfirmPose())


FELL = MarkIncident(IncidentKind.FALL)
NOTED = AddNote("the disk hangs")
RULED = Rule(Step.TOUCH, confirmed=False, reason="seen")
AT_ONCE: list[tuple[Phase, Sequence[Act], Sequence[str]]] = [
    (Phase.COUNTDOWN, (FELL, NOTED, Abort("enough")), ("stopped",)),
    (Phase.RUNNING, (RULED, FELL, NOTED, Abort("enough")), ("stopped",)),
    (Phase.RUNNING, (NOTED, DeclareTimeout("gave up")), ("stopped",)),
    (Phase.STOPPED, (RULED, NOTED, FELL), ()),
]


@pytest.mark.parametrize(
    ("phase", "acts", "published"), AT_ONCE, ids=[f"{p}-{a[-1].name}" for p, a, _ in AT_ONCE]
)
def test_what_is_done_at_once_waits_for_no_disk_and_is_written_when_it_is_back(
    hall: Hall, phase: Phase, acts: Sequence[Act], published: Sequence[str]
) -> None:
    hall.bring_to(phase)
    hall.pass_time(1.0)
    before, heard = hall.lines(), len(hall.phases)
    hall.disk.held = True
    for act in acts:
        hall.submit(act)
    assert hall.told == [None] * len(acts)
    hall.pass_time(IN_FLIGHT + 0.1)
    assert hall.phases[heard:] == tuple(published)
    assert hall.engine.run.phase is Phase.STOPPED
    hall.pass_time(10.0)
    assert hall.lines() == before
    names = [act.name for act in acts]
    names += ["run stops"] * isinstance(acts[-1], DeclareTimeout)
    waiting, silence = hall.engine.unwritten
    assert waiting == len(names)
    assert silence == pytest.approx(10.1 + IN_FLIGHT, abs=0.1)
    shown = hall.engine.snapshot()
    assert hall.engine.busy
    assert shown.refusals["finalise"] == "the result is being written"
    hall.disk.come_back()
    hall.pass_time(0.1)
    assert (hall.engine.busy, hall.engine.unwritten) == (False, (0, 0.0))
    written = [line.what for line in hall.lines()[len(before) :]]
    assert written.pop() == "result written"
    assert [what for what in written if what != "result written"] == names
    assert hall.told_by_journal() == replace(hall.engine.run, journal=None)
    stored = json.loads((hall.folder / "result.json").read_text())
    assert [note["text"] for note in stored["notes"]] == ["the disk hangs"]
    assert check_run(RunPath(hall.folder)).differences == ()
    hall.engine.close()


def test_a_silent_disk_stops_no_clock_and_is_asked_for_nothing_new(hall: Hall) -> None:
    hall.start(make_setup(timeout=8.0))
    hall.disk.held = True
    hall.submit(AddNote("a line that hangs"))
    hall.pass_time(8.0 + IN_FLIGHT + 0.1)
    run = hall.engine.run
    assert (run.phase, run.outcome) == (Phase.STOPPED, Outcome.TIMEOUT)
    assert run.stop == hall.start_time + 8.0
    hall.submit(Void("unsafe"))
    words = "the disk has not answered for 8 s: nothing new until it does"
    assert hall.told == [None, words]
    hall.pass_time(30.0)
    shown = hall.engine.snapshot()
    assert (hall.engine.busy, shown.result, shown.refusals["void"][:12]) == (True, None, words[:12])
    assert shown.refusals["set up"] == "the result of the last run is being written"
    hall.disk.come_back()
    hall.pass_time(0.1)
    assert (hall.engine.busy, hall.engine.snapshot().result is None) == (False, False)


def test_a_run_that_is_left_with_a_line_on_its_way_is_soon_on_disk(hall: Hall) -> None:
    hall.bring_to(Phase.STOPPED)
    folder = hall.folder
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
    assert read_journal(folder / JOURNAL_FILE)[0][-1].what == "result written"
    assert not any("waits for the disk" in fault for fault in hall.engine.snapshot().faults)


def test_an_abort_that_comes_with_the_disks_answer_aborts_the_countdown(hall: Hall) -> None:
    hall.bring_to(Phase.READY)
    heard = len(hall.phases)
    hall.submit(Start())  # on disk, and nobody has told the engine yet
    hall.submit(Abort("stop"))
    hall.pass_time(STEP)
    assert hall.told == [None, None]
    assert hall.engine.run.outcome is Outcome.ABORTED
    assert hall.phases[heard:] == ("countdown", "stopped")


def test_a_start_is_judged_again_when_it_would_take_effect(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.bring_to(Phase.READY)
    in_the_middle(monkeypatch, lambda: setattr(hall.source, "other_referee", "node b"), [])
    hall.submit(Start())
    hall.pass_time(STEP)
    assert (hall.told, hall.engine.run.phase) == (["node b"], Phase.READY)
    (journal,) = hall.engine.config.results.glob(f"practice/*/{JOURNAL_FILE}")
    assert read_journal(journal)[0][-1].what == Change.WITHDRAWN


def test_an_act_that_comes_twice_is_done_once_and_answered_twice(hall: Hall) -> None:
    def submit_twice(act: Act) -> None:
        for _ in range(2):
            hall.submit(act, act.name)

    hall.bring_to(Phase.READY)
    hall.disk.held = True
    submit_twice(Start())
    assert hall.told == []
    hall.disk.come_back()
    hall.pass_time(STEP)
    submit_twice(AddNote("once"))
    assert hall.told == [None] * 4
    assert [note.text for note in hall.engine.run.notes] == ["once"]
    submit_twice(ConfirmPose())
    assert hall.told[-1] == hall.told[-2] is not None


LAST = TakeBack(DecisionKind.VOID, 0.0, "a slip")
"""Takes back the last decision, if there is one."""
ACTS = (
    *(Start(), RestartCountdown("not ready"), Abort("enough"), DeclareTimeout("gave up")),
    *(AddNote("a visitor"), MarkIncident(IncidentKind.FALL), ConfirmPose(), ZeroHandle()),
    *(Rule(Step.TOUCH, confirmed=yes, reason="seen") for yes in (True, False, None)),
    *(Void("unsafe"), Correct(4, Condition.from_number(11), "typed wrongly"), LAST),
    *(FileProtest("it was slower", "Delft"), Reissue("an appeal")),
    DecideProtest(1, ProtestEnd.UPHELD, "seen", "A"),
    *(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"),) * 2,
)


class Deed(NamedTuple):
    """An act, by its number among the possible ones, what fails meanwhile, and how long, s."""

    number: int
    fails: str
    lasts: float


DEEDS = st.lists(
    st.builds(
        Deed,
        st.integers(0, 100),
        st.sampled_from(("nothing", "the disk is silent", "the disk refuses", "the scorer")),
        st.sampled_from((0.02, 0.7, 2.5)),
    ),
    min_size=6,
    max_size=14,
)


def act_of(hall: HeldDrive, number: int) -> Act:
    refused, last = hall.engine.snapshot().refusals, last_decision(hall.engine.run)
    possible = [act for act in ACTS if act.name not in refused or number % 9 == 0]
    act = (possible or ACTS)[number % len(possible or ACTS)]
    return TakeBack(last.kind, last.time, "a slip") if act is LAST and last is not None else act


class Asked(NamedTuple):
    """An act, its answer once it is there, and whether a run was going on."""

    act: Act
    answers: list[str | None]
    active: bool

    @property
    def is_written(self) -> bool:
        """An abort after the stop withdraws what waits: that is a line of its own."""
        return self.answers == [None] and (self.active or not isinstance(self.act, Abort))


def do(hall: HeldDrive, scorer: HeldScorer, deed: Deed) -> Asked:
    fsync = os.fsync
    asked = Asked(act_of(hall, deed.number), [], hall.engine.run.active)

    def refuse(file: int) -> None:
        if Path(f"/proc/self/fd/{file}").readlink().name == JOURNAL_FILE:
            raise OSError(5, "Input/output error")
        fsync(file)

    with pytest.MonkeyPatch.context() as patched:
        if deed.fails == "the disk refuses":
            patched.setattr(os, "fsync", refuse)
        hall.disk.held = deed.fails == "the disk is silent"
        scorer.held = deed.fails == "the scorer"
        hall.engine.submit(asked.act, asked.answers.append)
        hall.pass_time(deed.lasts)
    hall.disk.come_back()
    return asked


@given(DEEDS)
@settings(max_examples=6, deadline=None, phases=[Part.generate])  # a shrink takes minutes
def test_whatever_fails_journal_bag_result_and_screen_say_what_was_answered(
    deeds: Sequence[Deed],
) -> None:
    """Each act that was answered yes is in the journal once, none that was refused ever is."""
    with TemporaryDirectory() as root:
        scorer = HeldScorer()
        hall = HeldDrive(Path(root), scorer)
        hall.count_down(make_setup(countdown=1.0, timeout=2.0))
        begun = len(hall.lines())
        acts = [do(hall, scorer, deed) for deed in deeds]
        scorer.held = False
        hall.pass_time(2.5)
        over, phase = hall.engine.now(), hall.engine.run.phase
        if hall.engine.run.active:
            hall.act(Abort("the end"))
        hall.finish()
        hall.pass_time(2.5)
        assert [len(asked.answers) for asked in acts] == [1] * len(deeds)
        done = [asked.act for asked in acts if asked.is_written]
        done += [Abort("the end")] * (phase in (Phase.COUNTDOWN, Phase.RUNNING))
        lines, run = hall.lines(), hall.engine.run
        written = [line.what for line in lines[begun:] if line.what in ACT_CALLED]
        assert sorted(written) == sorted(act.name for act in done)
        assert hall.told_by_journal() == replace(run, journal=None)
        for topic in (DOOR, HANDLE, STRIP):
            handed, recorded = hall.handed(topic), hall.recorded(topic)
            first = handed.index(recorded[0])
            assert recorded == handed[first : first + len(recorded)]
            assert len(recorded) >= 49 * ((run.stop or over) - (run.countdown_began or over))
        assert check_run(RunPath(hall.folder)).differences == ()
        assert hall.engine.snapshot().result == score_opened(hall.folder).result
        assert hall.engine.snapshot().all_faults == ()
        hall.engine.close()


def test_an_act_that_the_disk_takes_as_the_run_ends_counts_in_no_result(tmp_path: Path) -> None:
    hall, answers = HeldDrive(tmp_path, HeldScorer()), list[str | None]()
    hall.count_down(make_setup(countdown=1.0))
    hall.disk.held = True
    hall.engine.submit(RestartCountdown("not ready"), answers.append)
    hall.pass_time(0.7)
    hall.disk.come_back()
    hall.engine.submit(Abort("enough"), answers.append)
    hall.finish()
    hall.pass_time(2.5)
    assert answers == [None, "the run has stopped"]
    assert check_run(RunPath(hall.folder)).differences == ()
    hall.engine.close()
