"""The plan pane: teams x conditions, what is done of the plan, what comes next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice

from textual.message import Message

from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import listed
from madrob_console.engine.requests import GivePlan
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.plan_text import attempts_cell, schedule_words, summary_words, task_words
from madrob_console.referee.competition_plan import (
    Attempts,
    PlanLine,
    PlanProgress,
    Task,
    plan_remarks,
)
from madrob_console.referee.run_summary import condition_words
from madrob_console.ui.cells.columns import Column
from madrob_console.ui.cells.lines import Span, Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.link import EngineLink
from madrob_console.ui.panes.list_columns import number_column, text_column
from madrob_console.ui.panes.list_pane import ListPane, results_state

KEYS = "Enter proposes the marked team and condition, < > o sort, / filters"
LEGEND = "> next  1/2 one of two done  + out of plan  P protest"
NO_PLAN_WORDS = "no plan: name a file with lines `subject,condition,attempts` in [plan]"

_THEN = 2
"""So many runs are named behind the next one."""
_PROBLEMS = 2
"""So many lines that cannot be used are named; `madrob plan` names them all."""
_HEADS = 3
"""Columns before those of the conditions."""


class PlanPane(ListPane[int]):
    """A row a team, a column a condition; Enter proposes the marked one."""

    @dataclass
    class Chosen(Message):
        """The referee wants a team in a condition to be run next."""

        task: Task

    def __init__(self, reader: PlanReader) -> None:
        self._reader = reader
        self._shown_state: object = None
        self._teams: Mapping[int, str] = {}
        self._tasks: Mapping[Task, Attempts] = {}
        self._next: Task | None = None
        self._goes_to_next = False
        table = Table(self._columns(), str, fixed=_HEADS, marks_cells=True)
        table.legend = LEGEND
        super().__init__(table, id="plan")
        self.keys.say(KEYS, Tone.DIM)

    @property
    def selected(self) -> Task | None:
        subject = self.table.selected
        return None if subject is None else Task(subject, int(self.table.marked.title))

    @property
    def copied(self) -> str:
        task = self.selected
        if task is None:
            return ""
        words = about(self._tasks.get(task, Attempts(task)), self._teams)
        return f"{words}; NEXT" if task == self._next else words

    def enter(self) -> None:
        self.screen.set_focus(self.table)
        self._goes_to_next = True
        self.run_worker(self._reader.read(), exclusive=True)

    def show(self, snapshot: Snapshot) -> None:
        self._teams = snapshot.teams.names
        setup = snapshot.run.setup if snapshot.run.active else None
        running = None if setup is None else Task(setup.subject, setup.condition.number)
        shown_state = self._reader.version, self._teams, running, snapshot.time // 60
        if shown_state != self._shown_state:
            self._shown_state = shown_state
            self._show_progress(self._reader.progress, snapshot.time, running)

    def words_about(self, _row: int) -> tuple[str, Tone]:
        return self.copied, Tone.DIM

    def on_table_chosen(self, event: Table.Chosen) -> None:
        event.stop()
        if (task := self.selected) is not None:
            self.post_message(self.Chosen(task))

    def _show_progress(self, progress: PlanProgress, now: float, running: Task | None) -> None:
        marked, self._tasks = self.selected, {task.task: task for task in progress.tasks}
        self._next = None if progress.next is None else progress.next.task
        if self._goes_to_next and self._next is not None:
            marked, self._goes_to_next = self._next, False
        lines = [PlanLine(line.task, line.planned) for line in progress.lines]
        unknown = plan_remarks(lines, self._teams)
        problems = [*filter(None, (self._reader.problem, *unknown, *progress.problems))]
        said = [f"{listed(problems, _PROBLEMS)}."] if problems else []
        said += [summary_words(progress)] if progress.lines else []
        said += schedule_words(progress, self._teams, now, running)
        then = [
            f"{slot.task.subject} in {slot.task.condition}"
            for slot in islice(progress.upcoming(running), 1, 1 + _THEN)
        ]
        if then:
            said.append(f"Then {', '.join(then)}.")
        self.head.say(" ".join(said), Tone.WARN if problems else Tone.PLAIN)
        self.table.empty = "" if progress.lines else NO_PLAN_WORDS
        self.table.set_columns(self._columns())
        self.table.set_rows(sorted({task.subject for task in self._tasks}))
        if marked is not None and marked in self._tasks:
            place = [column.title for column in self.table.columns].index(str(marked.condition))
            self.table.mark(self.table.rows.index(marked.subject), place)

    def _columns(self) -> list[Column[int]]:
        heads: list[Column[int]] = [
            number_column("subj", "subject", lambda subject: subject, 5),
            text_column("team", "team", lambda subject: self._teams.get(subject, ""), 12, ample=30),
            Column(
                *("done", "attempts done of planned"),
                lambda subject: Span("{}/{}".format(*self._total(subject))),
                lambda subject: self._total(subject)[0],
                7,
                right=True,
            ),
        ]
        conditions = sorted({task.condition for task in self._tasks})
        return [*heads, *map(self._column, conditions)]

    def _column(self, condition: int) -> Column[int]:
        cells = {
            task.subject: cell(attempts, is_next=task == self._next)
            for task, attempts in self._tasks.items()
            if task.condition == condition
        }
        return Column(
            *(str(condition), f"condition {condition}"),
            lambda subject: cells.get(subject, Span("")),
            lambda subject: cells[subject].text if subject in cells else None,
            max(3, *(len(span.text) for span in cells.values())),
            right=True,
        )

    def _total(self, subject: int) -> tuple[int, int]:
        """Attempts that are done of those that are planned."""
        of_team = [attempts for task, attempts in self._tasks.items() if task.subject == subject]
        planned = sum(attempts.planned for attempts in of_team)
        return planned - sum(attempts.left for attempts in of_team), planned


def cell(attempts: Attempts, *, is_next: bool) -> Span:
    """`attempts_cell` with the tone of how far they are; `>` marks the next attempt."""
    if is_next:
        return Span(f">{attempts_cell(attempts)}", Tone.NOTICE)
    done, tone = attempts.done, Tone.GOOD if attempts.planned else Tone.WARN
    if attempts.open_protests:
        tone = Tone.BAD
    elif attempts.left:
        tone = Tone.PLAIN if done else Tone.DIM
    return Span(attempts_cell(attempts), tone)


def about(attempts: Attempts, teams: Mapping[int, str]) -> str:
    """Attempts in words, first what is open."""
    task, done = attempts.task, attempts.done - attempts.beyond
    out = f"OUT OF PLAN, {done} done" if done else "not in the plan"
    facts = (
        f"NOT FINAL, {attempts.open_protests} PROTEST open" if attempts.open_protests else "",
        f"{task_words(task, teams)}: {', '.join(condition_words(task.condition))}",
        f"{done} of {attempts.planned} attempts done" if attempts.planned else out,
        f"{attempts.beyond} more than planned" if attempts.beyond else "",
        f"{attempts.valid} valid" if done else "",
        "" if attempts.best_level is None else f"best level {attempts.best_level}",
        f"{attempts.left} left" if attempts.left else "",
    )
    return "; ".join(filter(None, facts))


class PlanReader:
    """Asks the engine again after a change; `problem` says why there is no newer `progress`.

    `behind` says that the answer to a change is not there yet.
    """

    def __init__(self, link: EngineLink) -> None:
        self._link = link
        self._newest_state: object = None
        self.progress = PlanProgress()
        self.problem = ""
        self.version = 0
        self.behind = False

    def is_old(self, snapshot: Snapshot) -> bool:
        """Whether to read again; says so once for each change."""
        before, self._newest_state = self._newest_state, (snapshot.plan, results_state(snapshot))
        old = before != self._newest_state
        self.behind |= old
        return old

    async def read(self) -> None:
        """Ask the engine. A change makes the answer stale; it is used only if there is no other."""
        asked_state, progress, problem = self._newest_state, self.progress, ""
        try:
            progress = await self._link.answer(GivePlan())
        except MadrobError as error:
            problem = str(error)
        if asked_state == self._newest_state or not self.version:
            self.progress, self.problem, self.behind = (
                progress,
                problem,
                asked_state != self._newest_state,
            )
            self.version += 1
