"""The history pane: all runs, filtered and sorted, open to be looked at again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

from msgspec.structs import replace
from textual.actions import SkipAction
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import Input

from madrob_console.archive.history import RunSummary, condition_words, time_words
from madrob_console.archive.run_filter import filter_problem, matches
from madrob_console.referee.flags import FlagKind, undecided
from madrob_console.ui.cells.field import Field
from madrob_console.ui.cells.label import Label
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.panes.history_columns import columns
from madrob_console.ui.panes.runs_pane import Load, RunsPane

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

KEYS = (
    "Enter opens, x next, / filter, v which, o O sort, <- -> columns; "
    "* not final, P protest, ! flags, ? doubted"
)


class RunFilter(StrEnum):
    """Which runs are shown."""

    ALL = "all"
    OPEN = "not final"
    UNDECIDED = "undecided"
    NOT_COUNTED = "invalid and interrupted"
    PROTEST = "protest open"

    def takes(self, run: RunSummary) -> bool:
        """Whether it shows a run."""
        match self:
            case RunFilter.ALL:
                return True
            case RunFilter.OPEN:
                return not run.final
            case RunFilter.PROTEST:
                return run.protest_due is not None
            case RunFilter.UNDECIDED:
                return bool(undecided(run.flags))
            case RunFilter.NOT_COUNTED:
                return not run.valid


class FilterField(Field):
    """One line to look for runs."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "clear", show=False),
        Binding("down", "submit", show=False),
    ]

    def action_clear(self) -> None:
        """Look for nothing."""
        self.value = ""
        self.post_message(self.Submitted(self, ""))


class HistoryPane(RunsPane[Sequence[RunSummary], RunSummary]):
    """Newest first; a filter and `v` choose which.

    Args:
        load: as for every pane of runs.
        competition: its runs' teams are called what the list of teams calls them.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("slash", "filter", show=False),
        Binding("v", "which", show=False),
        Binding("escape", "unfilter", show=False),
    ]

    def __init__(self, load: Load, competition: str = "") -> None:
        table = Table(columns(self._called), lambda run: run.folder, fixed=5)
        super().__init__(load, table, id="history")
        self._competition = competition
        self._listed: Mapping[int, str] = {}
        self._runs: Sequence[RunSummary] = ()
        self._which = RunFilter.ALL
        self._field = FilterField(id="history-filter")
        self._row = Horizontal(Label("filter", id="filter-name"), self._field, id="filter-row")

    def compose(self) -> ComposeResult:
        """What is shown, the filter, the table, the marked run, the keys."""
        yield self.head
        yield self._row
        yield self.table
        yield self.about
        yield Label(KEYS)

    def look_for(self, text: str) -> None:
        """Show the runs that pass a filter, as if it had been typed."""
        self._field.value = text
        self._which = RunFilter.ALL
        self._show_rows()

    def show(self, snapshot: Snapshot) -> None:
        """Read again when a result has come or changed, or the list of teams."""
        self._listed = snapshot.teams.names
        super().show(snapshot)

    def _called(self, run: RunSummary) -> str:
        """The team as the list has it; for runs of other competitions, and without one, as then."""
        listed = self._listed.get(run.subject, "") if run.competition == self._competition else ""
        return listed or run.team

    def prepare(self, runs: Sequence[RunSummary]) -> Sequence[RunSummary]:
        """Newest first, where nothing else decides."""
        return tuple(reversed(runs))

    def take(self, content: Sequence[RunSummary]) -> None:
        """Other runs."""
        self._runs = content
        self._show_rows(from_top=False)

    def action_filter(self) -> None:
        """Open the filter."""
        self._row.display = True
        self.screen.set_focus(self._field)

    def action_which(self) -> None:
        """All, those not final, those that do not count."""
        order = list(RunFilter)
        self._which = order[(order.index(self._which) + 1) % len(order)]
        self._show_rows()

    def action_unfilter(self) -> None:
        """Show all runs again.

        Raises:
            SkipAction: all are shown; the key goes on.
        """
        if not self._field.value.strip() and self._which is RunFilter.ALL:
            raise SkipAction
        self.look_for("")

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter while typing."""
        event.stop()
        self._show_rows()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """The filter stays as it is."""
        event.stop()
        self.screen.set_focus(self.table)

    def on_input_blurred(self, event: Input.Blurred) -> None:
        """The field goes, its text stays in the head line."""
        event.stop()
        self._row.display = False

    def words_about(self, row: RunSummary) -> tuple[str, Tone]:
        """The condition of a run, and what is wrong with it."""
        odd = row.problem is not None or row.outcome is None or undecided(row.flags)
        return about(row, self._called(row)), Tone.WARN if odd else Tone.DIM

    def _passes(self, run: RunSummary, text: str) -> bool:
        """Under either of its team's names."""
        if matches(run, text):
            return True
        name = self._called(run)
        return name != run.team and matches(replace(run, team=name), text)

    def _show_rows(self, *, from_top: bool = True) -> None:
        text = self._field.value
        problem = filter_problem(text)
        shown = [run for run in self._runs if self._which.takes(run) and self._passes(run, text)]
        self.table.empty = "no run passes the filter" if self._runs else "no runs yet"
        if problem is not None:
            self.table.empty = problem
        self.table.set_rows(shown, from_top=from_top)
        if len(shown) == len(self._runs) and self._which is RunFilter.ALL and not text.strip():
            self.say(summary(self._runs))
            return
        wanted = [] if self._which is RunFilter.ALL else [str(self._which)]
        wanted += [f"filter '{text.strip()}' (Escape clears it)"] if text.strip() else []
        self.say(f"{len(shown)} of {len(self._runs)} runs: {', '.join(wanted)}", Tone.STRONG)


def summary(runs: Sequence[RunSummary]) -> str:
    """How many runs there are of each kind."""
    if not runs:
        return "no runs in the results folder"
    words = Counter("valid" if run.valid else run.outcome_word for run in runs)
    parts = [f"{count} {word}" for word, count in words.most_common()]
    practice = sum(run.practice for run in runs)
    among = f" ({practice} PRACTICE)" if practice else ""
    plural = "s" if len(runs) > 1 else ""
    protests = sum(run.protest_due is not None for run in runs)
    if protests:
        parts.append(f"{protests} PROTEST{'S' if protests > 1 else ''} open")
    return f"{len(runs)} run{plural}{among}: {', '.join(parts)}"


def about(run: RunSummary, name: str | None = None) -> str:
    """One run in words: what its condition asks, what is wrong with it, where it lies.

    Args:
        run: it.
        name: what its team is called now; None = as it was recorded.
    """
    if run.problem is not None:
        return f"{run.problem} (folder {run.folder})"
    if run.twin:
        return run.why_twin
    task = ", ".join(word for word in condition_words(run.condition) if word)
    told = [task or f"condition {run.condition} does not exist", run.outcome_word]
    if run.outcome is None:
        told.append(run.never_ran or "it goes on, or it was cut off")
    else:
        told += [f"issue {run.issue}", run.closing, run.ruleset]
    name = run.team if name is None else name
    recorded = f" (recorded as {run.team})" if run.team and run.team != name else ""
    team = f"{name}{recorded}: " if name else ""
    if run.protest_due is not None:
        told.insert(0, f"decision due {time_words(run.protest_due)}")
    flagged = "; ".join(f.words for f in run.flags if f.kind is not FlagKind.PRACTICE)
    return f"{flagged}{'; ' if flagged else ''}{team}{'; '.join(told)}; {run.folder}"
