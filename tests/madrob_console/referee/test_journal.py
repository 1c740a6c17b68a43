"""The journal: on disk before it takes effect, readable whatever happened to its end."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.referee.acts import Abort, Finalise, Rule, SetUp, Situation, act_details
from madrob_console.referee.flags import (
    LONGEST_WORDS,
    Flag,
    FlagKind,
    FlagWeight,
    flags,
    undecided,
    untold_remarks,
    worst,
)
from madrob_console.referee.journal import Entry, Journal, Origin, read_journal
from madrob_console.referee.rebuild import Change, act_of, rebuild
from madrob_console.referee.records import (
    CheckName,
    Closure,
    FalseStart,
    FaultKind,
    Incident,
    IncidentKind,
    TeamWord,
    Voiding,
    Waiver,
    merged,
)
from madrob_console.referee.records import TestbedFault as Fault
from madrob_console.referee.run import Phase, Run, decide_false_starts
from scoring.events import Evidence
from scoring.procedure import Procedure, Ruling, follow_procedure
from scoring.protocol import EventName, LockDetection, Outcome, Signal, Step
from scoring.quality import Quality, SignalQuality
from tests.madrob_console.referee.test_acts import SETUP
from tests.madrob_console.ui.fake_engine import a_setup

texts = st.text(max_size=40)
entries = st.builds(
    Entry,
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from(Origin),
    texts,
    texts,
    texts,
    st.dictionaries(texts, st.one_of(texts, st.integers(), st.booleans()), max_size=3),
)


@given(entries)
def test_a_line_comes_back_as_it_was(entry: Entry) -> None:
    line = entry.to_json()
    assert "\n" not in line
    assert Entry.from_json(line) == entry


@given(st.text())
def test_what_is_no_line_raises_nothing_but_our_error(text: str) -> None:
    with suppress(MadrobError):
        Entry.from_json(text)


def line(number: int) -> Entry:
    return Entry(float(number), Origin.SYSTEM, f"line {number}")


def test_several_lines_are_brought_to_the_disk_by_one_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, synced = Journal(), list[int]()
    journal.open(tmp_path / "journal.jsonl")
    monkeypatch.setattr(os, "fsync", synced.append)
    assert journal.append([line(0), line(1)]) == 2
    assert journal.append([]) == 0
    assert len(synced) == 1
    journal.close()
    assert read_journal(tmp_path / "journal.jsonl") == ((line(0), line(1)), ())


def test_a_torn_last_line_is_set_aside(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    whole = (line(0).to_json() + "\n" + line(1).to_json() + "\n").encode()
    for cut in range(len(line(0).to_json()) + 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        found, remarks = read_journal(path)
        assert found[:1] == (line(0),)
        assert len(found) + len(remarks) == 2


def test_an_existing_journal_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        Journal().open(path)
    assert path.read_text() == "mine"


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from madrob_console.referee.journal import Entry, Journal, Origin

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
journal = Journal()
journal.open(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_FSIZE, (150, resource.RLIM_INFINITY))
long = Entry(1.0, Origin.REFEREE, "note", reason="x" * 200)
print(journal.append([long]), journal.refused.strerror)
print(journal.append([Entry(2.0, Origin.REFEREE, "abort"), long]), journal.refused.strerror)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
print(journal.append([Entry(3.0, Origin.SYSTEM, "end")]), journal.refused)
"""


@pytest.mark.machine
def test_a_full_disk_takes_the_lines_that_it_has_room_for_and_no_part_of_one(
    tmp_path: Path,
) -> None:
    path = tmp_path / "journal.jsonl"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)],
        capture_output=True, text=True, check=True, env=os.environ,
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        "0 No space left on device",
        "1 No space left on device",
        "1 None",
    ]
    found, remarks = read_journal(path)
    assert [entry.what for entry in found] == ["abort", "end"]
    assert remarks == ()


def test_the_state_is_rebuilt_from_the_journal() -> None:
    def act(time: float, act: SetUp | Rule | Abort) -> Entry:
        return Entry(time, Origin.REFEREE, act.name, details=act_details(act))

    lines = [
        act(1.0, SetUp(SETUP)),
        Entry(2.0, Origin.REFEREE, "start"),
        Entry(7.0, Origin.CLOCK, Change.RUN_STARTS, details={"time": 7.0}),
        act(9.0, Rule(Step.TOUCH, confirmed=True, reason="seen")),
        Entry(
            20.0, Origin.CLOCK, Change.RUN_STOPS, reason="done",
            details={"outcome": "completed", "time": 19.0},
        ),
    ]  # fmt: skip
    run = rebuild([Entry.from_json(entry.to_json()) for entry in lines], handle_zero=5.9)
    assert (run.phase, run.outcome) == (Phase.STOPPED, Outcome.COMPLETED)
    assert (run.start, run.stop, run.handle_zero) == (7.0, 19.0, 5.9)
    assert run.setup == SETUP
    assert run.rulings[0].step is Step.TOUCH


def test_a_damaged_line_is_named() -> None:
    with pytest.raises(MadrobError, match="rule on a step"):
        act_of(Entry(1.0, Origin.REFEREE, "rule on a step", details={"step": 9}))
    with pytest.raises(MadrobError, match="run stops"):
        rebuild([Entry(1.0, Origin.CLOCK, "run stops", details={"outcome": "won"})])


@pytest.mark.parametrize("text", ["robot\u2028never touched", "a\x85b", "a\u2029b", "\udcff"])
def test_every_character_of_a_reason_survives(text: str, tmp_path: Path) -> None:
    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    entry = Entry(1.0, Origin.REFEREE, "note", reason=text)
    assert journal.append([entry]) == 1
    journal.close()
    assert read_journal(path) == ((entry,), ())


def test_what_the_disk_took_and_could_not_sync_is_no_part_of_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    assert journal.append([line(0)]) == 1
    monkeypatch.setattr(os, "fsync", broken)
    assert journal.append([line(1), line(2)]) == 0
    assert journal.refused is not None
    assert journal.refused.strerror == "Input/output error"
    assert read_journal(path) == ((line(0),), ())
    monkeypatch.undo()
    assert journal.append([line(2), line(3)]) == 2
    assert journal.refused is None
    assert read_journal(path) == ((line(0), line(2), line(3)), ())


def test_where_nothing_can_be_taken_back_a_line_withdraws_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    assert journal.append([line(0)]) == 1
    monkeypatch.setattr(os, "ftruncate", broken)
    with monkeypatch.context() as sick:
        sick.setattr(os, "fsync", broken)
        assert journal.append([line(1), line(2)]) == 0
        assert journal.append([line(1), line(2)]) == 0
    assert journal.append([line(2), line(3)]) == 2
    what = [entry.what for entry in read_journal(path)[0] if entry.what != "withdrawn"]
    assert what == ["line 0", "line 2", "line 3"]


def broken(*_arguments: object) -> None:
    raise OSError(5, "Input/output error")


def act(number: int, name: str = "finalise") -> Entry:
    return Entry(float(number), Origin.REFEREE, name, id=f"id {number}")


def withdrawn(**details: object) -> Entry:
    return Entry(9.0, Origin.SYSTEM, "withdrawn", details=details)


@pytest.mark.parametrize(
    ("lines", "stand"),
    [
        ([line(0), act(1), line(2), withdrawn(id="id 1")], [line(0), line(2)]),
        ([act(1), withdrawn(id="id 1"), act(1)], [act(1)]),
        ([act(1), withdrawn(id="id 2")], [act(1)]),
        ([act(1), withdrawn()], [act(1)]),
        ([line(0), line(1), withdrawn(lines=1)], [line(0)]),
        ([line(0), withdrawn(lines=10**9)], []),
        ([line(0), withdrawn(lines=-5)], [line(0)]),
        ([line(0), withdrawn(lines="all", id=["id 1"])], [line(0)]),
    ],
)
def test_what_was_withdrawn_counts_for_nobody_who_reads(
    lines: list[Entry], stand: list[Entry], tmp_path: Path
) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text("".join(one.to_json() + "\n" for one in lines))
    found, remarks = read_journal(path)
    assert [entry for entry in found if entry.what != "withdrawn"] == stand
    assert remarks == ()


NEEDED = [signal for signal in Signal if not signal.optional]

RUN = Run(start=100.0, stop=150.0, outcome=Outcome.COMPLETED)
TOUCH = FalseStart(98.0, EventName.HANDLE_IS_TOUCHED)


def ruled(step: Step, confirmed: bool | None) -> Ruling:
    return Ruling(step, confirmed, 160.0, "seen on video", "Ada")


def late(time: float) -> Fault:
    return Fault(time, "all 6 topics: stamps 0.12 s late, for 1.0 s", FaultKind.SKEW)


def waived(check: CheckName) -> Waiver:
    return Waiver(check, "known", "Ada", 90.0)


NAMED = replace(a_setup(), team_reason="renamed since")
"""The team has another name than in the list."""


@pytest.mark.parametrize(
    ("run", "words", "weight"),
    [
        (
            replace(RUN, setup=NAMED),
            "team's name other than the list's: renamed since",
            FlagWeight.REMARK,
        ),
        (
            replace(RUN, false_starts=(TOUCH,)),
            "1 false start UNDECIDED (handle touched)",
            FlagWeight.ALARM,
        ),
        (
            replace(RUN, false_starts=(TOUCH, FalseStart(99.0, EventName.DOOR_OPENS), TOUCH)),
            "3 false starts UNDECIDED (first: handle touched)",
            FlagWeight.ALARM,
        ),
        (
            replace(RUN, false_starts=(replace(TOUCH, accepted="nothing gained"),)),
            "1 false start accepted",
            FlagWeight.REMARK,
        ),
        (
            replace(RUN, faults=(late(99.0), late(101.0))),
            "2 testbed faults",
            FlagWeight.REMARK,
        ),
        (
            replace(RUN, faults=(late(99.0), Fault(101.0, "of an earlier version"))),
            "2 testbed faults",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, faults=(Fault(99.0, "keep one", FaultKind.SEVERAL_PUBLISHERS),)),
            "1 testbed fault",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, unrecorded=1),
            "the recording lacks 1 message: the result cannot be made again from it",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, incidents=(Incident(140.0, IncidentKind.FALL),)),
            "1 incident (fall)",
            FlagWeight.REMARK,
        ),
        (
            replace(RUN, waivers=(waived(CheckName.CLOCK),)),
            "waived: clock skew",
            FlagWeight.REMARK,
        ),
        (
            replace(RUN, waivers=tuple(waived(name) for name in (CheckName.CLOCK, CheckName.POSE))),
            "waived: clock skew, start pose",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, voided=Voiding(170.0, "the door was jammed", "Ada")),
            "VOID, counts nowhere (the door was jammed)",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, rulings=(ruled(Step.OPEN, False), ruled(Step.CROSS, False))),
            "steps 3, 4 denied",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, rulings=(ruled(Step.CROSS, False), ruled(Step.CROSS, True))),
            "step 4 confirmed",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, closure=Closure(170.0, "Ada", TeamWord.PROTESTED)),
            "PROTESTED by the team",
            FlagWeight.CAUTION,
        ),
    ],
)
def test_what_a_decision_hangs_on_is_a_flag(run: Run, words: str, weight: FlagWeight) -> None:
    (flag,) = flags(run)
    assert (flag.words, flag.weight) == (words, weight)
    assert flag.undecided == ("UNDECIDED" in words)


def a_signal(signal: Signal = Signal.DOOR, gap: float = 0.021) -> SignalQuality:
    return SignalQuality(signal, 900, 50.0, gap, 0, 0.0002, 0, 0, 0, 0.01)


SOUND = a_signal()


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        ([a_signal(gap=0.5)], None),
        ([a_signal(gap=0.51)], "door angle: no sample for 0.5 s"),
        ([replace(SOUND, ends_early=3.0)], "door angle: no sample for 3.0 s"),
        ([replace(SOUND, begins_late=3.0)], "door angle: no sample for 3.0 s"),
        ([replace(SOUND, samples=0, largest_gap=None)], "door angle: nothing recorded"),
        ([replace(SOUND, shifted=9)], "door angle: clock stepped, stamps shifted"),
        ([a_signal(Signal.LATCH, 9.0)], None),
        (
            [a_signal(signal, 3.0) for signal in (Signal.DOOR, Signal.HANDLE)],
            "door angle, handle force: no sample for 3.0 s",
        ),
        (
            [a_signal(signal, 1.0 + at) for at, signal in enumerate(NEEDED)],
            "all 6 topics: no sample for 6.0 s",
        ),
    ],
)
def test_what_may_have_been_missed_is_a_flag(
    signals: list[SignalQuality], words: str | None
) -> None:
    wanted = [] if words is None else [Flag(FlagKind.FAULT, words, FlagWeight.CAUTION)]
    assert list(flags(RUN, quality=Quality(tuple(signals)))) == wanted


def test_a_remark_that_a_fault_has_told_is_not_told_again() -> None:
    off = "stamps differ from reception by up to"
    quality = Quality(
        remarks=(
            *(f"{signal.value}: {off} 0.{at} s" for at, signal in enumerate(NEEDED)),
            *("door angle: 2 gaps, the longest 0.300 s", "the journal lacks 1 line"),
        )
    )
    others = ["door angle: 2 gaps, the longest 0.300 s", "the journal lacks 1 line"]
    assert untold_remarks(RUN, quality) == [f"all 6 topics: {off} 0.5 s", *others]
    run = replace(RUN, faults=(late(110.0),))
    told = replace(quality, remarks=(*quality.remarks, *run.remarks()))
    assert untold_remarks(run, told) == others


@pytest.mark.parametrize(
    ("told", "lines"),
    [
        ([("a", "silent for 1.0 s")], ["a: silent for 1.0 s"]),
        ([("a", "2 late"), ("b", "10 late"), ("c", "9 late")], ["a, b and 1 more: 10 late"]),
        ([("a", "late"), ("b", "late"), ("c", "NaN")], ["a, b: late", "c: NaN"]),
        ([("a", "late"), ("a", "9 Hz")], ["a: late; 9 Hz"]),
        ([(one.value, "9 ms late") for one in NEEDED], ["all 6 topics: 9 ms late"]),
        (
            [(one.value, f"silent for 2.{at} s") for at, one in enumerate(NEEDED)],
            ["no testbed: all 6 topics silent for 2.5 s"],
        ),
    ],
)
def test_one_cause_is_one_line(told: list[tuple[str, str]], lines: list[str]) -> None:
    assert merged(told) == lines


def test_a_fault_that_is_noted_again_has_its_newest_words() -> None:
    entries = [
        Entry(101.0, Origin.SYSTEM, Change.FAULT, reason=words, details=details)
        for words, details in (
            ("door angle: silent for 1.0 s", {"time": 100.5, "kind": "silent"}),
            ("door angle: of an earlier version", {"time": 100.5}),
            ("door angle, handle force: silent for 3.0 s", {"time": 100.5, "kind": "silent"}),
            ("of a later version", {"time": 100.5, "kind": "moon"}),
        )
    ]
    assert rebuild(entries).faults == (
        Fault(100.5, "door angle: of an earlier version"),
        Fault(100.5, "door angle, handle force: silent for 3.0 s", FaultKind.SILENT),
        Fault(100.5, "of a later version"),
    )


def test_what_was_taken_back_is_no_flag() -> None:
    fall = Incident(140.0, IncidentKind.FALL, withdrawn="it was the other robot")
    rulings = (ruled(Step.CROSS, False), ruled(Step.CROSS, None))
    acknowledged = Closure(170.0, "Ada", TeamWord.ACKNOWLEDGED)
    run = replace(RUN, incidents=(fall,), rulings=rulings, closure=acknowledged)
    assert flags(run, source=SourceKind.ROS) == ()
    assert worst(()) is None


def test_a_run_beyond_the_plan_is_flagged() -> None:
    setup = replace(a_setup(), out_of_plan=True)
    (flag,) = flags(replace(RUN, setup=setup), source=SourceKind.ROS)
    words = "out of plan: more than the competition planned"
    assert flag == Flag(FlagKind.OUT_OF_PLAN, words, FlagWeight.CAUTION)


def test_a_result_of_no_real_testbed_is_flagged() -> None:
    (flag,) = flags(RUN, source=SourceKind.SIMULATED)
    assert flag == Flag(FlagKind.PRACTICE, "SIMULATED: not an official result", FlagWeight.REMARK)


def locking(mode: LockDetection, *rulings: Ruling) -> Procedure:
    """Five steps done; only the referee can say whether the door is locked."""
    evidence = Evidence(100.0, 150.0, None, (), None, (), latch_before_start=False, crossed=None)
    early = [ruled(step, True) for step in list(Step)[:5]]
    return follow_procedure(
        evidence, lock_detection=mode, settle_time=1.0, rulings=(*early, *rulings)
    )


@pytest.mark.parametrize("mode", [LockDetection.REFEREE, LockDetection.SENSOR])
def test_a_lock_that_only_the_referee_can_judge_is_undecided(mode: LockDetection) -> None:
    found = undecided(flags(RUN, locking(mode).steps))
    assert [flag.kind for flag in found] == [FlagKind.UNDECIDED_STEP]
    assert "step 6 UNDECIDED" in found[0].words
    for verdict in (True, False):
        decided = locking(mode, ruled(Step.LOCK, verdict))
        assert undecided(flags(RUN, decided.steps)) == ()


def test_the_heaviest_flag_comes_first() -> None:
    run = replace(
        RUN,
        false_starts=(replace(TOUCH, accepted="nothing gained"), TOUCH),
        incidents=(Incident(140.0, IncidentKind.FALL),),
    )
    found = flags(run, source=SourceKind.SIMULATED)
    weights = [flag.weight for flag in found]
    assert weights == sorted(weights, key=lambda weight: -weight.rank)
    assert weights[0] is worst(found) is FlagWeight.ALARM
    assert FlagWeight.REMARK.rank < FlagWeight.CAUTION.rank < FlagWeight.ALARM.rank


@pytest.mark.parametrize(
    "run",
    [
        replace(RUN, outcome=Outcome.ABORTED),
        replace(RUN, voided=Voiding(170.0, "the door was jammed", "Ada")),
    ],
)
def test_there_is_nothing_to_decide_on_a_run_that_counts_nowhere(run: Run) -> None:
    touched = replace(run, false_starts=(TOUCH,))
    assert undecided(flags(touched, locking(LockDetection.REFEREE).steps)) == ()


def test_what_somebody_wrote_does_not_make_a_flag_too_long_to_be_read() -> None:
    run = replace(RUN, voided=Voiding(170.0, "why " * 500, "Ada"))
    (flag,) = flags(run)
    assert msgspec.json.decode(msgspec.json.encode(flag), type=Flag) == flag
    assert len(flag.words) <= LONGEST_WORDS


def a_result(run: Run, mode: LockDetection = LockDetection.SETTLE) -> Situation:
    return Situation(run, scored=True, steps=locking(mode).steps)


def test_nothing_undecided_is_signed_in_silence() -> None:
    run = replace(RUN, phase=Phase.STOPPED, false_starts=(TOUCH,))
    silent = Finalise(TeamWord.ACKNOWLEDGED, "Ada")
    refused = silent.refusal(a_result(run, LockDetection.REFEREE))
    assert refused is not None
    assert "1 false start UNDECIDED (handle touched)" in refused
    assert "step 6 UNDECIDED" in refused
    knowing = replace(silent, undecided=("1 false start UNDECIDED (handle touched)",))
    assert knowing.refusal(a_result(run)) is None
    refused = knowing.refusal(a_result(run, LockDetection.REFEREE))
    assert refused is not None
    assert "step 6 UNDECIDED" in refused
    assert "false start" not in refused


def test_what_was_decided_meanwhile_is_not_signed_as_undecided() -> None:
    run = replace(RUN, phase=Phase.STOPPED, false_starts=(TOUCH,))
    knowing = Finalise(TeamWord.ABSENT, "Ada", "", ("1 false start UNDECIDED (handle touched)",))
    decided = decide_false_starts(run, "nothing gained")
    assert knowing.refusal(a_result(decided)) == (
        "what was undecided is decided by now: look again"
    )
    assert Finalise(TeamWord.ABSENT, "Ada").refusal(a_result(decided)) is None


def test_a_flag_of_a_later_version_is_one_that_weighs() -> None:
    later = b'{"kind":"moon","words":"full","weight":"grave","undecided":false}'
    flag = msgspec.json.decode(later, type=Flag)
    assert flag == Flag(FlagKind.OTHER, "full", FlagWeight.ALARM)
