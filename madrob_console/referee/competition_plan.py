"""A competition's plan: who does what, in which order, and how much of it is done.

A line of the plan is a team, a condition and a number of attempts. The same team and condition may
stand in several lines, as in rounds. An attempt is done when the run is official, of this
competition, and has ended as completed, timeout or aborted: who is aborted has had the attempt,
though it is not valid. An interrupted or a voided run is no attempt, so that it comes next again;
practice never is one (protocol section 2).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.referee.lists import ListReader, quoted, subject_number, told
from madrob_console.referee.records import listed
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome, Step

MOST_LINES = 2000
"""Lines of a plan; what follows is not taken."""
MOST_ATTEMPTS = 99
"""Attempts of one line."""

_MOST_NAMED = 10

CORRECT_SETTINGS = "correct file of [plan]"
"""What to do about a plan that cannot be read, where the settings name it."""

_LEVELS = range(len(Step) + 1)
_ENDED = (Outcome.COMPLETED, Outcome.TIMEOUT, Outcome.ABORTED)


class Task(NamedTuple):
    """A team in a condition, by their numbers."""

    subject: int
    condition: int


class PlanLine(NamedTuple):
    """A line of the plan: so many attempts of a team in a condition."""

    task: Task
    attempts: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What is planned; without a line in it there is no plan.

    Attributes:
        lines: in the order in which they are run.
        problems: what was not taken, a line each.
        file: where it is read from, for people; empty = no file.
    """

    lines: tuple[PlanLine, ...] = ()
    problems: tuple[str, ...] = ()
    file: str = ""


NO_PLAN = Plan()
"""Nobody has planned anything."""


@dataclass(frozen=True, slots=True)
class Attempts:
    """The attempts of a team in a condition: all of them, or those of one line of the plan.

    Attributes:
        task: the team and the condition.
        planned: as the plan says; 0 = out of plan.
        done: those that were used up.
        valid: those of them that count.
        best_level: the highest capability level of these; None without one.
        open_protests: official runs of the team in the condition, also such as are no attempt, with
            a protest that is not decided: all of this is not final.
    """

    task: Task
    planned: int = 0
    done: int = 0
    valid: int = 0
    best_level: int | None = None
    open_protests: int = 0

    @property
    def left(self) -> int:
        """Those that are still to be run."""
        return max(0, self.planned - self.done)


class PlannedAttempt(NamedTuple):
    """One attempt that is left: which of how many of the team in the condition, from 1."""

    task: Task
    number: int
    planned: int


@dataclass(frozen=True, slots=True)
class PlanProgress:
    """How much of a plan is done.

    Attributes:
        lines: of each line of the plan; the attempts of a task fill its lines in their order.
        tasks: all attempts of each task: those that are planned, in their order, then the others.
        problems: of the plan.
        unread: runs whose result is damaged: nobody knows whether they count.
    """

    lines: tuple[Attempts, ...] = ()
    tasks: tuple[Attempts, ...] = ()
    problems: tuple[str, ...] = ()
    unread: int = 0

    @property
    def planned(self) -> int:
        """All attempts of the plan."""
        return sum(line.planned for line in self.lines)

    @property
    def left(self) -> int:
        """Those that are still to be run."""
        return sum(line.left for line in self.lines)

    def upcoming(self) -> Iterator[PlannedAttempt]:
        """The next attempt of each line that is not done, in the order of the plan."""
        of_task = {attempts.task: attempts for attempts in self.tasks}
        before: dict[Task, int] = defaultdict(int)
        for line in self.lines:
            if line.left:
                number = before[line.task] + line.done + 1
                yield PlannedAttempt(line.task, number, of_task[line.task].planned)
            before[line.task] += line.planned

    @property
    def next(self) -> PlannedAttempt | None:
        """What is run next; None when all is done."""
        return next(self.upcoming(), None)

    def out_of_plan(self, task: Task) -> bool:
        """Whether one more run of a task is beyond the plan; never where there is none.

        An attempt that is not valid may be repeated: that is the referee's decision.
        """
        attempts = next((one for one in self.tasks if one.task == task), Attempts(task))
        return bool(self.lines) and attempts.valid >= attempts.planned


class RunFacts(Protocol):
    """What is asked of a run of the history."""

    @property
    def folder(self) -> str:
        """Its name."""
        ...

    @property
    def subject(self) -> int:
        """The robot's number."""
        ...

    @property
    def condition(self) -> int:
        """The condition's number."""
        ...

    @property
    def started(self) -> float:
        """When, s since the epoch."""
        ...

    @property
    def competition(self) -> str | None:
        """Its name; None = not known."""
        ...

    @property
    def official(self) -> bool:
        """Whether it was meant to count, on a real testbed."""
        ...

    @property
    def outcome(self) -> Outcome | None:
        """How it ended; None = not yet."""
        ...

    @property
    def valid(self) -> bool:
        """Whether its indicators count."""
        ...

    @property
    def voided(self) -> bool:
        """Whether the referee says that it counts nowhere."""
        ...

    @property
    def values(self) -> Mapping[str, float]:
        """Those of its indicators that have one."""
        ...

    @property
    def problem(self) -> str | None:
        """Why nothing is known of it."""
        ...

    @property
    def protest_due(self) -> float | None:
        """When an open protest is to be decided; None = none is open."""
        ...

    @property
    def twin(self) -> str:
        """Which other folder holds it and counts; empty = this one does."""
        ...


def plan_progress(plan: Plan, runs: Iterable[RunFacts], competition: str) -> PlanProgress:
    """How much of a plan is done.

    Args:
        plan: what is planned.
        runs: from a history.
        competition: only runs that carry its name count; empty = those that carry none.
    """
    done: dict[Task, list[RunFacts]] = {line.task: [] for line in plan.lines}
    unread, protested = 0, Counter[Task]()
    for run in sorted(runs, key=lambda run: (run.started, run.folder)):
        unread += run.problem is not None
        if run.protest_due is not None and run.official and run.competition == competition:
            protested[Task(run.subject, run.condition)] += 1
        if is_attempt(run) and run.competition == competition:
            done.setdefault(Task(run.subject, run.condition), []).append(run)
    planned: dict[Task, int] = defaultdict(int)
    lines = []
    for task, attempts in plan.lines:
        begin = planned[task]
        planned[task] += attempts
        of_line = _attempts(task, attempts, done[task][begin : planned[task]])
        lines.append(replace(of_line, open_protests=protested[task]))
    tasks = tuple(
        replace(_attempts(task, planned[task], of_task), open_protests=protested[task])
        for task, of_task in done.items()
    )
    return PlanProgress(tuple(lines), tasks, plan.problems, unread)


def unknown_teams(tasks: Iterable[Task], names: Mapping[int, str]) -> Iterator[str]:
    """Which subjects of a plan are not in the list of teams, in words; none where there is no list.

    Args:
        tasks: of the plan.
        names: subject -> team, the list.
    """
    unknown = [str(subject) for subject in sorted({task.subject for task in tasks} - {*names})]
    if names and unknown:
        words = listed(unknown, _MOST_NAMED)
        yield f"the plan has subject {words}, not in the list of teams: correct one of them"


def is_attempt(run: RunFacts) -> bool:
    """Whether a run uses up an attempt."""
    ended = run.outcome in _ENDED and not run.voided and not run.twin
    return run.official and run.problem is None and ended


@dataclass(frozen=True, slots=True)
class PlanSource:
    """Where the plan comes from.

    Attributes:
        lines: from the settings.
        file: a csv file with lines `subject,condition,attempts` instead; None = there is none.
        remedy: what to do about a file that cannot be read, for people.
    """

    lines: tuple[PlanLine, ...] = ()
    file: Path | None = None
    remedy: str = CORRECT_SETTINGS

    @property
    def file_words(self) -> str:
        """The path of the file, for people; empty = there is none."""
        return "" if self.file is None else terminal_safe(str(self.file))

    def read(self, before: Plan | None = None) -> Plan:
        """The plan as it is now.

        Args:
            before: as it was: it stays where the file cannot be read now or has no line; None =
                it is read for the first time.
        """
        if self.file is None:
            return Plan(self.lines)
        kept = before or Plan()
        try:
            found = read_plan(self.file, self.remedy)
        except MadrobError as error:
            return self._kept(kept, str(error))
        if kept.lines and not found.lines:  # as while it is written
            return self._kept(kept, f"plan {found.file}: it has no line")
        return found

    def _kept(self, before: Plan, problem: str) -> Plan:
        stays = "; the plan stays as it was" if before.lines else ""
        return Plan(before.lines, (f"{problem}{stays}",), self.file_words)


def read_plan(path: Path, remedy: str = CORRECT_SETTINGS) -> Plan:
    """Read a plan from a csv file.

    Args:
        path: the file.
        remedy: what to do if that is in vain.

    Raises:
        MadrobError: it is not there, is no file of text, or is too large.
    """
    reader = _Reader(path, "plan", remedy)
    reader.read()
    return Plan(tuple(reader.lines), told(reader.problems), terminal_safe(str(path)))


def _attempts(task: Task, planned: int, runs: Sequence[RunFacts]) -> Attempts:
    valid = [run for run in runs if run.valid]
    levels = (run.values.get(IndicatorName.CAPABILITY_LEVEL, -1) for run in valid)
    best = max((int(level) for level in levels if level in _LEVELS), default=None)
    return Attempts(task, planned, len(runs), len(valid), best)


class _Reader(ListReader):
    """Takes line after line."""

    def __init__(self, path: Path, name: str, remedy: str) -> None:
        super().__init__(path, name, remedy)
        self.lines: list[PlanLine] = []

    def take(self, number: int, values: list[str]) -> Iterator[str]:
        """A line; who leaves the attempts out means one."""
        if len(values) > 3:
            raise MadrobError(f"{len(values)} values, use subject, condition and attempts")
        subject = subject_number(values[0])
        if len(values) == 1:
            raise MadrobError(f"subject {subject} has no condition")
        condition = _whole(values[1], "condition", 20)
        attempts = _whole(values[2], "attempts", MOST_ATTEMPTS) if len(values) == 3 else 1
        if len(self.lines) == MOST_LINES:
            raise MadrobError(f"a plan has {MOST_LINES} lines at most, this one is left out")
        self.lines.append(PlanLine(Task(subject, condition), attempts))
        yield from ()


def _whole(value: str, name: str, largest: int) -> int:
    """A number from 1.

    Raises:
        MadrobError: it is none, or too large.
    """
    if not (value.isascii() and value.isdigit() and len(value) < 10 and 1 <= int(value) <= largest):
        raise MadrobError(f"{name} {quoted(value)} is no number from 1 to {largest}")
    return int(value)
