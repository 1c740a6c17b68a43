from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.referee.competition_plan import (
    MOST_LINES,
    Attempts,
    Plan,
    PlanLine,
    PlannedAttempt,
    PlanProgress,
    PlanSource,
    Task,
    delay,
    plan_progress,
    plan_remarks,
    read_plan,
)
from madrob_console.referee.lists import MOST_PROBLEMS
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Condition, Outcome
from tests.madrob_console.run_folders import summary

CUP = "Autumn Cup"
A, B, C = Task(3, 1), Task(4, 1), Task(3, 7)
TASKS = (A, B, C)

PLANS = st.builds(
    lambda lines: Plan(tuple(PlanLine(*line) for line in lines)),
    st.lists(st.tuples(st.sampled_from(TASKS), st.integers(1, 3)), max_size=6),
)
LEVELS = st.integers(0, 6)


@st.composite
def histories(draw: st.DrawFn) -> list[RunSummary]:
    """What a competition leaves: also practice, what was cut off, another competition's runs."""
    return [
        summary(
            *draw(st.sampled_from((*TASKS, Task(9, 20)))),
            run_number=number,
            hour=draw(st.integers(0, 5)),
            outcome=draw(st.none() | st.sampled_from(Outcome)),
            source=draw(st.sampled_from(["ros", "ros", "ros", "simulated", "replay", None])),
            competition=draw(st.sampled_from([CUP, CUP, CUP, "", "Spring Cup"])),
            problem=draw(st.sampled_from([None, None, None, "damaged"])),
            voided=draw(st.sampled_from([False, False, True])),
            values={"capability_level": draw(LEVELS)} if draw(st.booleans()) else {},
        )
        for number in range(1, draw(st.integers(0, 15)) + 1)
    ]


def plan(*lines: tuple[Task, int]) -> Plan:
    return Plan(tuple(PlanLine(*line) for line in lines))


def run(task: Task, hour: float = 0.0, level: int = 6, **fields: Any) -> RunSummary:  # noqa: ANN401
    return summary(*task, hour=hour, values={"capability_level": level}, **fields)


def progress(of: Plan, *runs: RunSummary) -> PlanProgress:
    return plan_progress(of, runs, CUP)


def uses_up(run: RunSummary) -> bool:
    """Whether a run uses up an attempt, as the protocol says (section 2)."""
    ended = run.outcome in (Outcome.COMPLETED, Outcome.TIMEOUT, Outcome.ABORTED)
    fault = run.outcome is Outcome.ABORTED and run.reason == "testbed fault"
    counts = ended and not fault and not run.voided and run.problem is None
    return counts and run.source == "ros" and run.competition == CUP


ABORTED: dict[str, Any] = {"outcome": Outcome.ABORTED}
NO_ATTEMPTS: list[dict[str, Any]] = [
    {"outcome": Outcome.INTERRUPTED},
    {"outcome": Outcome.ABORTED, "reason": "testbed fault"},
    {"outcome": None},
    {"voided": True},
    {"source": "simulated"},
    {"source": "replay"},
    {"problem": "damaged"},
    {"competition": "Spring Cup"},
]


@pytest.mark.parametrize(
    ("of", "runs", "lines", "others", "upcoming"),
    [
        (
            plan((A, 2), (B, 1)),
            [],
            [Attempts(A, 2), Attempts(B, 1)],
            [],
            [PlannedAttempt(A, 1, 2), PlannedAttempt(B, 1, 1)],
        ),
        (Plan(), [run(A)], [], [Attempts(A, 0, 1, 1, 6)], []),
        (  # in rounds the attempts of a team fill its lines in their order
            plan((A, 1), (B, 1), (A, 2)),
            [run(A, level=3), run(A, 1.0, level=5)],
            [Attempts(A, 1, 1, 1, 3), Attempts(B, 1), Attempts(A, 2, 1, 1, 5)],
            [],
            [PlannedAttempt(B, 1, 1), PlannedAttempt(A, 3, 3)],
        ),
        (  # an aborted run has used up its attempt
            plan((A, 1), (B, 1)),
            [run(A, **ABORTED)],
            [Attempts(A, 1, 1, 0, None), Attempts(B, 1)],
            [],
            [PlannedAttempt(B, 1, 1)],
        ),
        (  # and is repeated within the plan once
            plan((A, 1), (B, 1)),
            [run(A, **ABORTED), run(A, 1.0, run_number=2)],
            [Attempts(A, 1, 1, 1, 6), Attempts(B, 1)],
            [],
            [PlannedAttempt(B, 1, 1)],
        ),
        (
            plan((B, 1)),
            [run(A, level=2), run(B, level=4)],
            [Attempts(B, 1, 1, 1, 4)],
            [Attempts(A, 0, 1, 1, 2)],
            [],
        ),
        *(
            (plan((A, 1)), [run(A, **fields)], [Attempts(A, 1)], [], [PlannedAttempt(A, 1, 1)])
            for fields in NO_ATTEMPTS
        ),
        (
            plan((A, 1), (B, 1)),
            [run(A, voided=True, protest_filed=1.0), run(B, protest_filed=1.0)],
            [Attempts(A, 1, open_protests=1), Attempts(B, 1, 1, 1, 6, open_protests=1)],
            [],
            [PlannedAttempt(A, 1, 1)],
        ),
    ],
)
def test_the_lines_of_a_plan_are_filled_in_their_order(
    of: Plan,
    runs: list[RunSummary],
    lines: list[Attempts],
    others: list[Attempts],
    upcoming: list[PlannedAttempt],
) -> None:
    found = progress(of, *runs)
    assert list(found.lines) == lines
    assert [one for one in found.tasks if not one.planned] == others
    assert list(found.upcoming()) == upcoming
    assert found.next == (upcoming[0] if upcoming else None)


@pytest.mark.parametrize(
    ("of", "runs", "out"),
    [
        (Plan(), [run(A)], []),
        (plan((B, 1)), [run(A), run(B)], [A, B, Task(9, 9)]),  # B has had what is planned
        (plan((A, 1), (B, 1)), [run(A, **ABORTED)], [Task(9, 9)]),  # it may be repeated
        (plan((A, 1), (B, 1)), [run(A, **ABORTED), run(A, 1.0, run_number=2)], [A, Task(9, 9)]),
    ],
)
def test_who_has_had_what_is_planned_is_out_of_plan(
    of: Plan, runs: list[RunSummary], out: list[Task]
) -> None:
    found = progress(of, *runs)
    assert [task for task in (A, B, Task(9, 9)) if found.out_of_plan(task)] == out


def test_damaged_runs_are_counted_because_nobody_knows_what_they_are() -> None:
    assert progress(plan((A, 1)), run(A, problem="damaged"), run(B)).unread == 1


@given(PLANS, histories())
def test_every_attempt_of_any_history_is_counted_once(of: Plan, runs: list[RunSummary]) -> None:
    found = plan_progress(of, runs, CUP)
    counted = Counter(Task(run.subject, run.condition) for run in runs if uses_up(run))
    valid = Counter(Task(run.subject, run.condition) for run in runs if uses_up(run) and run.valid)
    planned: Counter[Task] = Counter()
    for line in of.lines:
        planned[line.task] += line.attempts
    for task in planned:  # a repeated attempt counts once
        counted[task] = max(valid[task], min(planned[task], counted[task]))
    counted = +counted
    assert {one.task: one.done for one in found.tasks if one.done} == counted
    assert {one.task: one.planned for one in found.tasks if one.planned} == planned
    for task in planned:
        lines = [line for line in found.lines if line.task == task]
        assert sum(line.done for line in lines) == counted[task]
        within = [line.done - line.beyond for line in lines]
        assert sum(within) == min(counted[task], planned[task])
        assert not any(line.beyond for line in lines[:-1])
        for earlier, later in pairwise(lines):
            assert not (earlier.left and later.done)
    for one in (*found.tasks, *found.lines):
        assert 0 <= one.valid <= one.done
        assert (one.best_level is None) or one.valid
    left = sum((planned - counted).values())
    assert found.left == sum(one.left for one in found.tasks) == left
    assert found == plan_progress(of, runs[::-1], CUP)  # whatever their order
    attempts = plan_progress(of, [run for run in runs if uses_up(run)], CUP)
    assert (found.tasks, found.lines) == (attempts.tasks, attempts.lines)


@given(PLANS, histories(), st.lists(st.sampled_from(Outcome), min_size=40, max_size=40))
def test_who_always_runs_what_is_next_has_done_the_plan(
    of: Plan, runs: list[RunSummary], outcomes: list[Outcome]
) -> None:
    """From any history: each attempt that counts is one less, none is ever out of plan."""
    for hour, outcome in enumerate(outcomes, start=10):
        before = plan_progress(of, runs, CUP)
        if before.next is None:
            break
        task, number, planned, _ = before.next
        assert not before.out_of_plan(task)
        assert 1 <= number <= planned
        runs = [*runs, run(task, hour, run_number=hour, outcome=outcome)]
        counts = outcome is not Outcome.INTERRUPTED
        after = plan_progress(of, runs, CUP)
        assert after.left == before.left - counts
        assert counts or after.next == before.next


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "plan.csv"


def read(file: Path, text: str | bytes) -> Plan:
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_plan(file)


USUAL = (
    "3,1,2\n4,1,1\n3,7,1\n",
    "subject,condition,attempts\r\n3,1,2\r\n4,1\r\n3,7\r\n",
    'Subject;Condition;Attempts\n# morning\n003; 01 ;2\n\n"4";1;1;\n3;7;1',
)
KINDS = [Condition.from_number(number) for number in range(1, 21)]
CONDITIONS = [
    (kind.number, words)
    for kind in KINDS
    for words in (
        str(kind.number),
        f'"{kind.way.partition(" to ")[0]}, {kind.benchmark_type}"',
        f'"{kind.benchmark_type.upper()}, {kind.way}"',
    )
]
FAR = "2026-11-25T14:30+05:00"
"""A time of another zone."""
MOMENTS = {
    "9:05": "09:05",
    "14:30": "14:30",
    "2026-11-25T14:30": "2026-11-25 14:30",
    "2026-11-25 14:30:10": "2026-11-25 14:30",
    FAR: f"{datetime.fromisoformat(FAR).astimezone():%Y-%m-%d %H:%M}",
}
TIMES = [
    (text, time)
    for typed, time in MOMENTS.items()
    for text in (f"subject,time,condition\n3,{typed},1\n", f"3,1,1,{typed}\n")
]
READ = plan((A, 2), (B, 1), (C, 1)).lines


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        *((text, READ) for text in USUAL),
        *((f"3,{words}", plan((Task(3, number), 1)).lines) for number, words in CONDITIONS),
        *((text, (PlanLine(A, 1, time),)) for text, time in TIMES),
    ],
)
def test_every_usual_way_to_write_a_plan_is_read(
    file: Path, text: str, lines: tuple[PlanLine, ...]
) -> None:
    assert read(file, text) == Plan(lines, (), str(file))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x,1,1", "subject 'x' is no number from 1 to 999: write one"),
        ("1000,1,1", "subject '1000' is no number from 1 to 999: write one"),
        ("3", "subject 3 has no condition: add it"),
        ("3,", "subject 3 has no condition: add it"),
        ("3,-1,1", "there is no condition '-1': see `madrob plan --conditions`"),
        ("3,0,1", "there is no condition '0': see `madrob plan --conditions`"),
        ("3,21,1", "there is no condition '21': see `madrob plan --conditions`"),
        ("3,No Force,1", "there is no condition 'No Force': see `madrob plan --conditions`"),
        (
            '3,"push, from CCW",1',
            (
                "condition 'push, from CCW': benchmark type missing; "
                "did you mean 'push, from CCW, No Force'?"
            ),
        ),
        (
            '3,"pull, from CW, Suden Force",1',
            "condition 'pull, from CW, Su...': did you mean 'pull, from CW, Sudden Force'?",
        ),
        ("3,٤,1", "there is no condition '٤': see `madrob plan --conditions`"),
        ("3,1,0", "attempts '0' is no number from 1 to 99: write one"),
        ("3,1,100", "attempts '100' is no number from 1 to 99: write one"),
        (
            "3,1," + "9" * 5000,
            "attempts '99999999999999999...' is no number from 1 to 99: write one",
        ),
        ("3,1,1,Delft", "4 values, use subject, condition, attempts; quote one with a separator"),
        ('3,1,"2', 'a quote (") is not closed: close it'),
    ],
)
def test_a_bad_line_is_named_and_the_others_count(file: Path, text: str, problem: str) -> None:
    found = read(file, f"subject,condition,attempts\n3,1,2\n{text}\n4,1,1\n")
    assert found.lines == plan((A, 2), (B, 1)).lines
    assert found.problems == (f"plan.csv line 3: {problem}",)


@pytest.mark.parametrize(
    ("planned", "late"),
    [
        ("", 0.0),
        ("14:30", 750.0),
        ("14:42", 30.0),
        ("15:00", 0.0),
        ("2026-11-25 14:30", 750.0),
        ("23:50", 0.0),
        ("03:00", 42_150.0),
        ("2026-11-24 14:42", 0.0),
        ("2026-11-26 14:30", 0.0),
    ],
)
def test_a_planned_time_tells_how_late_it_is(planned: str, late: float) -> None:
    assert delay(planned, datetime(2026, 11, 25, 14, 42, 30).timestamp()) == late  # noqa: DTZ001


@pytest.mark.parametrize(
    ("planned", "hour", "minute", "late"),
    [("23:50", 0, 5, 900.0), ("00:20", 23, 55, 0.0), ("00:20", 0, 21, 60.0)],
)
def test_a_plan_past_midnight_is_no_day_off(
    planned: str, hour: int, minute: int, late: float
) -> None:
    at = datetime(2026, 11, 25, hour, minute).timestamp()  # noqa: DTZ001  of the place
    assert delay(planned, at) == late


def test_the_first_attempt_of_a_line_has_its_time_and_tells_the_last_delay() -> None:
    begun = run(A, hour=1)
    in_time = f"{datetime.fromtimestamp(begun.started - 720):%Y-%m-%d %H:%M}"  # noqa: DTZ006
    of = Plan((PlanLine(A, 2, in_time), PlanLine(B, 1, "15:00")))
    before = progress(of)
    assert [one.time for one in before.upcoming()] == [in_time, "15:00"]
    assert before.last_delay == 0.0
    found = progress(of, begun)
    assert [one.time for one in found.upcoming()] == ["", "15:00"]
    assert 720 <= found.last_delay < 780


@pytest.mark.parametrize(
    ("running", "following"),
    [
        (None, [(A, 1), (B, 1), (A, 3)]),
        (A, [(A, 2), (B, 1), (A, 3)]),
        (B, [(A, 1), (A, 3)]),
        (C, [(A, 1), (B, 1), (A, 3)]),
    ],
)
def test_what_goes_on_is_not_what_comes_next(
    running: Task | None, following: list[tuple[Task, int]]
) -> None:
    found = progress(plan((A, 2), (B, 1), (A, 1)))
    assert [(one.task, one.number) for one in found.upcoming(running)] == following
    assert list(progress(plan((A, 1), (A, 1)), run(A)).upcoming(A)) == []


@pytest.mark.parametrize("text", ["soon", "25:00", "14", "2026-11-25", "0226-11-25T14:30"])
def test_what_is_no_time_is_named_and_its_line_counts_without(file: Path, text: str) -> None:
    why = (
        f"time '{text}' cannot be read: write 14:30 or 2026-11-25T14:30; the line counts without it"
    )
    remark = f"plan.csv line 1: {why}"
    assert read(file, f"4,1,1,{text}\n") == Plan(
        plan((B, 1)).lines, file=str(file), remarks=(remark,)
    )


@pytest.fixture
def central_europe(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("central_europe")
@pytest.mark.parametrize(
    ("text", "planned", "remark"),
    [
        ("2026-03-29T01:30", "2026-03-29 01:30", ""),
        ("2026-10-25T03:30", "2026-10-25 03:30", ""),
        ("2026-03-29T02:30", "", "'2026-03-29T02:30' does not come, clocks change then"),
        ("2026-10-25T02:30", "2026-10-25 02:30", "'2026-10-25 02:30' comes twice, clocks change"),
        ("2026-10-25T01:30Z", "2026-10-25 02:30", "'2026-10-25 02:30' comes twice, clocks change"),
    ],
)
def test_a_time_that_a_day_lacks_or_has_twice_is_named(
    file: Path, text: str, planned: str, remark: str
) -> None:
    found = read(file, f"4,1,1,{text}\n")
    assert [line.time for line in found.lines] == [planned]
    assert [words.partition(remark)[0] for words in found.remarks] == (
        ["plan.csv line 1: time "] if remark else []
    )


@pytest.mark.parametrize(
    ("times", "remarks"),
    [
        (("", "", ""), []),
        (("09:00", "09:10", "09:20"), []),
        (("09:00", "", "09:20"), []),
        (("09:00", "", "09:19"), ["the plan cannot be kept at 09:00: 19 min for 4 x 300 s"]),
        (
            ("09:00", "09:04", "09:08"),
            ["the plan cannot be kept at 09:00: 4 min for 2 x 300 s (and 1 more)"],
        ),
        (("23:00", "00:01", ""), []),
        (("2026-11-25 23:55", "2026-11-26 00:05", ""), []),
        (
            ("2026-11-25 23:55", "2026-11-26 00:04", ""),
            ["the plan cannot be kept at 2026-11-25 23:55: 9 min for 2 x 300 s"],
        ),
    ],
)
def test_a_plan_that_cannot_be_kept_is_named_once(
    times: Sequence[str], remarks: Sequence[str]
) -> None:
    lines = [PlanLine(A, 2, time) for time in times]
    assert list(plan_remarks(lines, {}, 300.0)) == remarks


def test_a_line_that_cannot_be_used_is_of_its_team_or_of_any(file: Path) -> None:
    found = read(file, "3,1,1\n7,99,1\n7,98,1\n")
    assert found.unusable_line(7).startswith("plan.csv line 2: there is no condition '99'")
    assert found.unusable_line(3) == ""
    found = read(file, "3,1,1\nseven,1,1\n")
    assert found.unusable_line(3).startswith("plan.csv line 2: subject 'seven' is no number")


def test_a_plan_has_an_end(file: Path) -> None:
    found = read(file, "3,1\n" * (MOST_LINES + 50))
    assert len(found.lines) == MOST_LINES
    first, *_, last = found.problems
    assert first == "plan.csv line 2001: a plan has 2000 lines at most, this one is left out"
    assert last == f"and {50 - MOST_PROBLEMS} more such lines"


def test_a_file_that_is_no_plan_is_refused_with_what_names_it(file: Path) -> None:
    with pytest.raises(MadrobError, match=r"^plan .*No such file.*; correct file of \[plan\]$"):
        read_plan(file)


def test_a_plan_stays_while_its_file_cannot_be_read(file: Path) -> None:
    source = PlanSource(file=file)
    first = source.read()
    assert (first.lines, len(first.problems)) == ((), 1)
    file.write_text("3,1,2\n")
    known = source.read(first)
    assert known.lines == plan((A, 2)).lines
    assert known.problems == ()
    for spoil in (lambda: file.write_text(""), file.unlink):
        spoil()
        kept = source.read(known)
        assert kept.lines == known.lines
        assert kept.problems[0].endswith("; the plan stays as it was")
    file.write_text("4,1\n")
    assert source.read(kept) == Plan(plan((B, 1)).lines, (), str(file))


@given(
    st.binary(max_size=80)
    | st.text(alphabet='0123,;"# \n\rx門\x00\x1b', max_size=80).map(str.encode)
)
def test_no_content_is_too_strange(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    try:
        found = read(tmp_path_factory.getbasetemp() / "any_plan.csv", data)
    except MadrobError as error:
        assert "no text" in str(error)  # noqa: PT017  either is right, a traceback is not
        return
    for (subject, condition), attempts, _ in found.lines:
        assert 1 <= subject <= 999
        assert 1 <= condition <= 20
        assert 1 <= attempts <= 99
    assert all("\n" not in problem and problem.isprintable() for problem in found.problems)
