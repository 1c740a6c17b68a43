"""Any acts on a disk and a scorer that fail: journal, bag, result and screen say the same."""

from __future__ import annotations

import os
from collections.abc import Sequence
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
    Start,
    TakeBack,
    Void,
    ZeroHandle,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.protests import ProtestEnd
from madrob_console.referee.records import DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Condition, Step
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.held_disk import HeldDrive, HeldScorer
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, STRIP

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
        hall.prepare(make_setup(countdown=1.0, timeout=2.0))
        hall.act(Start())
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
    hall.prepare(make_setup(countdown=1.0))
    hall.act(Start())
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
