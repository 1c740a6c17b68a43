"""The journal: on disk before it takes effect, readable whatever happened to its end."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.referee.acts import Finalise, SetUp, Situation, act_details
from madrob_console.referee.evidence import Evidence, EvidenceTopic
from madrob_console.referee.flags import (
    LONGEST_WORDS,
    Flag,
    FlagKind,
    FlagWeight,
    data_remarks,
    flags,
    worst,
)
from madrob_console.referee.journal import Entry, Journal, Origin, read_journal, up_to_date
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import (
    CheckName,
    Closure,
    FalseStart,
    FaultKind,
    Incident,
    IncidentKind,
    Reissuing,
    TeamWord,
    Voiding,
    Waiver,
    merged,
)
from madrob_console.referee.records import TestbedFault as Fault
from madrob_console.referee.run import Phase, Run
from scoring.procedure import Evidence as Observed
from scoring.procedure import Ruling, StepRecord, follow_procedure
from scoring.protocol import EventName, LockDetection, Outcome, Signal, Step
from scoring.quality import Quality, SignalQuality
from tests.madrob_console.referee.test_acts import SETUP
from tests.madrob_console.ui.prepared import a_setup

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


@given(st.lists(entries, max_size=5))
@example([Entry(1.0, Origin.REFEREE, "note", reason="\u2028a\x85b\u2029c\udcff")])
def test_lines_come_back_from_the_file_as_they_were(lines: list[Entry]) -> None:
    with opened() as (journal, path):
        assert journal.append(lines) == len(lines)
        assert read_all_lines(path) == [entry for entry in lines if entry.what != "withdrawn"]


@given(st.text())
def test_what_is_no_line_raises_nothing_but_our_error(text: str) -> None:
    with suppress(MadrobError):
        Entry.from_json(text)


def line(number: int) -> Entry:
    return Entry(float(number), Origin.SYSTEM, f"line {number}")


@contextmanager
def opened() -> Iterator[tuple[Journal, Path]]:
    with TemporaryDirectory() as folder:
        journal, path = Journal(), Path(folder) / "journal.jsonl"
        journal.open(path)
        yield journal, path
        journal.close()


def read_all_lines(path: Path) -> list[Entry]:
    """What stands, without the lines that withdraw others."""
    return [entry for entry in read_journal(path)[0] if entry.what != "withdrawn"]


def broken(*_arguments: object) -> None:
    raise OSError(5, "Input/output error")


@given(
    st.lists(
        st.tuples(st.integers(1, 3), st.sampled_from([9, 9, 0, 1]), st.booleans(), st.booleans()),
        max_size=8,
    )
)
def test_whatever_the_disk_refuses_what_it_was_said_to_have_stands_and_nothing_else(
    steps: list[tuple[int, int, bool, bool]],
) -> None:
    """Each step adds lines; `room` of them fit, else a part; a sync or a truncation may fail."""
    stands: list[Entry] = []
    write, numbers = os.write, count()
    with opened() as (journal, path):
        for many, room, syncs, truncates in steps:
            left = [room]

            def limited(file: int, data: bytes, left: list[int] = left) -> int:
                if threading.current_thread() is not threading.main_thread():
                    return write(file, data)
                left[0] -= 1
                return write(file, data if left[0] >= 0 else data[: len(data) // 2])

            lines = [line(next(numbers)) for _ in range(many)]
            with pytest.MonkeyPatch.context() as sick:
                sick.setattr(os, "write", limited)
                sick.setattr(os, "fsync", (lambda _: None) if syncs else broken)
                sick.setattr(os, "ftruncate", os.ftruncate if truncates else broken)
                on_disk = journal.append(lines)
            assert on_disk in ((0, min(many, room)) if syncs else (0,))
            assert (journal.refused is None) == (on_disk == many)
            stands += lines[:on_disk]
            assert read_all_lines(path)[: len(stands)] == stands
        assert journal.append([line(-1), line(-2)]) == 2
        assert read_all_lines(path) == [*stands, line(-1), line(-2)]


def test_several_lines_are_brought_to_the_disk_by_one_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with opened() as (journal, _):
        assert (journal.append([line(0), line(1)]), journal.append([])) == (2, 0)
    assert len(synced) == 1


def test_a_torn_last_line_is_set_aside_and_the_journal_goes_on_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    lines = [line(0), line(1)]
    whole = "".join(one.to_json() + "\n" for one in lines).encode()
    for cut in range(len(whole)):
        path.write_bytes(whole[:cut])
        found, remarks = read_journal(path)
        assert list(found) == lines[: len(found)]
        torn = whole[:cut].splitlines()[len(found) :]
        assert len(remarks) == len(torn)
        up_to_date(path, lines).close()
        assert list(read_journal(path)[0]) == lines


def test_an_existing_journal_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        Journal().open(path)
    Journal().close()  # none was opened
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


SET_UP = Entry(1.0, Origin.REFEREE, "set up", details=act_details(SetUp(SETUP)))
STARTED = [
    SET_UP,
    Entry(2.0, Origin.CLOCK, Change.COUNTDOWN_BEGINS, details={"time": 2.0}),
    Entry(7.0, Origin.CLOCK, Change.RUN_STARTS, details={"time": 7.0}),
]
STOPPED = [
    *STARTED,
    Entry(
        20.0, Origin.CLOCK, Change.RUN_STOPS, reason="done",
        details={"outcome": "completed", "time": 19.0},
    ),
]  # fmt: skip


def told(what: str, reason: str = "", **details: Any) -> Entry:  # noqa: ANN401
    return Entry(21.0, Origin.SYSTEM, what, "Ada", reason, details)


@pytest.mark.parametrize(
    ("entries", "fields"),
    [
        ([SET_UP, Entry(2.0, Origin.REFEREE, "start")], {"phase": Phase.COUNTDOWN, "start": 7.0}),
        ([SET_UP, Entry(2.0, Origin.REFEREE, "start", id="a")], {"phase": Phase.READY}),
        ([Entry(2.0, Origin.REFEREE, "start")], {"phase": Phase.IDLE}),
        (STARTED, {"phase": Phase.RUNNING, "start": 7.0, "setup": SETUP, "handle_zero": 5.9}),
        (
            [*STARTED, told(Change.TIMEOUT_ELAPSED, "300 s", time=18.0)],
            {"timeout_at": 18.0, "outcome_reason": "300 s"},
        ),
        (
            STOPPED,
            {"phase": Phase.STOPPED, "outcome": Outcome.COMPLETED, "outcome_reason": "done"},
        ),
        (STOPPED, {"stop": 19.0, "start": 7.0}),
        ([*STARTED, told(Change.ROBOT_STARTS, time=7.5)], {"robot_start": 7.5}),
        (
            [*STARTED, told(Change.FALSE_START, time=6.0, event="door_opens")],
            {"false_starts": (FalseStart(6.0, EventName.DOOR_OPENS),)},
        ),
        ([*STOPPED, told(Change.UNRECORDED, messages=3)], {"unrecorded": 3}),
        ([*STOPPED, told(Change.UNRECORDED, messages=-3)], {"unrecorded": 0}),
        (
            [*STOPPED, told(Change.EVIDENCE_RECORDED, topics={"/tf": {"recorded": 7, "lost": 1}})],
            {"evidence": Evidence({"/tf": EvidenceTopic(7, 1)})},
        ),
        ([*STOPPED, told(Change.RESULT_WRITTEN, issue=2)], {"issue": 2}),
        (
            [*STOPPED, told(Change.REISSUED, "new rules", ruleset="robust-2026")],
            {
                "issue": 2,
                "ruleset": "robust-2026",
                "changed": 21.0,
                "reissues": (
                    Reissuing(21.0, 2, Change.REISSUED, "new rules", "Ada", "robust-2026"),
                ),
            },
        ),
        ([*STARTED, told(Change.REISSUED, "new rules")], {"issue": 0}),
        ([*STOPPED, told(Change.REISSUED, "new rules")], {"issue": 2, "ruleset": None}),
        ([*STARTED, told("of a later version")], {"phase": Phase.RUNNING}),
        (
            [
                told(Change.FAULT, "door angle: silent for 1.0 s", time=100.5, kind="silent"),
                told(Change.FAULT, "all: silent for 3.0 s", time=100.5, kind="silent"),
                told(Change.FAULT, "of a later version", time=100.5, kind="moon"),
            ],
            {
                "faults": (
                    Fault(100.5, "all: silent for 3.0 s", FaultKind.SILENT),
                    Fault(100.5, "of a later version"),
                )
            },
        ),
    ],
)
def test_the_state_is_rebuilt_from_the_journal(
    entries: list[Entry], fields: dict[str, object]
) -> None:
    run = rebuild([Entry.from_json(entry.to_json()) for entry in entries], handle_zero=5.9)
    assert {name: getattr(run, name) for name in fields} == fields


@pytest.mark.parametrize(
    "entry",
    [
        Entry(1.0, Origin.REFEREE, "rule on a step", details={"step": 9}),
        Entry(1.0, Origin.CLOCK, "run stops", details={"outcome": "won"}),
        Entry(1.0, Origin.CLOCK, "robot starts", details={"time": -1.0}),
        Entry(1.0, Origin.CLOCK, "result written"),
    ],
)
def test_a_damaged_line_is_named(entry: Entry) -> None:
    with pytest.raises(MadrobError, match=entry.what):
        rebuild([entry])


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
ACCEPTED = replace(TOUCH, accepted="nothing gained")
FALL = Incident(140.0, IncidentKind.FALL)
VOID = Voiding(170.0, "the door was jammed", "Ada")
REMARK, CAUTION, ALARM = FlagWeight


def ruled(step: Step, confirmed: bool | None) -> Ruling:
    return Ruling(step, confirmed, 160.0, "seen on video", "Ada")


def late(time: float) -> Fault:
    return Fault(time, "all 6 topics: stamps 0.12 s late, for 1.0 s", FaultKind.SKEW)


def waived(*checks: CheckName) -> tuple[Waiver, ...]:
    return tuple(Waiver(check, "known", "Ada", 90.0) for check in checks)


def locking(mode: LockDetection, *rulings: Ruling) -> tuple[StepRecord, ...]:
    """Five steps done; only the referee can say whether the door is locked."""
    observed = Observed(100.0, 150.0, None, (), None, (), latch_before_start=False, crossed=None)
    every = (*(ruled(step, True) for step in list(Step)[:5]), *rulings)
    return follow_procedure(observed, lock_detection=mode, settle_time=1.0, rulings=every).steps


def a_signal(signal: Signal = Signal.DOOR, gap: float = 0.021) -> SignalQuality:
    return SignalQuality(signal, 900, 50.0, gap, 0, 0.0002, 0, 0, 0, 0.01)


def flagged(run: Run, *found: tuple[str, FlagWeight], **known: object) -> object:
    """A row: the flags of a run, the heaviest first, by their words and weights."""
    return pytest.param(run, known, list(found), id=found[0][0] if found else "none")


def seen(*signals: SignalQuality, words: str = "") -> object:
    found = [(words, CAUTION)] if words else []
    return flagged(RUN, *found, quality=Quality(signals))


@pytest.mark.parametrize(
    ("run", "known", "found"),
    [
        flagged(
            replace(RUN, setup=replace(a_setup(), team_reason="renamed since")),
            ("team's name other than the list's: renamed since", REMARK),
        ),
        flagged(
            replace(RUN, setup=replace(a_setup(), out_of_plan=True)),
            ("out of plan: more than the competition planned", CAUTION),
        ),
        flagged(
            replace(RUN, false_starts=(TOUCH,)),
            ("1 false start UNDECIDED (handle touched)", ALARM),
        ),
        flagged(
            replace(RUN, false_starts=(TOUCH, FalseStart(99.0, EventName.DOOR_OPENS), TOUCH)),
            ("3 false starts UNDECIDED (first: handle touched)", ALARM),
        ),
        flagged(replace(RUN, false_starts=(ACCEPTED,)), ("1 false start accepted", REMARK)),
        flagged(replace(RUN, faults=(late(99.0), late(101.0))), ("2 testbed faults", REMARK)),
        flagged(
            replace(RUN, faults=(late(99.0), Fault(101.0, "door angle: silent"))),
            ("2 testbed faults", CAUTION),
        ),
        flagged(
            replace(RUN, faults=(Fault(99.0, "keep one", FaultKind.SEVERAL_PUBLISHERS),)),
            ("1 testbed fault", CAUTION),
        ),
        flagged(
            replace(RUN, unrecorded=1),
            ("the recording lacks 1 message: the result cannot be made again from it", CAUTION),
        ),
        flagged(replace(RUN, incidents=(FALL,)), ("1 incident (fall)", REMARK)),
        flagged(
            replace(RUN, waivers=waived(CheckName.CLOCK)), ("check waived: clock skew", REMARK)
        ),
        flagged(
            replace(RUN, waivers=waived(CheckName.CLOCK, CheckName.POSE)),
            ("check waived: clock skew, start pose", CAUTION),
        ),
        flagged(replace(RUN, voided=VOID), ("VOID, does not count (the door was jammed)", CAUTION)),
        flagged(
            replace(RUN, rulings=(ruled(Step.OPEN, False), ruled(Step.CROSS, False))),
            ("steps 3, 4 denied", CAUTION),
        ),
        flagged(
            replace(RUN, rulings=(ruled(Step.CROSS, False), ruled(Step.CROSS, True))),
            ("step 4 confirmed", CAUTION),
        ),
        flagged(
            replace(RUN, closure=Closure(170.0, "Ada", TeamWord.PROTESTED)),
            ("PROTESTED by the team", CAUTION),
        ),
        flagged(  # what was taken back is none
            replace(
                RUN,
                rulings=(ruled(Step.CROSS, False), ruled(Step.CROSS, None)),
                closure=Closure(170.0, "Ada", TeamWord.ACKNOWLEDGED),
            ),
            source=SourceKind.ROS,
        ),
        flagged(
            replace(RUN, false_starts=(ACCEPTED, TOUCH), incidents=(FALL,), unrecorded=1),
            ("1 false start UNDECIDED (handle touched)", ALARM),
            ("the recording lacks 1 message: the result cannot be made again from it", CAUTION),
            ("1 false start accepted", REMARK),
            ("SIMULATED: not an official result", REMARK),
            ("1 incident (fall)", REMARK),
            source=SourceKind.SIMULATED,
        ),
        seen(a_signal(gap=0.5)),
        seen(a_signal(gap=0.51), words="door angle: no sample for 0.5 s"),
        seen(replace(a_signal(), ends_early=3.0), words="door angle: no sample for 3.0 s"),
        seen(replace(a_signal(), begins_late=3.0), words="door angle: no sample for 3.0 s"),
        seen(
            replace(a_signal(), samples=0, largest_gap=None), words="door angle: nothing recorded"
        ),
        seen(replace(a_signal(), shifted=9), words="door angle: clock stepped, stamps shifted"),
        seen(a_signal(Signal.LATCH, 9.0)),
        seen(
            *(a_signal(signal, 3.0) for signal in (Signal.DOOR, Signal.HANDLE)),
            words="door angle, handle force: no sample for 3.0 s",
        ),
        seen(
            *(a_signal(signal, 1.0 + at) for at, signal in enumerate(NEEDED)),
            words="all 6 topics: no sample for 6.0 s",
        ),
        *(
            flagged(
                replace(RUN, **void),  # there is nothing to decide on a run that counts nowhere
                *found,
                steps=locking(LockDetection.REFEREE),
            )
            for void, found in (
                ({"outcome": Outcome.ABORTED}, ()),
                ({"voided": VOID}, [("VOID, does not count (the door was jammed)", CAUTION)]),
            )
        ),
        *(
            flagged(RUN, (f"step 6 UNDECIDED ({why})", ALARM), steps=locking(mode))
            for mode, why in (
                (LockDetection.REFEREE, "the referee confirms the lock"),
                (LockDetection.SENSOR, "latch sensor silent: the referee decides"),
            )
        ),
        *(
            flagged(RUN, steps=locking(LockDetection.REFEREE, ruled(Step.LOCK, verdict)))
            for verdict in (True, False)
        ),
    ],
)
def test_what_a_decision_hangs_on_is_a_flag_and_the_heaviest_comes_first(
    run: Run, known: dict[str, Any], found: list[tuple[str, FlagWeight]]
) -> None:
    flagged = flags(run, **known)
    assert [(flag.words, flag.weight) for flag in flagged] == found
    assert all(flag.undecided == ("UNDECIDED" in flag.words) for flag in flagged)
    assert worst(flagged) is (found[0][1] if found else None)
    assert REMARK.rank < CAUTION.rank < ALARM.rank


def test_one_cause_on_all_signals_is_one_remark() -> None:
    late = [
        replace(a_signal(signal), skew=at / 10, skewed=True) for at, signal in enumerate(NEEDED)
    ]
    quality = Quality((*late,), remarks=("the bag is torn",), lost=("/a: 3 messages were lost",))
    assert data_remarks(quality) == [
        "all 6 topics: stamps differ from reception by up to 0.500 s",
        "the bag is torn",
        "/a: 3 messages were lost",
    ]


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


def test_what_somebody_wrote_does_not_make_a_flag_too_long_to_be_read() -> None:
    (flag,) = flags(replace(RUN, voided=replace(VOID, reason="why " * 500)))
    assert msgspec.json.decode(msgspec.json.encode(flag), type=Flag) == flag
    assert len(flag.words) <= LONGEST_WORDS


FALSE_START = "1 false start UNDECIDED (handle touched)"
STEP = "step 6 UNDECIDED (the referee confirms the lock)"
NOT_DECIDED = replace(RUN, phase=Phase.STOPPED, false_starts=(TOUCH,))
DECIDED = replace(NOT_DECIDED, false_starts=(ACCEPTED,))


@pytest.mark.parametrize(
    ("run", "mode", "knowing", "words"),
    [
        (
            NOT_DECIDED,
            LockDetection.REFEREE,
            (),
            f"decide it first, or sign it knowing so: {FALSE_START}; {STEP}",
        ),
        (NOT_DECIDED, LockDetection.SETTLE, (FALSE_START,), None),
        (
            NOT_DECIDED,
            LockDetection.REFEREE,
            (FALSE_START,),
            f"decide it first, or sign it knowing so: {STEP}",
        ),
        (
            DECIDED,
            LockDetection.SETTLE,
            (FALSE_START,),
            "what was undecided is decided by now: look again",
        ),
        (DECIDED, LockDetection.SETTLE, (), None),
    ],
)
def test_nothing_is_signed_but_what_the_referee_knows(
    run: Run, mode: LockDetection, knowing: tuple[str, ...], words: str | None
) -> None:
    here = Situation(run, scored=True, steps=locking(mode))
    assert Finalise(TeamWord.ABSENT, "Ada", "", knowing).refusal(here) == words


def test_a_flag_of_a_later_version_is_one_that_weighs() -> None:
    later = b'{"kind":"moon","words":"full","weight":"grave","undecided":false}'
    flag = msgspec.json.decode(later, type=Flag)
    assert flag == Flag(FlagKind.OTHER, "full", FlagWeight.ALARM)


@pytest.mark.machine
def test_a_process_that_was_starting_does_not_hold_a_closed_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = Journal()
    journal.open(path)
    opened = [int(n.name) for n in Path("/proc/self/fd").iterdir() if n.resolve() == path]
    with subprocess.Popen(["sleep", "60"], pass_fds=opened) as process:
        journal.close()
        held = is_held(path)
        process.kill()
    assert opened
    assert not held
