"""Every act in every phase: possible or refused with words."""

from __future__ import annotations

import importlib
import json
import pkgutil
from dataclasses import replace
from random import Random
from uuid import NAMESPACE_URL, RFC_4122, UUID, uuid5

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.formatting import counted, format_size, format_span, listed
from madrob_console.engine.run_recorder import EventLog
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
    WithdrawIncident,
    WithdrawProtest,
    ZeroHandle,
    act_details,
    act_named,
    refusals,
)
from madrob_console.referee.acts.act import Option, Pick
from madrob_console.referee.checks import Check, CheckState, Freshness, Health
from madrob_console.referee.flags import Doubts
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.lists import TeamList
from madrob_console.referee.records import (
    CheckName,
    DecisionKind,
    FalseStart,
    Incident,
    IncidentKind,
    Protest,
    ProtestEnd,
    RunSetup,
    TeamWord,
    Voiding,
    derived_run_id,
    new_run_id,
)
from madrob_console.referee.run import Phase, Run, begin_countdown, begin_run, stop
from madrob_console.ui.look.words import done_text
from scoring.indicator_table import IndicatorName
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
from scoring.rest import HandleRest
from scoring.result import Indicator
from scoring.rulesets import RulesetName
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

PROTEST = Protest(1, 130.0, "Graz", "it was slower", "step 4", None, "R. Eferee")

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
    (WithdrawIncident("by mistake"), {Phase.STOPPED}),  # it has one to withdraw
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


def test_all_acts_are_here() -> None:
    assert [type(act) for act, _ in POSSIBLE] == list(ACTS)
    assert len({act.name for act in ACTS}) == len(ACTS)


def test_every_file_of_an_act_is_in_the_list() -> None:
    found = set()
    for file in pkgutil.iter_modules(acts.__path__):
        module = importlib.import_module(f"{acts.__name__}.{file.name}")
        found |= {a for a in vars(module).values() if isinstance(a, type) and issubclass(a, Act)}
    assert found - {Act} == set(ACTS)


def test_an_act_has_to_say_when_it_is_possible() -> None:
    with pytest.raises(TypeError, match="Void does not say its phases"):

        class Void(Act):
            name = "void"

            def apply(self, situation: Situation, at: float) -> Run:
                return situation.run


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize(("act", "phases"), POSSIBLE, ids=lambda x: getattr(x, "name", ""))
def test_an_act_is_possible_in_its_phases_and_refused_with_words_elsewhere(
    act: Act, phases: set[Phase], phase: Phase
) -> None:
    checks = (FAILED,) if isinstance(act, Waive) else ()
    here = situation(RUNS[phase], *checks)
    if isinstance(act, DecideProtest | WithdrawProtest):
        here = replace(here, run=replace(here.run, protests=(PROTEST,)))
    if isinstance(act, AcceptDoubts):
        here = replace(here, indicators=DOUBTED)
    refusal = act.refusal(here)
    if phase in phases:
        assert refusal is None
        act.apply(here, 130.0)
    else:
        assert refusal
    assert refusals(here).get(act.name) == refusal


WORDS = {
    SetUp: ("run 2 of subject 3 is set up", "set up"),
    ConfirmPose: ("confirm the start pose", "confirm the start pose"),
    ZeroHandle: ("zero the handle", "zero the handle"),
    Waive: ("'door closed' waived (it is warped)", "check waived: door closed: it is warped"),
    Start: ("start", "start"),
    RestartCountdown: (
        "restart the countdown (false start)",
        "restart the countdown: false start",
    ),
    AcceptFalseStart: ("accept the false start (wind)", "accept the false start: wind"),
    Abort: ("abort (fire)", "abort: fire"),
    DeclareTimeout: ("declare timeout (gave up)", "declare timeout: gave up"),
    Rule: ("step 1 confirmed (seen)", "referee confirms step 1: seen"),
    MarkIncident: ("collision marked", "incident: collision"),
    WithdrawIncident: ("withdraw an incident (by mistake)", "withdraw an incident: by mistake"),
    AddNote: ("note (slow)", "note: slow"),
    AcceptDoubts: (
        "doubt accepted: time to handle (seen on video)",
        "referee accepts the doubt on time to handle: seen on video",
    ),
    Finalise: ("the result is final, protested by the team", "finalise"),
    Reissue: ("re-issue (appeal)", "re-issue: appeal"),
    Void: ("the run is void and counts nowhere (unsafe)", "run voided: unsafe"),
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

    def measure() -> HandleRest:
        looked.append("force")
        return resting(5.9)

    here = Situation(RUNNING, look=look, measure=measure)
    assert Abort("fire").refusal(here) is None
    assert Start().refusal(here)
    assert looked == []
    ready = Situation(READY, look=look, measure=measure)
    assert refusals(ready)
    assert sorted(looked) == ["checks", "force"]


def test_two_answers_to_a_question_never_have_the_same_key() -> None:
    fall, fire = Option("f", "fall", "fall"), Option("f", "fire", "fire")
    with pytest.raises(ValueError, match="'Which\\?': two options have the same key"):
        Pick("Which?", (fall, fire))


def test_start_needs_every_check_and_says_which_fails() -> None:
    assert Start().refusal(situation(READY, FAILED)) == "close the door: angle +0.500 rad"
    unknown = replace(FAILED, state=CheckState.NO_DATA, reason="look at the topic: no angle")
    assert Start().refusal(situation(READY, unknown)) == "look at the topic: no angle"
    two = Start().refusal(situation(READY, FAILED, unknown))
    assert two == "close the door: angle +0.500 rad (and 1 more)"
    waived = replace(FAILED, state=CheckState.WAIVED)
    assert Start().refusal(situation(READY, waived)) is None


def test_a_countdown_is_never_shorter_than_the_pre_roll() -> None:
    quick = replace(READY, setup=replace(SETUP, countdown=0.0))
    assert begin_countdown(quick, 100.0).start == 101.0
    assert COUNTDOWN.start == 105.0


def test_the_next_run_is_clean_but_for_the_handle_zero() -> None:
    used = replace(
        STOPPED, handle_zero=5.9, zero_samples=resting(5.9), pose_confirmed=True, issue=1
    )
    fresh = SetUp(SETUP).apply(situation(used), 200.0)
    assert fresh == Run(Phase.READY, SETUP, handle_zero=5.9, zero_samples=resting(5.9))


def test_another_name_than_the_lists_is_set_up_with_a_reason_only() -> None:
    here = replace(situation(READY), teams=TeamList({SETUP.subject: "Delft Walkers"}))
    other = replace(SETUP, team="Delft")
    assert "another name needs a reason" in (SetUp(other).refusal(here) or "")
    act = SetUp(replace(other, team_reason="renamed"))
    assert act.refusal(here) is None
    assert act.reason_given == "renamed"
    assert SetUp(replace(SETUP, team="Delft Walkers")).refusal(here) is None


def test_the_result_has_to_be_written_before_the_next_run() -> None:
    assert SetUp(SETUP).refusal(Situation(STOPPED, scored=False))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start_pose": StartPose(-1.0, 0, 0)}, "CCW side"),
        ({"start_pose": StartPose(0.0, 0, 0)}, "threshold"),
        ({"start_pose": StartPose(1.5, float("nan"), 0)}, "start pose"),
        ({"start_pose": StartPose(float("inf"), 0, 0)}, "start pose"),
        ({"subject": 0}, "subject"),
        ({"run_number": 1000}, "run number"),
        ({"timeout": 0.0}, "timeout"),
        ({"countdown": -1.0}, "countdown"),
    ],
)
def test_a_bad_setup_is_refused_naming_the_field(change: dict[str, object], words: str) -> None:
    refusal = SetUp(replace(SETUP, **change)).refusal(situation(Run()))  # type: ignore[arg-type]
    assert refusal is not None
    assert words in refusal


@pytest.mark.parametrize(
    ("act", "run"),
    [
        (Waive(CheckName.DOOR, " "), READY),
        (AcceptFalseStart(""), RUNS[Phase.COUNTDOWN]),
        (Rule(Step.CROSS, confirmed=False, reason=""), RUNNING),
        (AddNote("  "), RUNNING),
        (Finalise(TeamWord.ACKNOWLEDGED, ""), STOPPED),
        (Reissue(""), RUNS[Phase.FINAL]),
    ],
)
def test_an_act_without_its_reason_is_refused(act: Act, run: Run) -> None:
    assert act.refusal(situation(run, FAILED))


def test_zeroing_needs_fresh_data() -> None:
    assert ZeroHandle().refusal(Situation(READY)) == "no fresh handle force"


def test_a_handle_that_somebody_moves_gives_no_zero() -> None:
    moved = Situation(READY, measure=lambda: resting(5.9, span=8.0), rest_force=0.98)
    refused = ZeroHandle().refusal(moved)
    assert refused == "the handle force is not steady: let go of it, wait a second"


def test_the_zero_keeps_the_samples_that_were_measured_whatever_was_asked_for() -> None:
    act = ZeroHandle(resting(20.0)).settled(situation(READY))
    run = act.apply(situation(READY), 50.0)
    assert (run.handle_zero, run.zero_samples) == (5.9, resting(5.9))
    assert act.logged.startswith("zero the handle: 5.900 N, standard deviation 0.050 N")
    again = act_named(act.name, json.loads(json.dumps(act_details(act))))
    assert again == act


def test_the_zero_of_an_earlier_version_has_no_samples() -> None:
    old = act_named("zero the handle", {})
    run = replace(READY, handle_zero=5.9)
    assert old.apply(Situation(run), 50.0) == run


def test_a_reissue_keeps_rulings_and_counts_up() -> None:
    ruled = Rule(Step.CROSS, confirmed=False, reason="arm").apply(situation(STOPPED), 130.0)
    final = replace(ruled, phase=Phase.FINAL, issue=1)
    again = Reissue("appeal").apply(situation(final), 140.0)
    assert (again.phase, again.issue, again.rulings) == (Phase.STOPPED, 2, ruled.rulings)


def test_a_declared_timeout_counts_from_its_instant() -> None:
    declared = DeclareTimeout("gave up").apply(situation(RUNNING), 112.0)
    assert (declared.phase, declared.timeout_at) == (Phase.RUNNING, 112.0)
    assert DeclareTimeout("again").refusal(situation(declared))


def test_an_incident_is_withdrawn_and_stays_on_record() -> None:
    run = replace(
        STOPPED, incidents=(Incident(1.0, IncidentKind.FALL), Incident(2.0, IncidentKind.OTHER))
    )
    once = WithdrawIncident("a shadow").apply(situation(run), 3.0)
    assert [mark.withdrawn for mark in once.incidents] == [None, "a shadow"]
    twice = WithdrawIncident("no fall").apply(situation(once), 4.0)
    assert [mark.withdrawn for mark in twice.incidents] == ["no fall", "a shadow"]
    assert WithdrawIncident("?").refusal(situation(twice)) == "there is no incident to withdraw"


@pytest.mark.parametrize("voided", [False, True])
@pytest.mark.parametrize("outcome", Outcome)
def test_a_result_waits_for_a_signature_unless_the_referee_has_ended_it_as_invalid(
    outcome: Outcome, *, voided: bool
) -> None:
    void = Voiding(5.0, "robot unsafe", "Ada") if voided else None
    run = Run(Phase.STOPPED, SETUP, outcome=outcome, voided=void)
    assert run.unsigned is (outcome is not Outcome.ABORTED and not voided)


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (730_000, "730 kB"),
        (2_200_000, "2.2 MB"),
        (5_000_000, "5.0 MB"),
        (999_960_000, "1.0 GB"),
        (500_000_000, "500 MB"),
        (1_234_000_000_000, "1.2 TB"),
    ],
)
def test_a_size_is_told_in_the_unit_that_says_something(size: int, words: str) -> None:
    assert format_size(size) == words


@given(st.integers(1, 10**15))
def test_no_size_is_told_as_nothing(size: int) -> None:
    number, _ = format_size(size).split()
    assert float(number) > 0.9


@pytest.mark.parametrize(
    ("span", "words"),
    [
        (0.3, "1 s"),
        (59.9, "59 s"),
        (60, "1 min"),
        (68.4, "1 min 8 s"),
        (299.9, "4 min 59 s"),
        (300, "5 min"),
        (3599, "59 min"),
        (3900, "1 h 05 min"),
        (47 * 3600 + 3599, "47 h 59 min"),
        (3 * 86400 - 1, "2 days"),
    ],
)
def test_a_span_is_told_in_units_that_say_something(span: float, words: str) -> None:
    assert format_span(span) == words


def test_of_many_names_the_first_are_told() -> None:
    assert [listed("abcd"[:n]) for n in (1, 2, 4)] == ["a", "a, b", "a, b and 2 more"]


def test_one_is_one() -> None:
    assert [counted(number, "topic") for number in (0, 1, 2)] == ["0 topics", "1 topic", "2 topics"]


DIGEST = "488b9290a49c12afaffc94fef48b19fbdcbd1ed80ef910c4e48a25f192b08ac9"


@given(milliseconds=st.integers(0, 2**48 - 1), seed=st.integers())
def test_a_new_identity_is_a_uuid_of_version_7_with_the_time_of_the_set_up(
    milliseconds: int, seed: int
) -> None:
    found = UUID(new_run_id(milliseconds * 1_000_000, Random(seed).randbytes))
    assert (found.version, found.variant) == (7, RFC_4122)
    assert found.int >> 80 == milliseconds


def test_the_example_of_rfc_9562_comes_of_its_time_and_its_chance() -> None:
    chance = 0xCC3 << 62 | 0x18C4DC0C0C07398F
    made = new_run_id(0x017F22E279B0 * 1_000_000, lambda count: chance.to_bytes(count, "big"))
    assert made == "017f22e2-79b0-7cc3-98c4-dc0c0c07398f"


def test_clock_and_chance_are_given_so_that_the_identity_is_known_beforehand() -> None:
    assert new_run_id(5, Random(1).randbytes) == new_run_id(5, Random(1).randbytes)
    assert new_run_id(5, Random(1).randbytes) != new_run_id(5, Random(2).randbytes)


def test_the_identity_of_an_older_run_hangs_on_its_recording_alone() -> None:
    assert derived_run_id(DIGEST) == str(uuid5(NAMESPACE_URL, f"urn:sha256:{DIGEST}"))
    assert UUID(derived_run_id(DIGEST)).version == 5


def health(rate: float = 50.0, duration: float = 3.0, begin: float = 100.0) -> Health:
    found = Health()
    for i in range(int(rate * duration)):
        found.seen(begin + i / rate)
    return found


@pytest.mark.parametrize(
    ("silence", "state"),
    [
        (0.5, Freshness.FRESH),
        (0.51, Freshness.STALE),
        (2.0, Freshness.STALE),
        (2.01, Freshness.LOST),
    ],
)
def test_a_topic_ages(silence: float, state: Freshness) -> None:
    found = Health()
    found.seen(100.0)
    assert found.freshness(100.0 + silence) is state


def test_a_topic_that_never_spoke_has_neither_age_nor_rate() -> None:
    found = Health()
    assert found.freshness(1.0) is Freshness.NEVER
    assert (found.age(1.0), found.rate(1.0)) == (None, None)


@pytest.mark.parametrize("rate", [10.0, 50.0, 1500.0])
def test_the_rate_is_that_of_the_last_two_seconds(rate: float) -> None:
    assert health(rate).rate(103.0) == pytest.approx(rate, rel=0.06)


def test_a_silent_topic_loses_its_rate() -> None:
    assert health().rate(110.0) is None


def test_after_the_clock_was_stepped_back_nothing_old_is_fresh() -> None:
    found = health()
    assert found.freshness(103.0 - 3600) is Freshness.LOST
    for i in range(200):
        found.seen(103.0 - 3600 + i / 50)
    assert found.freshness(107.0 - 3600) is Freshness.FRESH
    assert found.rate(107.0 - 3600) == pytest.approx(50, rel=0.05)


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=50), st.floats(0, 1e6))
def test_fresh_means_a_message_within_half_a_second(times: list[float], now: float) -> None:
    found = Health()
    for time in times:
        found.seen(time)
    if found.freshness(now) is Freshness.FRESH:
        assert abs(now - times[-1]) <= 0.5
