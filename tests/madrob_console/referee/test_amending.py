"""After the stop: void, correct and take back. The journal tells all of it, and in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.referee.acts import (
    Abort,
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
from madrob_console.referee.acts.act import Ask
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.flags import Flag, undecided
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.rebuild import Change, after, mark_of, rebuild
from madrob_console.referee.records import (
    CheckName,
    DecisionKind,
    IncidentKind,
    ProtestEnd,
    TeamWord,
)
from madrob_console.referee.run import Phase, Run, stop
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import BenchmarkType, Condition, Outcome, Side, StartPose, Step
from scoring.result import Indicator
from tests.madrob_console.referee.test_acts import (
    DOUBTED,
    FAILED,
    ONE_SAMPLE,
    RUNS,
    SETUP,
    STOPPED,
    situation,
)

FINAL = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee").apply(
    situation(replace(STOPPED, issue=1)), 9.0
)
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
    if phase is Phase.STOPPED:
        telling.happens(Change.RUN_STOPS, outcome=Outcome.COMPLETED, time=telling.at)
        telling.happens(Change.RESULT_WRITTEN, issue=1)
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
closings = st.sampled_from([Finalise(TeamWord.ABSENT, "R. Eferee"), Reissue("protest")])
phases = st.sampled_from([Phase.READY, Phase.RUNNING, Phase.STOPPED])


@given(phases, st.lists(st.one_of(acts, closings, st.none()), max_size=15))
@settings(max_examples=300, deadline=None)
def test_whatever_is_decided_and_taken_back_the_journal_tells_it(
    phase: Phase, acts: Sequence[Act | None]
) -> None:
    telling = in_phase(phase)
    for act in acts:
        if act is None:
            telling.take_back()
        else:
            telling.do(act)
        assert telling.told == telling.run


def _decided(run: Run) -> Run:
    """Without what even a decision that is taken back leaves behind."""
    return replace(run, taken_back=(), changed=None, signed=None)


@given(phases, st.lists(acts, max_size=6), st.lists(decisions, min_size=1, max_size=6))
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


@given(st.lists(st.one_of(acts, closings, st.none()), max_size=12))
@settings(max_examples=200, deadline=None)
def test_of_a_final_result_only_what_opens_it_is_decided(acts: Sequence[Act | None]) -> None:
    telling = in_phase(Phase.STOPPED)
    telling.do(Finalise(TeamWord.ABSENT, "R. Eferee"))
    for act in acts:
        before = telling.run
        refused = telling.take_back() if act is None else telling.do(act)
        if before.phase is Phase.FINAL and refused is None:
            assert (telling.run.phase, telling.run.closure) == (Phase.STOPPED, None)
            assert telling.run.issue == before.issue + 1
            assert mark_of(telling.entries) != mark_of(telling.entries[:-1])


def test_a_voided_run_is_not_valid_and_keeps_its_outcome() -> None:
    assert STOPPED.valid
    void = Void("unsafe").apply(situation(STOPPED), 130.0)
    assert not void.valid
    assert (void.outcome, void.phase) == (Outcome.COMPLETED, Phase.STOPPED)
    words = "the run is void already: that can be taken back"
    assert Void("again").refusal(situation(void)) == words


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (Outcome.ABORTED, "an aborted run is invalid already"),
        (Outcome.INTERRUPTED, "an interrupted run counts nowhere already"),
    ],
)
def test_only_a_valid_run_is_voided(outcome: Outcome, words: str) -> None:
    assert Void("?").refusal(situation(replace(STOPPED, outcome=outcome))) == words


def test_a_run_is_voided_before_its_result_is_written_too() -> None:
    assert Void("robot unsafe").refusal(Situation(STOPPED, scored=False)) is None
    final = Situation(FINAL, scored=False)
    assert Void("robot unsafe").refusal(final) == "the result is being written"


def test_the_start_pose_changes_over_with_a_corrected_starting_side() -> None:
    setup = replace(SETUP, start_pose=StartPose(1.5, 0.3, 170.0))
    run = TO_CW.apply(situation(replace(STOPPED, setup=setup)), 130.0)
    assert run.setup is not None
    assert run.setup.start_pose == StartPose(-1.5, 0.3, 10.0)
    assert run.setup.problem() is None
    assert run.set_up_as == setup
    opening = Correct(3, replace(SETUP.condition, opening_side=Side.CW), "?")
    kept = opening.apply(situation(replace(STOPPED, setup=setup)), 130.0).setup
    assert kept is not None
    assert kept.start_pose == setup.start_pose


def test_a_run_has_one_number_in_each_series_that_it_was_in() -> None:
    run = TO_CW.apply(situation(STOPPED), 130.0)
    assert run.setup is not None
    assert run.setup.run_number == 7
    assert run.number_in(3, CW) == 7
    assert run.number_in(3, SETUP.condition) == SETUP.run_number
    assert run.number_in(4, CW) is None


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (Correct(3, SETUP.condition, "?"), "that is what is set up"),
        (Correct(0, SETUP.condition, "?"), "subject 0: use a number from 1 to 999"),
        (Correct(4, SETUP.condition, " "), "a correction needs a reason"),
    ],
)
def test_a_bad_correction_is_refused_with_words(act: Act, words: str) -> None:
    assert act.refusal(situation(STOPPED)) == words


def test_a_final_result_is_opened_by_a_void_and_by_what_takes_it_back() -> None:
    void = Void("unsafe").apply(situation(FINAL), 130.0)
    assert (void.phase, void.issue, void.closure) == (Phase.STOPPED, 2, None)
    signed = Finalise(TeamWord.ABSENT, "R. Eferee").apply(situation(void), 131.0)
    back = TakeBack(DecisionKind.VOID, 130.0, "my mistake")
    assert back.refusal(situation(signed)) is None
    again = back.apply(situation(signed), 132.0)
    assert (again.phase, again.issue, again.valid) == (Phase.STOPPED, 3, True)
    assert [one.words for one in again.taken_back] == ["void (unsafe)"]


def test_a_ruling_of_a_final_result_is_not_taken_back_unseen() -> None:
    ruled = Rule(Step.CROSS, confirmed=False, reason="arm").apply(situation(STOPPED), 130.0)
    final = Finalise(TeamWord.ABSENT, "R. Eferee").apply(situation(ruled), 131.0)
    words = "the result is final: re-issue it first"
    assert TakeBack.impossible(situation(final)) == words
    assert TakeBack(DecisionKind.RULING, 130.0, "?").refusal(situation(final)) == words


def test_what_is_not_the_last_of_its_kind_any_more_is_not_taken_back() -> None:
    run = Rule(Step.CROSS, confirmed=False, reason="arm").apply(situation(STOPPED), 130.0)
    back = TakeBack(DecisionKind.RULING, 130.0, "my mistake")
    later = Rule(Step.CLOSE, confirmed=True, reason="seen").apply(situation(run), 131.0)
    assert back.refusal(situation(run)) is None
    assert back.refusal(situation(later)) == "this ruling is not the last one that stands"
    marked = MarkIncident(IncidentKind.FALL).apply(situation(STOPPED), 131.0)
    assert back.refusal(situation(marked)) == "this ruling is not the last one that stands"


def test_the_last_decision_is_the_one_that_was_made_last_whatever_its_time_says() -> None:
    run = Rule(Step.CROSS, confirmed=False, reason="arm").apply(situation(STOPPED), 130.0)
    run = MarkIncident(IncidentKind.FALL).apply(situation(run), 110.0)
    last = last_decision(run)
    assert last is not None
    assert (last.kind, last.words) == (DecisionKind.INCIDENT, "incident at 5.000 s: fall")


def test_each_phase_that_has_a_decision_can_take_it_back() -> None:
    for phase in (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED):
        run = MarkIncident(IncidentKind.FALL).apply(situation(RUNS[phase]), 111.0)
        assert TakeBack.impossible(situation(run)) is None
    waived = Waive(CheckName.DOOR, "warped").apply(situation(RUNS[Phase.READY], FAILED), 1.0)
    assert TakeBack.impossible(situation(waived)) is None
    assert TakeBack.impossible(situation(RUNS[Phase.READY])) == "there is nothing to take back"


def test_an_abort_that_came_too_late_asks_whether_the_run_is_void() -> None:
    refused = Abort("robot unsafe").refusal(situation(STOPPED))
    assert refused == "the run has stopped: void it instead"
    over = stop(RUNS[Phase.RUNNING], Outcome.ABORTED, 120.0, "fire")
    assert Abort("again").refusal(situation(over)) == "the run has stopped"
    ask = Void.instead_of_abort("robot unsafe")
    assert "over before the abort (robot unsafe)" in ask.title
    assert ask.make() == Void("robot unsafe")


@dataclass
class View:
    """What a screen shows of a run."""

    run: Run
    checks: tuple[Check, ...] = ()
    steps: tuple[StepRecord, ...] = ()
    flags: tuple[Flag, ...] = ()
    teams: TeamList = NO_TEAMS
    elapsed: float | None = None
    indicators: Mapping[IndicatorName, Indicator] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("key", "act"),
    [
        ("starting", Correct(3, CW, "slip")),
        (
            "opening",
            Correct(3, replace(SETUP.condition, opening_side=Side.CW), "slip"),
        ),
        (
            "Wind Ramp",
            Correct(
                3,
                replace(SETUP.condition, benchmark_type=BenchmarkType.WIND_RAMP),
                "slip",
            ),
        ),
    ],
)
def test_the_dialog_asks_what_was_wrong_and_then_for_the_reason(key: str, act: Act) -> None:
    ask = Correct.ask_questions(View(STOPPED), "c")
    assert isinstance(ask, Ask)
    then = ask.make(key)
    assert isinstance(then, Ask)
    assert then.make("slip") == act


def test_another_subject_is_asked_for_first_and_then_its_team_and_the_reason() -> None:
    ask = Correct.ask_questions(View(STOPPED), "c")
    assert isinstance(ask, Ask)
    then = ask.make("subject")
    assert isinstance(then, Ask)
    assert then.make("12a") == "subject '12a': use a number from 1 to 999"
    last = then.make("12")
    assert isinstance(last, Ask)
    assert last.title == "Correct the subject from 3 to 12"
    assert last.make("Graz", "slip") == Correct(12, SETUP.condition, "slip", "Graz")


def test_the_name_of_another_subject_is_the_one_in_the_list() -> None:
    view = View(STOPPED)
    view.teams = teams = TeamList({3: "Delft", 12: "Graz"})
    ask = Correct.ask_questions(view, "c")
    assert isinstance(ask, Ask)
    then = ask.make("subject")
    assert isinstance(then, Ask)
    unlisted, last = then.make("13"), then.make("12")
    assert isinstance(unlisted, Ask)
    assert "which is not in the list of teams" in unlisted.title
    assert isinstance(last, Ask)
    assert last.title == "Correct the subject from 3 to 12, Graz"
    act = last.make("slip")
    assert isinstance(act, Correct)
    here = replace(situation(STOPPED), teams=teams)
    after = act.named(here).apply(here, 130.0).setup
    assert after is not None
    assert (after.subject, after.team, after.team_reason) == (12, "Graz", "")


def test_the_dialog_says_what_it_takes_back() -> None:
    ask = TakeBack.ask_questions(View(Void("unsafe").apply(situation(STOPPED), 130.0)), "z")
    assert isinstance(ask, Ask)
    assert ask.title == "Take back the last decision: void (unsafe)"
    assert ask.make("slip") == TakeBack(DecisionKind.VOID, 130.0, "slip")
    assert TakeBack.ask_questions(View(STOPPED), "z") == "there is nothing to take back"
