"""A competition's plan: who does what, in which order, and how much of it is done.

A line of the plan is a team, a condition (its number or its words), a number of attempts and the
time for which it is planned; the last two may be missing. The same team and condition may
stand in several lines, as in rounds. An attempt is done when the run is official, of this
competition, and has ended as completed, timeout or aborted. A run that was interrupted, voided or
aborted for a testbed fault is no attempt, so that it comes next again; practice never is one. An
attempt that is repeated after an abort counts once (protocol section 2).
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import format_duration, listed
from madrob_console.common.names import terminal_safe
from madrob_console.referee.lists import ListReader, first_problems, quoted
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome, Step

MOST_LINES = 2000
"""Lines of a plan; further ones are ignored."""
MOST_ATTEMPTS = 99

_ATTEMPTS = re.compile("0*([1-9][0-9]?)")

_MOST_NAMED = 10

CORRECT_SETTINGS = "correct file of [plan]"

_LEVELS = range(len(Step) + 1)
TESTBED_FAULT = "testbed fault"
"""The reason of an abort that uses up no attempt."""

_LATEST = 12 * 3600.0
"""s; what is later than that is of another day."""

_ENDED = (Outcome.COMPLETED, Outcome.TIMEOUT)


class Task(NamedTuple):
    """A team in a condition, by their numbers."""

    subject: int
    condition: int


class PlanLine(NamedTuple):
    """One line of the plan."""

    task: Task
    attempts: int
    time: str = ""
    """`HH:MM` or `YYYY-MM-DD HH:MM`, of the place; empty = none is planned."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A plan, in running order; without lines there is none.

    `problems` name what cannot be used, `remarks` what is odd and counts. `unusable` has the first
    problem of each subject; 0 = the subject cannot be read.
    """

    lines: tuple[PlanLine, ...] = ()
    problems: tuple[str, ...] = ()
    file: str = ""
    remarks: tuple[str, ...] = ()
    unusable: Mapping[int, str] = field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self.problems, *self.remarks)

    def unusable_line(self, subject: int) -> str:
        """A line that cannot be used and is, or may be, of this subject; empty = there is none."""
        return self.unusable.get(subject) or self.unusable.get(0, "")


NO_PLAN = Plan()


@dataclass(frozen=True, slots=True)
class Attempts:
    """The attempts of a team in a condition: all of them, or those of one line of the plan.

    `planned` is 0 out of plan. `best_level` is of the valid ones. With `open_protests`, which also
    count runs that are no attempt, nothing here is final. `time` is that of the line, `began`
    the start of its first attempt, s since the epoch.
    """

    task: Task
    planned: int = 0
    done: int = 0
    valid: int = 0
    best_level: int | None = None
    open_protests: int = 0
    time: str = ""
    began: float | None = None

    @property
    def left(self) -> int:
        return max(0, self.planned - self.done)

    @property
    def beyond(self) -> int:
        """How many of those that are done were not planned, in a line or task that has a plan."""
        return max(0, self.done - self.planned) if self.planned else 0


class PlannedAttempt(NamedTuple):
    """One attempt that is left, `number` of `planned` of the team in the condition, from 1.

    `time` is planned for the first attempt of a line; empty = none is.
    """

    task: Task
    number: int
    planned: int
    time: str = ""


@dataclass(frozen=True, slots=True)
class PlanProgress:
    """How much of a plan is done.

    The attempts of a task fill its `lines` in their order, the last takes those beyond the plan.
    `tasks` has planned ones first. `unread` counts runs with a damaged result.
    """

    lines: tuple[Attempts, ...] = ()
    tasks: tuple[Attempts, ...] = ()
    problems: tuple[str, ...] = ()
    unread: int = 0

    @property
    def planned(self) -> int:
        return sum(line.planned for line in self.lines)

    @property
    def left(self) -> int:
        return sum(line.left for line in self.lines)

    def upcoming(self, running: Task | None = None) -> Iterator[PlannedAttempt]:
        """The next attempt of each unfinished line, in the order of the plan.

        Without the attempt that goes on, where one of `running` does.
        """
        of_task = {attempts.task: attempts for attempts in self.tasks}
        before: dict[Task, int] = defaultdict(int)
        for line in self.lines:
            now = line.left > 0 and line.task == running
            running = None if now else running
            if line.left > now:
                number = before[line.task] + line.done + now + 1
                time = "" if line.done or now else line.time
                yield PlannedAttempt(line.task, number, of_task[line.task].planned, time)
            before[line.task] += line.planned

    @property
    def next(self) -> PlannedAttempt | None:
        return next(self.upcoming(), None)

    @property
    def finished(self) -> bool:
        """Whether there is a plan and all of it is done."""
        return bool(self.lines) and not self.left

    def attempt(self, task: Task) -> str:
        """Return which attempt a run of this task is, `attempt 1 of 2`; empty = out of plan."""
        for attempts in self.tasks:
            if attempts.task == task and attempts.left:
                return f"attempt {attempts.done + 1} of {attempts.planned}"
        return ""

    @property
    def last_delay(self) -> float:
        """How late the latest attempt with a planned time began, s."""
        begun = [(line.began, line.time) for line in self.lines if line.began is not None]
        return max((at, delay(planned, at)) for at, planned in begun)[1] if begun else 0.0

    def out_of_plan(self, task: Task) -> bool:
        """Whether another run exceeds the plan; repeating an invalid attempt does not."""
        attempts = next((each for each in self.tasks if each.task == task), Attempts(task))
        return bool(self.lines) and attempts.valid >= attempts.planned


def plan_progress(plan: Plan, runs: Iterable[RunSummary], competition: str) -> PlanProgress:
    """Counts the runs of a competition; an empty name means the runs without one."""
    done: dict[Task, list[RunSummary]] = {line.task: [] for line in plan.lines}
    unread, protested = 0, Counter[Task]()
    for run in sorted(runs, key=lambda run: (run.started, run.folder)):
        unread += run.problem is not None
        if run.protest_filed is not None and run.official and run.competition == competition:
            protested[Task(run.subject, run.condition)] += 1
        if is_attempt(run) and run.competition == competition:
            done.setdefault(Task(run.subject, run.condition), []).append(run)
    of_plan = Counter[Task]()
    for line in plan.lines:
        of_plan[line.task] += line.attempts
    done = {task: _counted(of_task, of_plan[task]) for task, of_task in done.items()}
    planned: dict[Task, int] = defaultdict(int)
    last = {line.task: number for number, line in enumerate(plan.lines)}
    lines = []
    for number, (task, attempts, time) in enumerate(plan.lines):
        begin = planned[task]
        planned[task] += attempts
        end = None if number == last[task] else planned[task]
        of_line = done[task][begin:end]
        began = of_line[0].started if time and of_line else None
        counted = _attempts(task, attempts, of_line)
        lines.append(replace(counted, open_protests=protested[task], time=time, began=began))
    tasks = tuple(
        replace(_attempts(task, planned[task], of_task), open_protests=protested[task])
        for task, of_task in done.items()
    )
    return PlanProgress(tuple(lines), tasks, plan.notes, unread)


def plan_remarks(
    lines: Sequence[PlanLine], names: Mapping[int, str], timeout: float = 0.0
) -> Iterator[str]:
    """Names subjects that are not in the list of teams, and the first time that is too short.

    Without `names` there is no list. Each attempt may take the `timeout`, s.
    """
    unknown = [str(subject) for subject in sorted({line.task.subject for line in lines} - {*names})]
    if names and unknown:
        words = listed(unknown, _MOST_NAMED)
        yield f"the plan has subject {words}, not in the list of teams: correct one of them"
    if tight := [*_too_short(lines, timeout)]:
        more = f" (and {len(tight) - 1} more)" if len(tight) > 1 else ""
        yield f"the plan cannot be kept at {tight[0]}{more}"


def _too_short(lines: Sequence[PlanLine], timeout: float) -> Iterator[str]:
    """Times with less than the timeout for each attempt before the next time."""
    timed = [at for at, line in enumerate(lines) if line.time]
    for first, following in pairwise(timed):
        begin, end = lines[first].time, lines[following].time
        attempts = sum(line.attempts for line in lines[first:following])
        if len(begin) != len(end):
            continue  # a time without a date is of any day
        room = _since_midnight(end) - _since_midnight(begin)
        if room < 0 and len(end) == len("14:30"):
            room += 86_400.0  # a time that goes down is of the next day
        if 0 <= room < attempts * timeout:
            yield f"{begin}: {format_duration(room)} for {attempts} x {timeout:g} s"


def _since_midnight(time: str) -> float:
    """s, of the first day that is named."""
    moment = datetime.fromisoformat(f"1970-01-01 {time}" if len(time) == len("14:30") else time)
    return (moment - datetime(1970, 1, 1)).total_seconds()  # noqa: DTZ001  of the place


def is_attempt(run: RunSummary) -> bool:
    """Whether a run uses up an attempt of its team."""
    if not run.official or run.problem is not None or run.voided or run.twin:
        return False
    if run.outcome is Outcome.ABORTED:
        return run.reason != TESTBED_FAULT
    return run.outcome in _ENDED


def _counted(runs: Sequence[RunSummary], planned: int) -> list[RunSummary]:
    """Return the attempts that count: one that was repeated after an abort counts once."""
    repeated = len(runs) - planned if planned else 0
    counted = []
    for run in runs:
        if repeated > 0 and not run.valid:
            repeated -= 1
            continue
        counted.append(run)
    return counted


@dataclass(frozen=True, slots=True)
class PlanSource:
    """The source of the plan: settings, or a csv file of `subject,condition,attempts,time`."""

    lines: tuple[PlanLine, ...] = ()
    file: Path | None = None
    remedy: str = CORRECT_SETTINGS

    @property
    def file_words(self) -> str:
        return "" if self.file is None else terminal_safe(str(self.file))

    def read(self, before: Plan | None = None) -> Plan:
        """The plan now, or `before` where the file is unreadable or empty."""
        if self.file is None:
            return Plan(self.lines)
        last = before or Plan()
        try:
            plan = read_plan(self.file, self.remedy)
        except MadrobError as error:
            return self._as_before(last, str(error))
        if last.lines and not plan.lines:  # as while it is written
            return self._as_before(last, f"plan {plan.file}: it has no line")
        return plan

    def _as_before(self, before: Plan, problem: str) -> Plan:
        stays = "; the plan stays as it was" if before.lines else ""
        problems = (f"{problem}{stays}",)
        return Plan(before.lines, problems, self.file_words, unusable=before.unusable)


def read_plan(path: Path, remedy: str = CORRECT_SETTINGS) -> Plan:
    """Reads a csv file; MadrobError, with the `remedy`, where that fails."""
    reader = _Reader(path, "plan", remedy)
    reader.read()
    return Plan(
        tuple(reader.lines),
        first_problems(reader.problems),
        terminal_safe(str(path)),
        first_problems(reader.remarks),
        reader.unusable,
    )


def _attempts(task: Task, planned: int, runs: Sequence[RunSummary]) -> Attempts:
    valid = [run for run in runs if run.valid]
    levels = (run.values.get(IndicatorName.CAPABILITY_LEVEL, -1) for run in valid)
    best = max((int(level) for level in levels if level in _LEVELS), default=None)
    return Attempts(task, planned, len(runs), len(valid), best)


class _Reader(ListReader):
    columns = ("subject", "condition", "attempts", "time")

    def __init__(self, path: Path, name: str, remedy: str) -> None:
        super().__init__(path, name, remedy)
        self.lines: list[PlanLine] = []

    def take_entry(self, number: int, subject: int, entry: Mapping[str, str]) -> Iterator[str]:
        """Takes a line; without a number of attempts it means one."""
        condition = condition_number(entry["condition"])
        attempts = _ATTEMPTS.fullmatch(text := entry.get("attempts") or "1")
        if attempts is None:
            raise MadrobError(
                f"attempts {quoted(text)} is no number from 1 to {MOST_ATTEMPTS}: write one"
            )
        if len(self.lines) == MOST_LINES:
            raise MadrobError(f"a plan has {MOST_LINES} lines at most, this one is left out")
        time = ""
        try:
            time = _planned_time(entry.get("time", ""))
            if _folds(time) > 0:
                yield f"time {quoted(time)} comes twice, clocks change then: the first counts"
        except MadrobError as error:
            yield f"{error}; the line counts without it"
        self.lines.append(PlanLine(Task(subject, condition), int(attempts[1]), time))


def delay(planned: str, at: float) -> float:
    """How much later than a planned time `at` is, s; both s since the epoch and of the place.

    0 for no planned time, before it, and more than 12 h after it. A time without a date is of the
    day on which it comes nearest to `at`.
    """
    if not planned:
        return 0.0
    of_day, _, time = planned.rpartition(" ")
    today = datetime.fromtimestamp(at)  # noqa: DTZ006  of the place
    days = [of_day] if of_day else [f"{today + timedelta(d):%Y-%m-%d}" for d in (-1, 0, 1)]
    late = [at - datetime.fromisoformat(f"{day} {time}").timestamp() for day in days]
    nearest = min(late, key=abs)
    return nearest if 0.0 < nearest <= _LATEST else 0.0


def condition_number(text: str) -> int:
    """Of a condition's number or words, as `pull, from CCW, No Force`; MadrobError if neither."""
    number = _CONDITIONS.get(_words(text.lstrip("0")))
    if number is not None:
        return number
    near = get_close_matches(text, _PHRASES, 1)
    if not near:
        raise MadrobError(f"there is no condition {quoted(text)}: see `madrob plan --conditions`")
    missing = "benchmark type missing; " if near[0].startswith(text) else ""
    raise MadrobError(f"condition {quoted(text)}: {missing}did you mean '{near[0]}'?")


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.casefold().replace(",", " ").split())


def _ways_to_say(condition: Condition) -> Iterator[str]:
    yield str(condition.number)
    for way in (condition.way, condition.way.partition(" to ")[0]):
        yield f"{way} {condition.benchmark_type}"
        yield f"{condition.benchmark_type} {way}"


_CONDITIONS = {
    _words(text): number
    for number in range(1, 21)
    for text in _ways_to_say(Condition.from_number(number))
}


_PHRASES = [
    f"{condition.way.partition(' to ')[0]}, {condition.benchmark_type}"
    for condition in map(Condition.from_number, range(1, 21))
]

_FIRST_YEAR = 1970
"""Earlier ones are typing errors, which no clock can tell from now."""


def _folds(planned: str) -> float:
    """After how many s a clock time comes again on its day; negative = the day skips it."""
    if " " not in planned:
        return 0.0
    moment = datetime.fromisoformat(planned)
    return moment.replace(fold=1).timestamp() - moment.timestamp()


def _planned_time(text: str) -> str:
    """As in `PlanLine`, of `HH:MM` or an ISO date with time; MadrobError if it is neither."""
    if not text:
        return ""
    with suppress(ValueError):
        return datetime.strptime(text, "%H:%M").strftime("%H:%M")  # noqa: DTZ007  of the place
    with suppress(ValueError):
        if ":" in text:
            moment = datetime.fromisoformat(text)
            local = moment.astimezone() if moment.tzinfo else moment
            if local.year >= _FIRST_YEAR:
                planned = local.strftime("%Y-%m-%d %H:%M")
                if _folds(planned) < 0:
                    raise MadrobError(f"time {quoted(text)} does not come, clocks change then")
                return planned
    raise MadrobError(f"time {quoted(text)} cannot be read: write 14:30 or 2026-11-25T14:30")
