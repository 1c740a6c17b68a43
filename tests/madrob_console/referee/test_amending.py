"""After the stop: void, correct and take back. The journal tells all of it, and in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.referee.acts import (
    AcceptDoubts,
    Act,
    Correct,
    DecideProtest,
    FileProtest,
    Finalise,
    MarkIncident,
    Reissue,
    Rule,
    SetUp,
    Situation,
    TakeBack,
    Void,
    Waive,
    WithdrawProtest,
    act_details,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.flags import undecided
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.protests import ProtestEnd
from madrob_console.referee.rebuild import Change, after, mark_of, rebuild
from madrob_console.referee.records import CheckName, DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.team_list import TeamList
from scoring.protocol import BenchmarkType, Condition, Outcome, Side, StartPose, Step
from tests.madrob_console.referee.test_acts import (
    DOUBTED,
    FAILED,
    ONE_SAMPLE,
    RUNS,
    SETUP,
    STOPPED,
    done,
    situation,
)

FINAL = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee").apply(
    situation(replace(STOPPED, issue=1)), 9.0
)
SIGN = Finalise(TeamWord.ABSENT, "R. Eferee")
CW = replace(SETUP.condition, starting_side=Side.CW)
TO_CW = Correct(3, CW, "typed wrongly", run_number=7)


class Telling:
    """A run, and the journal that tells of it."""

    def __init__(self) -> None:
        self.run = Run()
        self.entries: list[Entry] = []

    @property
    def at(self) -> float:
        return 100.0 + len(self.entries)

    def situation(self) -> Situation:
        check = Check(CheckName.DOOR, CheckState.FAILED, "angle +0.500 rad")
        return Situation(self.run, scored=True, look=lambda: (check,), indicators=DOUBTED)

    def do(self, act: Act) -> str | None:
        if isinstance(act, Finalise):  # what waits is known and signed
            left = undecided(self.situation().flags)
            act = replace(act, undecided=tuple(flag.words for flag in left))
        if (refused := act.refusal(self.situation())) is not None:
            return refused
        reason, details = act.reason_given, act_details(act)
        entry = Entry(self.at, Origin.REFEREE, act.name, "", reason, details)
        self.run = act.apply(self.situation(), self.at)
        self.entries.append(entry)
        return None

    def happens(self, change: Change, **details: object) -> None:
        entry = Entry(self.at, Origin.CLOCK, change.value, details=details)
        self.run = after(self.run, entry)
        self.entries.append(entry)

    def take_back(self) -> str | None:
        last = last_decision(self.run)
        return "nothing" if last is None else self.do(TakeBack(last.kind, last.time, "mistake"))

    @property
    def told(self) -> Run:
        """The run as its journal tells it."""
        return rebuild([Entry.from_json(entry.to_json()) for entry in self.entries])


def in_phase(phase: Phase) -> Telling:
    telling = Telling()
    telling.do(SetUp(SETUP))
    if phase is Phase.READY:
        return telling
    telling.happens(Change.COUNTDOWN_BEGINS, time=telling.at)
    telling.happens(Change.RUN_STARTS)
    if phase in {Phase.STOPPED, Phase.FINAL}:
        telling.happens(Change.RUN_STOPS, outcome=Outcome.COMPLETED, time=telling.at)
        telling.happens(Change.RESULT_WRITTEN, issue=1)
    if phase is Phase.FINAL:
        telling.do(SIGN)
    return telling


conditions = st.builds(Condition, st.sampled_from(BenchmarkType), *[st.sampled_from(Side)] * 2)
reason = st.sampled_from(["seen", "my mistake"])
decisions = st.one_of(
    st.builds(Rule, st.sampled_from(Step), st.sampled_from([True, False, None]), reason),
    st.builds(MarkIncident, st.sampled_from(IncidentKind)),
    st.builds(Waive, st.just(CheckName.DOOR), reason),
    st.builds(Void, reason),
    st.builds(AcceptDoubts, st.just(ONE_SAMPLE), reason),
    st.builds(
        DecideProtest,
        st.integers(1, 3),
        st.sampled_from(list(ProtestEnd)),
        reason,
        st.just("R. Eferee"),
    ),
    st.builds(Correct, st.integers(1, 5), conditions, reason, st.just("Graz"), st.integers(1, 99)),
)
protests = st.one_of(
    st.builds(FileProtest, st.just("it was slower"), st.just("Graz"), after_start=st.just(2.0)),
    st.builds(WithdrawProtest, st.integers(1, 3), reason),
)
acts = st.one_of(decisions, protests)
"""What a team does is not taken back: it may protest again."""
closings = st.sampled_from([SIGN, Reissue("protest")])
STARTED = (Phase.READY, Phase.RUNNING, Phase.STOPPED)


@given(
    st.sampled_from([*STARTED, Phase.FINAL]),
    st.lists(st.one_of(acts, closings, st.none()), max_size=15),
)
@settings(max_examples=300, deadline=None)
def test_whatever_is_decided_and_taken_back_the_journal_tells_it(
    phase: Phase, acts: Sequence[Act | None]
) -> None:
    """Of a final result only what opens it again is decided: its next issue waits."""
    telling = in_phase(phase)
    for act in acts:
        before = telling.run
        refused = telling.take_back() if act is None else telling.do(act)
        assert telling.told == telling.run
        if before.phase is Phase.FINAL and refused is None:
            opened = Phase.STOPPED, None, before.issue + 1
            assert (telling.run.phase, telling.run.closure, telling.run.issue) == opened
            assert mark_of(telling.entries) != mark_of(telling.entries[:-1])


def _decided(run: Run) -> Run:
    """Without what even a decision that is taken back leaves behind."""
    return replace(run, taken_back=(), changed=None, signed=None)


@given(
    st.sampled_from(STARTED),
    st.lists(acts, max_size=6),
    st.lists(decisions, min_size=1, max_size=6),
)
@settings(max_examples=300, deadline=None)
def test_taking_back_is_the_inverse_of_deciding(
    phase: Phase, before: Sequence[Act], then: Sequence[Act]
) -> None:
    telling = in_phase(phase)
    for act in before:
        telling.do(act)
    stood = telling.run
    made = sum(telling.do(act) is None for act in then)
    for _ in range(made):
        assert telling.take_back() is None
    assert _decided(telling.run) == _decided(stood)
    assert len(telling.run.taken_back) == made
    assert telling.told == telling.run


def test_a_voided_run_is_not_valid_and_keeps_its_outcome() -> None:
    voided = done(STOPPED, Void("unsafe"), 130.0)
    assert (STOPPED.valid, voided.valid) == (True, False)
    assert (voided.outcome, voided.phase) == (Outcome.COMPLETED, Phase.STOPPED)


def test_the_start_pose_changes_over_with_a_corrected_starting_side() -> None:
    setup = replace(SETUP, start_pose=StartPose(1.5, 0.3, 170.0))
    run = TO_CW.apply(situation(replace(STOPPED, setup=setup)), 130.0)
    mirrored = replace(setup, run_number=7, condition=CW, start_pose=StartPose(-1.5, 0.3, 10.0))
    assert run.setup == mirrored
    assert mirrored.problem() is None
    assert run.set_up_as == setup
    assert [one.words for one in run.corrections] == ["starting side from CCW to CW"]
    opening = replace(SETUP.condition, opening_side=Side.CW)
    kept = Correct(3, opening, "?").apply(situation(replace(STOPPED, setup=setup)), 130.0)
    assert kept.setup == replace(setup, run_number=0, condition=opening)
    assert [one.words for one in kept.corrections] == ["opening side from CCW to CW"]


def test_a_run_has_one_number_in_each_series_that_it_was_in() -> None:
    run = TO_CW.apply(situation(STOPPED), 130.0)
    series = [(3, CW), (3, SETUP.condition), (4, CW)]
    assert [run.number_in(*one) for one in series] == [7, SETUP.run_number, None]


def test_the_name_of_another_subject_is_the_one_in_the_list() -> None:
    here = replace(situation(STOPPED), teams=TeamList({3: "Delft", 12: "Graz"}))
    act = Correct(12, SETUP.condition, "slip", "?").named(here)
    corrected = replace(SETUP, subject=12, team="Graz", run_number=0)
    assert act.apply(here, 130.0).setup == corrected


RULE = Rule(Step.CROSS, confirmed=False, reason="arm")
LATER = Rule(Step.CLOSE, confirmed=True, reason="seen")
MARK = MarkIncident(IncidentKind.FALL)
WAIVE = Waive(CheckName.DOOR, "warped")
READY = RUNS[Phase.READY]


def after_acts(run: Run, *acts: tuple[Act, float]) -> Run:
    """The run after acts, each at its time."""
    for act, at in acts:
        run = act.apply(situation(run, FAILED), at)
    return run


OTHER = "this ruling is not the last one that stands"


@pytest.mark.parametrize(
    ("run", "acts", "back", "words"),
    [
        (STOPPED, [(RULE, 130.0)], TakeBack(DecisionKind.RULING, 130.0, "?"), None),
        (
            STOPPED,
            [(RULE, 130.0), (LATER, 131.0)],
            TakeBack(DecisionKind.RULING, 130.0, "?"),
            OTHER,
        ),
        (STOPPED, [(MARK, 131.0)], TakeBack(DecisionKind.RULING, 130.0, "?"), OTHER),
        (
            STOPPED,
            [(RULE, 130.0), (SIGN, 131.0)],
            TakeBack(DecisionKind.RULING, 130.0, "?"),
            "the result is final: re-issue it first",
        ),
        (
            STOPPED,
            [(RULE, 130.0), (Void("unsafe"), 131.0), (SIGN, 132.0)],
            TakeBack(DecisionKind.RULING, 130.0, "?"),
            "the result is final: re-issue it first",
        ),
        *(
            (RUNS[phase], [(MARK, 111.0)], TakeBack(DecisionKind.INCIDENT, 111.0, "?"), None)
            for phase in (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
        ),
        (READY, [(WAIVE, 1.0)], TakeBack(DecisionKind.WAIVER, 1.0, "?"), None),
    ],
)
def test_only_the_last_of_a_kind_that_is_within_reach_is_taken_back(
    run: Run, acts: list[tuple[Act, float]], back: TakeBack, words: str | None
) -> None:
    assert back.refusal(situation(after_acts(run, *acts))) == words


@pytest.mark.parametrize(
    ("run", "acts", "kind", "words"),
    [
        (STOPPED, [(RULE, 130.0)], DecisionKind.RULING, "step 4 denied (arm)"),
        (STOPPED, [(MARK, 111.0)], DecisionKind.INCIDENT, "incident at 6.000 s: fall"),
        (READY, [(WAIVE, 1.0)], DecisionKind.WAIVER, "check waived: door closed (warped)"),
        (STOPPED, [(Void("unsafe"), 130.0)], DecisionKind.VOID, "void (unsafe)"),
        (
            STOPPED,
            [(TO_CW, 130.0)],
            DecisionKind.CORRECTION,
            "corrected: starting side from CCW to CW (typed wrongly)",
        ),
        (  # the last is the one that was made last, whatever its time says
            STOPPED,
            [(RULE, 130.0), (MARK, 110.0)],
            DecisionKind.INCIDENT,
            "incident at 5.000 s: fall",
        ),
    ],
)
def test_the_last_decision_has_words(
    run: Run, acts: list[tuple[Act, float]], kind: DecisionKind, words: str
) -> None:
    last = last_decision(after_acts(run, *acts))
    assert last is not None
    assert (last.kind, last.words) == (kind, words)
