"""The plan pane: teams x conditions, what is done of the plan, what comes next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from itertools import islice
from typing import TYPE_CHECKING, ClassVar

from rich.cells import cell_len
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.message import Message

from madrob_console.archive.history import condition_words
from madrob_console.common.errors import MadrobError
from madrob_console.engine.requests import GivePlan
from madrob_console.pages.competition import attempt_words, summary_words, task_words
from madrob_console.referee.competition_plan import Attempts, PlanProgress, Task, unknown_teams
from madrob_console.ui.cells.lines import Label, Span, Tone
from madrob_console.ui.cells.table import Grid, GridRow
from madrob_console.ui.look.words import fitted
from madrob_console.ui.panes.runs_pane import results_state

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.link import EngineLink

KEYS = "Enter proposes, x sets up. {}; ! one invalid, + out of plan"
ALL = "done/planned, L level"
NO_PLAN_WORDS = "no plan: name a file with lines `subject,condition,attempts` in [plan]"

_LEAST_TEAM, _MOST_TEAM = 8, 24
_THEN = 2
"""So many runs are named behind the next one."""
_PROBLEMS = 2
"""So many lines that cannot be used are named; `madrob plan` names them all."""


class CellView(StrEnum):
    """What a cell says if there is no room for all."""

    DONE = "done/planned"
    VALID = "valid/planned"
    LEVEL = "best level"


class PlanPane(Vertical):
    """A row a team, a column a condition; Enter proposes the marked one."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("v", "view", show=False)]

    class Chosen(Message):
        """The referee wants a team in a condition to be run next."""

        def __init__(self, task: Task) -> None:
            super().__init__()
            self.task = task

    def __init__(self, reader: PlanReader) -> None:
        super().__init__(id="plan")
        self._reader = reader
        self._version = -1
        self._teams: Mapping[int, str] = {}
        self._view = CellView.DONE
        self._subjects: Sequence[int] = ()
        self._conditions: Sequence[int] = ()
        self._tasks: Mapping[Task, Attempts] = {}
        self._goes_to_next = False
        self._head = Label(id="plan-head")
        self._problems = Label(tone=Tone.WARN, id="plan-problems")
        self._grid = Grid()
        self._about = Label(id="plan-about")
        self._keys = Label()

    def compose(self) -> ComposeResult:
        yield self._head
        yield self._problems
        yield self._grid
        yield self._about
        yield self._keys

    @property
    def selected(self) -> Task | None:
        if not self._subjects or not self._conditions:
            return None
        return Task(self._subjects[self._grid.row], self._conditions[self._grid.column])

    @property
    def copied(self) -> str:
        task = self.selected
        if task is None:
            return ""
        following = self._reader.progress.next
        attempts = self._tasks.get(task, Attempts(task))
        is_next = following is not None and following.task == task
        return about(attempts, self._teams) + ("; NEXT" if is_next else "")

    def enter(self) -> None:
        self.screen.set_focus(self._grid)
        self._goes_to_next = True
        self.run_worker(self._reader.read(), exclusive=True)

    def show(self, snapshot: Snapshot) -> None:
        if (self._version, self._teams) != (self._reader.version, snapshot.teams.names):
            self._version, self._teams = self._reader.version, snapshot.teams.names
            self._show_progress()

    def on_resize(self, _event: events.Resize) -> None:
        self._show_progress()

    def on_grid_marked(self, event: Grid.Marked) -> None:
        event.stop()
        self._about.say(self.copied, Tone.DIM)

    def on_grid_chosen(self, event: Grid.Chosen) -> None:
        event.stop()
        if (task := self.selected) is not None:
            self.post_message(self.Chosen(task))

    def action_view(self) -> None:
        order = list(CellView)
        self._view = order[(order.index(self._view) + 1) % len(order)]
        self._show_progress()

    def _show_progress(self) -> None:
        found, marked = self._reader.progress, self.selected
        self._tasks = {attempts.task: attempts for attempts in found.tasks}
        self._subjects = sorted({task.subject for task in self._tasks})
        self._conditions = sorted({task.condition for task in self._tasks})
        following = found.next
        if self._goes_to_next and following is not None:
            marked, self._goes_to_next = following.task, False
        self._say_head(found)
        width = self._grid.room.width
        heads = self._heads(width - 1)
        wide = self._rows(None)
        fits = width >= cell_len(heads[0]) + 1 + len(self._conditions) * (1 + _widest(wide))
        cells = wide if fits else self._rows(self._view)
        protest = ", P protest open" if any(one.open_protests for one in found.tasks) else ""
        self._keys.say(KEYS.format(ALL if fits else f"v: {self._view}") + protest, Tone.DIM)
        task = None if following is None else following.task
        titles = [f">{c}" if task and task.condition == c else str(c) for c in self._conditions]
        rows = [
            GridRow([Span(head, Tone.STRONG if head.startswith(">") else Tone.PLAIN)], spans)
            for head, spans in zip(heads[1:], cells, strict=True)
        ]
        self._grid.empty = "" if found.lines else NO_PLAN_WORDS
        self._grid.set_cells(heads[0], titles, rows)
        if marked in self._tasks:
            self._grid.mark(
                self._subjects.index(marked.subject), self._conditions.index(marked.condition)
            )

    def _say_head(self, found: PlanProgress) -> None:
        problems = [*unknown_teams((line.task for line in found.lines), self._teams)]
        problems += found.problems[:_PROBLEMS]
        if len(found.problems) > _PROBLEMS:
            problems.append(f"and {len(found.problems) - _PROBLEMS} more: `madrob plan` names them")
        if self._reader.problem:
            problems.insert(0, self._reader.problem)
        self._problems.display = bool(problems)
        self._problems.say("; ".join(problems), Tone.WARN)
        if not found.lines:
            self._head.say("")
            return
        text = summary_words(found)
        upcoming = [*islice(found.upcoming(), 1 + _THEN)]
        if upcoming:
            text += f" Next: {attempt_words(upcoming[0], self._teams)}."
        if then := [f"{each.task.subject} in {each.task.condition}" for each in upcoming[1:]]:
            text += f" Then {', '.join(then)}."
        self._head.say(text)

    def _heads(self, width: int) -> list[str]:
        done = [self._total(subject) for subject in self._subjects]
        names = [self._teams.get(subject, "") for subject in self._subjects]
        numbers = max(map(len, done), default=0)
        most = max((cell_len(name) for name in names), default=0)
        # what the columns leave, but never so little that nobody can be told from others
        left = width - numbers - 7 - len(self._conditions) * (1 + _widest(self._rows(None)))
        room = min(_MOST_TEAM, most, max(_LEAST_TEAM, width // 6, left))
        following = self._reader.progress.next
        heads = [
            f"{'>' if following and following.task.subject == subject else ' '}{subject:>3}"
            f" {fitted(name, room)} {total:>{numbers}} "
            for subject, name, total in zip(self._subjects, names, done, strict=True)
        ]
        return [fitted("subj team" if room > 3 else "subj", 4 + room + numbers + 3), *heads]

    def _total(self, subject: int) -> str:
        of_team = [one for task, one in self._tasks.items() if task.subject == subject]
        planned = sum(one.planned for one in of_team)
        return f"{planned - sum(one.left for one in of_team)}/{planned}"

    def _rows(self, view: CellView | None) -> list[list[Span]]:
        following = self._reader.progress.next
        task = None if following is None else following.task
        return [
            [
                cell(self._tasks.get(each), view, is_next=task == each)
                for each in (Task(subject, condition) for condition in self._conditions)
            ]
            for subject in self._subjects
        ]


def cell(attempts: Attempts | None, view: CellView | None, *, is_next: bool) -> Span:
    """What a cell of the grid says; all of it without a `view`.

    `1/2` is one attempt done of two, `1!2` the same with one not valid, `+1` one out of plan;
    `P` at the end: a protest is open.
    """
    if attempts is None:
        return Span("")
    of, done, valid = attempts.planned, attempts.done, attempts.valid
    protested = "P" if attempts.open_protests else ""
    sign = "/" if valid == done else "!"
    level = "-" if attempts.best_level is None else f"{attempts.best_level}"
    counts = f"{done}{sign}{of}" if of else f"+{done}"
    texts = {
        None: f"{counts}L{level}" if done else f"{counts}  ",
        CellView.DONE: counts,
        CellView.VALID: f"{valid}{sign}{of}" if of else f"+{valid}",
        CellView.LEVEL: f"L{level}" if done else ".",
    }
    if is_next:
        tone = Tone.NOTICE
    elif protested:
        tone = Tone.BAD
    elif attempts.left:
        tone = Tone.PLAIN if done else Tone.DIM
    else:
        tone = Tone.GOOD if 0 < of <= valid else Tone.WARN
    return Span(texts[view] + protested, tone)


def about(attempts: Attempts, teams: Mapping[int, str]) -> str:
    words = ", ".join(condition_words(attempts.task.condition))
    told = [f"{task_words(attempts.task, teams)}: {words}"]
    if attempts.open_protests:
        told.insert(0, f"NOT FINAL, {attempts.open_protests} PROTEST open")
    if attempts.planned:
        told.append(f"{attempts.done} of {attempts.planned} attempts done")
    elif attempts.done:
        told.append(f"OUT OF PLAN, {attempts.done} done")
    else:
        told.append("not in the plan")
    if attempts.done:
        told.append(f"{attempts.valid} valid")
    if attempts.best_level is not None:
        told.append(f"best level {attempts.best_level}")
    if attempts.left:
        told.append(f"{attempts.left} left")
    return "; ".join(told)


def _widest(rows: Iterable[Iterable[Span]]) -> int:
    return max((len(span.text) for row in rows for span in row), default=0)


# The progress of the competition's plan, as this screen knows it.


class PlanReader:
    """Asks the engine again after a change; `problem` says why there is no newer `progress`."""

    def __init__(self, link: EngineLink) -> None:
        self._link = link
        self._seen: object = None
        self._asked = 0
        self._answered = 0
        self._wanted = 0
        self.progress = PlanProgress()
        self.problem = ""
        self.version = 0

    def is_old(self, snapshot: Snapshot) -> bool:
        """Whether to read again; says so once for each change."""
        seen = (snapshot.plan, results_state(snapshot))
        old, self._seen = seen != self._seen, seen
        if old:
            self._wanted = self._asked + 1
        return old

    @property
    def behind(self) -> bool:
        return self._answered < self._wanted

    async def read(self) -> None:
        """Asks; the answer to the latest question counts."""
        self._asked += 1
        number = self._asked
        progress, problem = self.progress, ""
        try:
            progress = await self._link.answer(GivePlan())
        except MadrobError as error:
            problem = str(error)
        if number > self._answered:
            self._answered = number
            self.progress, self.problem = progress, problem
            self.version += 1
