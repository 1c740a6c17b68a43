"""Every act in every phase: possible or refused with words."""

from __future__ import annotations

import importlib
import json
import math
import pkgutil
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, format_size, format_span, listed
from madrob_console.engine.core.event_log import EventLog
from madrob_console.engine.snapshot import Weight
from madrob_console.referee import acts
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    AcceptDoubts,
    AcceptFalseStart,
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
    Situation,
    Start,
    TakeBack,
    Void,
    Waive,
    WithdrawProtest,
    ZeroHandle,
    act_details,
    act_named,
    refusals,
)
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.flags import Doubts
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.protests import Protest, ProtestAnswer, ProtestEnd
from madrob_console.referee.records import (
    CheckName,
    DecisionKind,
    FalseStart,
    Incident,
    IncidentKind,
    Note,
    TeamWord,
    Voiding,
)
from madrob_console.referee.run import Phase, Run, begin_countdown, begin_run, stop
from madrob_console.referee.run_setup import RunSetup, new_run_id
from madrob_console.referee.team_list import TeamList
from madrob_console.referee.topic_health import Freshness, Health
from madrob_console.ui.look.words import done_text
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import (
    BenchmarkType,
    Condition,
    EventName,
    LockDetection,
    Outcome,
    Side,
    StartPose,
    Step,
)
from scoring.result import Indicator
from tests.scoring.runs import resting

SETUP = RunSetup(
    subject=3,
    team="Delft",
    run_number=2,
    condition=Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW),
    start_pose=StartPose(1.5, 0.0, 180.0),
    referee="R. Eferee",
    timeout=300.0,
    countdown=5.0,
    ruleset=RulesetName.PROTOCOL,
    lock_detection=LockDetection.AUTO,
)
READY = Run(Phase.READY, SETUP)
COUNTDOWN = begin_countdown(READY, 100.0)
RUNNING = begin_run(COUNTDOWN)
STOPPED = stop(RUNNING, Outcome.COMPLETED, 120.0, "all six steps done")
RUNS = {
    Phase.IDLE: Run(),
    Phase.READY: READY,
    Phase.COUNTDOWN: replace(COUNTDOWN, false_starts=(FalseStart(101.0, EventName.DOOR_OPENS),)),
    Phase.RUNNING: RUNNING,
    Phase.STOPPED: MarkIncident(IncidentKind.FALL).apply(Situation(STOPPED), 110.0),
    Phase.FINAL: replace(STOPPED, phase=Phase.FINAL),
}
DOUBTED = {
    name: replace(Indicator.of(name, 4.0), doubts=("the touch rests on 1 sample",))
    for name in (IndicatorName.TIME_TO_HANDLE, IndicatorName.PASSAGE_TIME)
}
"""Indicators of a result, some doubted for the same reason."""
ONE_SAMPLE: Doubts = {IndicatorName.TIME_TO_HANDLE: ("the touch rests on 1 sample",)}
FAILED = Check(CheckName.DOOR, CheckState.FAILED, "close the door: angle +0.500 rad")

ADA = SETUP.referee
PROTEST = Protest(1, 130.0, "Graz", "it was slower", "step 4", None, ADA)
PROTESTED = replace(STOPPED, protests=(PROTEST,))
WITHDRAWN = ProtestAnswer(130.0, ProtestEnd.WITHDRAWN, "ok", ADA)
FILED = Protest(1, 130.0, "Graz", "slow", "a time", 117.5, ADA)

POSSIBLE: list[tuple[Act, set[Phase]]] = [
    (SetUp(SETUP), {Phase.IDLE, Phase.READY, Phase.STOPPED, Phase.FINAL}),
    (ConfirmPose(), {Phase.READY}),
    (ZeroHandle(), {Phase.IDLE, Phase.READY, Phase.FINAL}),
    (Waive(CheckName.DOOR, "it is warped"), {Phase.READY}),
    (Start(), {Phase.READY}),
    (RestartCountdown(), {Phase.COUNTDOWN}),
    (AcceptFalseStart("wind"), {Phase.COUNTDOWN}),
    (Abort("fire"), {Phase.COUNTDOWN, Phase.RUNNING}),
    (DeclareTimeout("gave up"), {Phase.RUNNING}),
    (Rule(Step.TOUCH, confirmed=True, reason="seen"), {Phase.RUNNING, Phase.STOPPED}),
    (
        MarkIncident(IncidentKind.COLLISION),
        {Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED},
    ),
    (AddNote("slow"), set(Phase) - {Phase.IDLE}),
    (AcceptDoubts(ONE_SAMPLE, "seen on video"), {Phase.STOPPED}),
    (Finalise(TeamWord.PROTESTED, "R. Eferee"), {Phase.STOPPED}),
    (Reissue("appeal"), {Phase.FINAL}),
    (Void("unsafe"), {Phase.STOPPED, Phase.FINAL}),
    (Correct(4, SETUP.condition, "typed wrongly"), {Phase.STOPPED, Phase.FINAL}),
    (FileProtest("it was slower", "Graz"), {Phase.STOPPED, Phase.FINAL}),
    (
        DecideProtest(1, ProtestEnd.UPHELD, "seen on video", "R. Eferee"),
        {Phase.STOPPED, Phase.FINAL},  # it has one that is open
    ),
    (WithdrawProtest(1, "satisfied"), {Phase.STOPPED, Phase.FINAL}),
    (TakeBack(DecisionKind.INCIDENT, 110.0, "my mistake"), {Phase.STOPPED}),  # it has one
]


def situation(run: Run, *checks: Check) -> Situation:
    return Situation(run, scored=True, look=lambda: checks, measure=lambda: resting(5.9))


def done(run: Run, act: Act, time: float = 200.0) -> Run:
    """The run after an act that the engine carries out."""
    here = situation(run)
    assert act.refusal(here) is None
    return act.settled(here).apply(here, time)


def test_all_acts_are_here() -> None:
    files = pkgutil.iter_modules(acts.__path__)
    modules = [importlib.import_module(f"{acts.__name__}.{file.name}") for file in files]
    kinds = {a for module in modules for a in vars(module).values() if isinstance(a, type)}
    assert {a for a in kinds if issubclass(a, Act)} - {Act} == set(ACTS)
    assert [type(act) for act, _ in POSSIBLE] == list(ACTS)
    assert len({act.name for act in ACTS}) == len(ACTS)


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize(("act", "phases"), POSSIBLE, ids=lambda x: getattr(x, "name", ""))
def test_an_act_is_possible_in_its_phases_and_refused_with_words_elsewhere(
    act: Act, phases: set[Phase], phase: Phase
) -> None:
    protested = isinstance(act, DecideProtest | WithdrawProtest)
    run = replace(RUNS[phase], protests=(PROTEST,) if protested else ())
    here = situation(run, *((FAILED,) if isinstance(act, Waive) else ()))
    here = replace(here, indicators=DOUBTED if isinstance(act, AcceptDoubts) else {})
    refusal = act.refusal(here)
    assert (refusal is None) == (phase in phases)
    assert refusal != ""
    assert refusals(here).get(act.name) == refusal
    if phase in phases:
        act.apply(here, 130.0)


WORDS = {
    SetUp: ("run 2 of subject 3 is set up", "set up"),
    ConfirmPose: ("start pose confirmed", "confirm the start pose"),
    ZeroHandle: ("handle zeroed", "zero the handle"),
    Waive: ("check waived: door closed (it is warped)", "check waived: door closed: it is warped"),
    Start: ("the countdown begins", "start"),
    RestartCountdown: (
        "the countdown begins again (false start)",
        "restart the countdown: false start",
    ),
    AcceptFalseStart: ("false start accepted (wind)", "accept the false start: wind"),
    Abort: ("the run is aborted (fire)", "abort: fire"),
    DeclareTimeout: ("timeout declared (gave up)", "declare timeout: gave up"),
    Rule: ("step 1 confirmed (seen)", "referee confirms step 1: seen"),
    MarkIncident: ("incident marked: collision", "incident: collision"),
    AddNote: ("note written (slow)", "note: slow"),
    AcceptDoubts: (
        "doubt accepted: time to handle (seen on video)",
        "referee accepts the doubt on time to handle: seen on video",
    ),
    Finalise: (
        "the result is signed, protested by the team",
        "result signed by R. Eferee, protested by the team",
    ),
    Reissue: ("the next version waits for its signature (appeal)", "re-issue: appeal"),
    Void: ("the run is void, it does not count (unsafe)", "run voided: unsafe"),
    Correct: (
        "corrected to subject 4, condition 1 (typed wrongly)",
        "corrected to subject 4, condition 1: typed wrongly",
    ),
    FileProtest: (
        "protest of Graz about the whole run waits for a decision (it was slower)",
        "Graz protests about the whole run: it was slower",
    ),
    DecideProtest: ("protest 1 upheld (seen on video)", "protest 1 upheld: seen on video"),
    WithdrawProtest: (
        "protest 1 is withdrawn (satisfied)",
        "protest 1 withdrawn by the team: satisfied",
    ),
    TakeBack: (
        "incident taken back (my mistake)",
        "referee takes back the last incident: my mistake",
    ),
}
"""What who did it is told, and what the log says."""


@pytest.mark.parametrize("act", [act for act, _ in POSSIBLE], ids=lambda act: act.name)
def test_an_act_is_told_to_who_did_it_and_in_the_log(act: Act) -> None:
    told, logged = WORDS[type(act)]
    assert done_text(act) == f"Done: {told}"
    log = EventLog()
    entry = Entry(1.0, Origin.REFEREE, act.name, "", act.reason_given, act_details(act))
    for line in (entry, Entry.from_json(entry.to_json())):
        log.add_line(line, None)
    loud = isinstance(act, MarkIncident | Void | Correct | FileProtest | DecideProtest)
    weight = Weight.NOTICE if loud else Weight.PLAIN
    assert [(line.text, line.weight) for line in log.lines] == [(logged, weight)] * 2


@pytest.mark.parametrize(
    ("act", "run", "field", "value"),
    [
        (ZeroHandle(resting(5.9)), READY, "handle_zero", 5.9),
        (ZeroHandle(), replace(READY, handle_zero=4.0), "handle_zero", 4.0),
        (
            AcceptFalseStart("wind"),
            RUNS[Phase.COUNTDOWN],
            "false_starts",
            (FalseStart(101.0, EventName.DOOR_OPENS, "wind"),),
        ),
        (AddNote("slow"), RUNNING, "notes", (Note(130.0, "slow"),)),
        (
            MarkIncident(IncidentKind.OTHER, "bang", 2.0),
            RUNNING,
            "incidents",
            (Incident(107.0, IncidentKind.OTHER, "bang"),),
        ),
        (DeclareTimeout("gave up"), RUNNING, "timeout_at", 130.0),
        (DeclareTimeout("gave up"), RUNNING, "phase", Phase.RUNNING),  # a settle time may run
        (Abort("x" * 3000), RUNNING, "outcome_reason", "x" * 2000),
        (WithdrawProtest(1, "ok"), PROTESTED, "protests", (replace(PROTEST, answer=WITHDRAWN),)),
        (FileProtest("slow", "Graz", "a time", 12.5), STOPPED, "protests", (FILED,)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_an_act_leaves_its_mark_on_the_run(act: Act, run: Run, field: str, value: object) -> None:
    again = act_named(act.name, act_details(act))
    assert getattr(again.apply(situation(run), 130.0), field) == value


def refused(words: str | None, act: Act, run: Run, **here: object) -> object:
    """A row: why the act is not possible there."""
    there = replace(situation(run), **here)  # type: ignore[arg-type]
    return pytest.param(act, there, words, id=f"{act.name}: {words}")


def looking(*checks: Check) -> object:
    return lambda: checks


UNKNOWN = replace(FAILED, state=CheckState.NO_DATA, finding="look at the topic: no angle")
WAIVED = replace(FAILED, state=CheckState.WAIVED)
ALL_SILENT = replace(FAILED, name=CheckName.TOPICS, finding="no testbed: all 6 topics silent")
NO_FORCE = replace(UNKNOWN, name=CheckName.HANDLE)
FIXED = replace(FAILED, name=CheckName.CLOCK, finding="another clock", waivable=False)
WALKERS = TeamList({SETUP.subject: "Delft Walkers"})
VOID = replace(STOPPED, voided=Voiding(5.0, "robot unsafe", "Ada"))
DONE = replace(STOPPED, phase=Phase.FINAL, issue=1)
FULL = replace(STOPPED, protests=(PROTEST,) * 20)


def set_up(**changes: object) -> SetUp:
    return SetUp(replace(SETUP, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("act", "here", "words"),
    [
        refused("close the door: angle +0.500 rad", Start(), READY, look=looking(FAILED)),
        refused("look at the topic: no angle", Start(), READY, look=looking(UNKNOWN)),
        refused("+0.500 rad (and 1 more)", Start(), READY, look=looking(FAILED, UNKNOWN)),
        refused("another clock (and 1 more)", Start(), READY, look=looking(FAILED, FIXED)),
        refused(None, Start(), READY, look=looking(WAIVED)),
        refused("all 6 topics silent", Start(), READY, look=looking(ALL_SILENT, UNKNOWN, NO_FORCE)),
        refused(
            "another clock (and 1 more)", Start(), READY, look=looking(ALL_SILENT, UNKNOWN, FIXED)
        ),
        refused("the result of the last run is being", SetUp(SETUP), STOPPED, scored=False),
        refused("a text has at most 2000", SetUp(replace(SETUP, team_reason="x" * 2001)), READY),
        refused(None, SetUp(SETUP), STOPPED, scored=False, hopeless=True),
        refused("another name needs a reason", SetUp(SETUP), READY, teams=WALKERS),
        refused(None, set_up(team_reason="renamed"), READY, teams=WALKERS),
        refused(None, set_up(team="Delft Walkers"), READY, teams=WALKERS),
        refused(
            "it must lie on the CCW side (x > 0)", set_up(start_pose=StartPose(-1.0, 0, 0)), Run()
        ),
        refused("start pose lies on the threshold", set_up(start_pose=StartPose(0.0, 0, 0)), Run()),
        refused("must be numbers", set_up(start_pose=StartPose(1.5, math.nan, 0)), Run()),
        refused("must be numbers", set_up(start_pose=StartPose(math.inf, 0, 0)), Run()),
        refused("subject 0:", set_up(subject=0), Run()),
        refused("subject 1000:", set_up(subject=1000), Run()),
        refused("run number 1000:", set_up(run_number=1000), Run()),
        refused("timeout 0 s:", set_up(timeout=0.0), Run()),
        refused("countdown -1 s:", set_up(countdown=-1.0), Run()),
        refused("a waiver needs a reason", Waive(CheckName.DOOR, " "), READY, look=looking(FAILED)),
        refused("does not fail", Waive(CheckName.POSE, "?"), READY, look=looking(FAILED)),
        refused(
            "the check 'clock skew' cannot be waived",
            Waive(CheckName.CLOCK, "?"),
            READY,
            look=looking(FIXED),
        ),
        refused("needs a reason", AcceptFalseStart(""), RUNS[Phase.COUNTDOWN]),
        refused("needs a reason", Rule(Step.CROSS, confirmed=False, reason=""), RUNNING),
        refused("a text has at most 2000 characters", Rule(Step.CROSS, None, "x" * 2001), RUNNING),
        refused("the note is empty", AddNote("  "), RUNNING),
        refused(
            "a text has at most 2000 characters",
            Finalise(TeamWord.ABSENT, "Ada", "", ("x" * 2001,)),
            STOPPED,
        ),
        refused(
            "-9 s from the start: the recording began at -5.0 s",
            MarkIncident(IncidentKind.FALL, after_start=-9.0),
            RUNNING,
        ),
        refused("no handle force comes now", ZeroHandle(), READY, measure=lambda: None),
        refused("is not steady: let go of it, wait a second", ZeroHandle(), READY, rest_force=0.01),
        refused(
            "the timeout is already there", DeclareTimeout("x"), replace(RUNNING, timeout_at=9.0)
        ),
        refused("the referee's name", Finalise(TeamWord.ACKNOWLEDGED, ""), STOPPED),
        refused("is being written", Finalise(TeamWord.ABSENT, "Ada"), STOPPED, scored=False),
        refused("No space", Finalise(TeamWord.ABSENT, "Ada"), STOPPED, refused="No space left"),
        refused("a re-issue needs a reason", Reissue(""), DONE),
        refused("is void already: that can be taken back", Void("again"), VOID),
        refused(None, Void("robot unsafe"), replace(STOPPED, outcome=Outcome.ABORTED)),
        refused(
            "let the run end, then correct it", Correct(4, SETUP.condition, "another team"), RUNNING
        ),
        refused(None, Void("robot unsafe"), STOPPED, scored=False),
        refused("the result is being written", Void("robot unsafe"), DONE, scored=False),
        refused("that is what is set up", Correct(3, SETUP.condition, "?"), STOPPED),
        refused("subject 0: use a number", Correct(0, SETUP.condition, "?"), STOPPED),
        refused("a correction needs a reason", Correct(4, SETUP.condition, " "), STOPPED),
        refused("is being written", Correct(4, SETUP.condition, "?"), STOPPED, scored=False),
        refused("the run has stopped: void it instead", Abort("unsafe"), STOPPED),
        refused("the run has stopped", Abort("?"), replace(STOPPED, outcome=Outcome.ABORTED)),
        refused("needs the team's words", FileProtest(" ", "Graz"), STOPPED),
        refused("needs the name of the team", FileProtest("slow", ""), STOPPED),
        refused("a text has at most 2000 characters", FileProtest("x" * 2001, "Graz"), STOPPED),
        refused("60 s outside it", FileProtest("slow", "Graz", "", math.nan), STOPPED),
        refused("add a note", FileProtest("slow", "Graz"), FULL),
        refused("needs words", DecideProtest(1, ProtestEnd.UPHELD, " ", "Ada"), PROTESTED),
        refused("referee's name", DecideProtest(1, ProtestEnd.UPHELD, "?", ""), PROTESTED),
        refused("protest 2 is not open", DecideProtest(2, ProtestEnd.UPHELD, "?", "A"), PROTESTED),
        refused(
            "a protest is withdrawn by the team",
            DecideProtest(1, ProtestEnd.WITHDRAWN, "?", "A"),
            PROTESTED,
        ),
        refused("protest 2 is not open", WithdrawProtest(2, "?"), PROTESTED),
        refused("no protest is open", WithdrawProtest(1, "?"), STOPPED),
        refused("no protest is open", DecideProtest(1, ProtestEnd.UPHELD, "?", "A"), STOPPED),
        refused("there is nothing to take back", TakeBack(DecisionKind.VOID, 1.0, "?"), STOPPED),
        refused(
            "this incident is not the last one",
            TakeBack(DecisionKind.INCIDENT, 1.0, "?"),
            RUNS[Phase.STOPPED],
        ),
        refused(
            "this ruling is not the last one",
            TakeBack(DecisionKind.RULING, 110.0, "?"),
            RUNS[Phase.STOPPED],
        ),
    ],
)
def test_what_is_not_possible_is_refused_with_words(
    act: Act, here: Situation, words: str | None
) -> None:
    said = act.refusal(here)
    if words is None or said is None:
        assert said is words
    else:
        assert words in (said[: len(words)], said[-len(words) :])


@pytest.mark.parametrize(
    ("confirmed", "told", "logged"),
    [
        (False, "step 6 denied", "referee denies step 6"),
        (None, "step 6 as the sensors say", "referee takes back the ruling on step 6"),
    ],
)
def test_a_ruling_says_which_way(confirmed: bool | None, told: str, logged: str) -> None:
    ruling = Rule(Step.LOCK, confirmed, "seen")
    assert (ruling.done_text, ruling.logged) == (told, logged)


def test_what_the_sensors_say_is_worked_out_only_for_who_needs_it() -> None:
    looked: list[str] = []

    def look() -> tuple[Check, ...]:
        looked.append("checks")
        return (FAILED,)

    def measure() -> None:
        looked.append("force")

    here = Situation(RUNNING, look=look, measure=measure)
    assert Abort("fire").refusal(here) is None
    assert Start().refusal(here)
    assert looked == []
    assert refusals(replace(here, run=READY))
    assert sorted(looked) == ["checks", "force"]


@pytest.mark.parametrize("name", ["dance", "void"])
def test_what_is_no_act_is_refused_with_its_name(name: str) -> None:
    with pytest.raises(MadrobError, match=name):
        act_named(name, {})


def test_a_countdown_is_never_shorter_than_the_pre_roll() -> None:
    quick = replace(READY, setup=replace(SETUP, countdown=0.0))
    assert (begin_countdown(quick, 100.0).start, COUNTDOWN.start) == (101.0, 105.0)


def test_the_next_run_is_clean_but_for_the_handle_zero() -> None:
    zero = Run(handle_zero=5.9, zero_samples=resting(5.9))
    used = replace(STOPPED, handle_zero=5.9, zero_samples=resting(5.9), issue=1)
    assert done(used, SetUp(SETUP)) == replace(zero, phase=Phase.READY, setup=SETUP)
    assert set_up(team_reason="renamed").reason_given == "renamed"


def test_the_zero_keeps_the_samples_that_were_measured_whatever_was_asked_for() -> None:
    act = ZeroHandle(resting(20.0)).settled(situation(READY))
    assert act == ZeroHandle(resting(5.9))
    assert act.logged.startswith("zero the handle: 5.900 N, standard deviation 0.050 N")
    assert act_named(act.name, json.loads(json.dumps(act_details(act)))) == act


def test_a_reissue_keeps_rulings_and_counts_up() -> None:
    ruled = Rule(Step.CROSS, confirmed=False, reason="arm").apply(situation(STOPPED), 130.0)
    again = done(replace(ruled, phase=Phase.FINAL, issue=1), Reissue("appeal"))
    assert (again.phase, again.issue, again.rulings) == (Phase.STOPPED, 2, ruled.rulings)


@pytest.mark.parametrize("voided", [None, VOID.voided])
@pytest.mark.parametrize("outcome", Outcome)
def test_a_result_waits_for_a_signature_unless_the_referee_has_ended_it_as_invalid(
    outcome: Outcome, voided: Voiding | None
) -> None:
    run = Run(Phase.STOPPED, SETUP, outcome=outcome, voided=voided)
    assert run.unsigned is (outcome is not Outcome.ABORTED and not voided)


@pytest.mark.parametrize(
    ("told", "value", "words"),
    [
        (format_size, 0, "0 B"),
        (format_size, 999, "999 B"),
        (format_size, 730_000, "730 kB"),
        (format_size, 2_200_000, "2.2 MB"),
        (format_size, 5_000_000, "5.0 MB"),
        (format_size, 999_960_000, "1.0 GB"),
        (format_size, 500_000_000, "500 MB"),
        (format_size, 1_234_000_000_000, "1.2 TB"),
        (format_span, 0.3, "1 s"),
        (format_span, 59.9, "59 s"),
        (format_span, 60, "1 min"),
        (format_span, 68.4, "1 min 8 s"),
        (format_span, 299.9, "4 min 59 s"),
        (format_span, 300, "5 min"),
        (format_span, 3599, "59 min"),
        (format_span, 3900, "1 h 05 min"),
        (format_span, 47 * 3600 + 3599, "47 h 59 min"),
        (format_span, 3 * 86400 - 1, "2 days"),
        (listed, "a", "a"),
        (listed, "ab", "a, b"),
        (listed, "abcd", "a, b and 2 more"),
        (lambda number: counted(number, "topic"), 0, "0 topics"),
        (lambda number: counted(number, "topic"), 1, "1 topic"),
        (lambda number: counted(number, "topic"), 2, "2 topics"),
    ],
)
def test_sizes_spans_and_lists_are_told_as_people_say_them(
    told: Callable[[Any], str], value: object, words: str
) -> None:
    assert told(value) == words


def test_identities_hang_on_time_and_chance_alone_as_in_rfc_9562() -> None:
    chance = 0xCC3 << 62 | 0x18C4DC0C0C07398F
    made = new_run_id(0x017F22E279B0 * 1_000_000, lambda count: chance.to_bytes(count, "big"))
    assert made == "017f22e2-79b0-7cc3-98c4-dc0c0c07398f"


def health(*times: float) -> Health:
    found = Health()
    for time in times:
        found.add(time)
    return found


def at(rate: float, begin: float = 100.0) -> list[float]:
    """Times of 3 s of messages."""
    return [begin + i / rate for i in range(int(rate * 3))]


@pytest.mark.parametrize(
    ("times", "now", "state", "rate"),
    [
        ([], 1.0, Freshness.NEVER, None),
        ([100.0], 100.5, Freshness.FRESH, None),
        ([100.0], 100.51, Freshness.STALE, None),
        ([100.0], 102.0, Freshness.STALE, None),
        ([100.0], 102.01, Freshness.LOST, None),
        (at(10.0), 103.0, Freshness.FRESH, 10.0),
        (at(50.0), 103.0, Freshness.FRESH, 50.0),
        (at(1500.0), 103.0, Freshness.FRESH, 1500.0),
        (at(50.0), 110.0, Freshness.LOST, None),
        (at(50.0), 103.0 - 3600, Freshness.LOST, None),
        ([*at(50.0), *at(50.0, 100.0 - 3600)], 103.0 - 3600, Freshness.FRESH, 50.0),  # stepped back
    ],
)
def test_a_topic_ages_and_has_the_rate_of_its_last_two_seconds(
    times: list[float], now: float, state: Freshness, rate: float | None
) -> None:
    found = health(*times)
    assert (found.freshness(now), found.age(now) is None) == (state, not times)
    assert found.rate(now) == (rate and pytest.approx(rate, rel=0.06))


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=50), st.floats(0, 1e6))
def test_fresh_means_a_message_within_half_a_second(times: list[float], now: float) -> None:
    fresh = health(*times).freshness(now) is Freshness.FRESH
    assert fresh == (abs(now - times[-1]) <= 0.5)
