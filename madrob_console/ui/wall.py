"""`madrob watch --big`: the wall display, seen from far away."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.geometry import Size
from textual.screen import Screen

from madrob_console.archive.history import History, of_competition
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import time_of_day
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.competition import best_text
from madrob_console.pages.plan_text import late_words
from madrob_console.pages.tally import Standing, leaders_first, standings
from madrob_console.referee.competition_plan import PlannedAttempt, PlanProgress, plan_progress
from madrob_console.referee.flags import FlagWeight
from madrob_console.referee.run import Phase
from madrob_console.referee.run_summary import RunSummary, condition_words
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Span, Tone, View, line, width_of
from madrob_console.ui.frame.console_screen import BUSY_PERIOD
from madrob_console.ui.frame.frame_lines import WATCHING, source_badge
from madrob_console.ui.link import ConsoleDefaults, OpenClient
from madrob_console.ui.look.words import fitted, minutes_text
from madrob_console.ui.panes.list_columns import number_text
from madrob_console.ui.panes.notices import banner
from madrob_console.ui.panes.run_status import (
    clock_span,
    condition_text,
    phase_span,
    step_time,
    team_text,
    who_text,
)
from madrob_console.ui.wall_page import Page, PageRows
from scoring.indicator_table import IndicatorName
from scoring.procedure import UNSETTLED, StepRecord
from scoring.result import DOUBTED, Uncertainty, uncertainty_text

PAGE_TIME = 10.0
"""While nothing runs another page comes after so long, s."""

PAUSED = "PAUSED - technical problem"
"""What the hall reads while the engine is away."""

_INDICATORS = (IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME)

_ROWS_AROUND = 9
"""Of a page with a table: band, titles, and what is below it."""


class Wall(View):
    """The run while one goes on; else in turn the run, the last result and the standings."""

    runs: tuple[RunSummary | None, Sequence[Standing]] = (None, ())
    plan = PlanProgress()
    page = 0

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        head = _head(snapshot, width)
        size = Size(width, max(1, self.room.height - len(head)))
        latest, standing = self.runs
        pages = [run_page(snapshot)]
        if not snapshot.run.active:
            if latest is not None:
                pages.append(result_page(latest, snapshot))
            if self.plan.next is not None and not snapshot.practice:
                pages.append(next_page(self.plan.next, snapshot))
            pages += standings_pages(standing, size.height)
            if snapshot.run.setup is None:
                pages = pages[1:] or pages
        return [*head, *pages[self.page % len(pages)].drawn(size)]


def _head(snapshot: Snapshot, width: int) -> PageRows:
    head = line(source_badge(snapshot, max(4, width - 22)), Span(WATCHING, Tone.STRONG))
    clock = time_of_day(snapshot.time).rjust(max(0, width - width_of(head) - 1))
    words = snapshot.pulse.words
    if snapshot.pulse.stale:
        words = f"{PAUSED}. What you see is of {time_of_day(snapshot.time)}."
    fault = [line(Span(fitted(f" {words}", width), Tone.ALARM))] if words else []
    return [line(*head, Span(clock, Tone.DIM)), *fault]


def run_page(snapshot: Snapshot) -> Page:
    run, result = snapshot.run, snapshot.result
    text, tone = banner(snapshot)
    clock = clock_span(snapshot)
    level: float | None = sum(record.done for record in snapshot.steps)
    if result is not None:
        level = result.indicators[IndicatorName.CAPABILITY_LEVEL].value
    what = f"run {run.setup.run_number}, {condition_text(run)}" if run.setup else who_text(run)
    return Page(
        Span(PAUSED, Tone.BAD) if snapshot.pulse.stale else phase_span(run, result),
        (Span(team_text(run), Tone.STRONG), Span(what)),
        (
            (Span(clock.text.removesuffix(".?"), clock.tone), _clock_words(snapshot)),
            (Span("-" if level is None else f"{level:.0f}", Tone.STRONG), "of 6 steps"),
        ),
        tuple(map(partial(_step, snapshot), snapshot.steps)),
        below=[Span(text if tone is not Tone.PLAIN else "", tone)],
    )


def _clock_words(snapshot: Snapshot) -> str:
    if snapshot.remaining is None:
        return "time"
    if snapshot.run.phase is Phase.COUNTDOWN:
        return "to the start"
    return f"{minutes_text(snapshot.remaining)} left"


def _step(snapshot: Snapshot, record: StepRecord) -> tuple[Span, str]:
    """A step's name, and its time, s from the start, which is marked if it may still change."""
    name = f"{record.step} {record.step.name.lower()}"
    pending = next((other.step for other in snapshot.steps if not other.done), None)
    if record.done:
        rough = snapshot.result is None and record.step in UNSETTLED
        return Span(name, Tone.LIVE), step_time(record.final, snapshot.run.start, rough=rough)
    if record.denied:
        return Span(name, Tone.ALARM), "denied"
    if snapshot.run.phase is Phase.RUNNING and record.step is pending:
        return Span(name, Tone.WARN), "next"
    return Span(name, Tone.DIM), ""


def result_page(run: RunSummary, snapshot: Snapshot) -> Page:
    tone = Tone.GOOD if run.valid and not run.reason else Tone.BAD
    team = snapshot.teams.names.get(run.subject) or run.team
    task = ", ".join(filter(None, condition_words(run.condition)))
    flags = "; ".join(flag.words for flag in run.flags if flag.weight is not FlagWeight.REMARK)
    values: list[Sequence[Span]] = []
    large: list[tuple[Span, str]] = []
    for name in IndicatorName:
        uncertainty = run.uncertainties.get(name)
        number = _number(name, run.values.get(name), uncertainty, run.sign(name))
        if name in _INDICATORS and run.valid:
            large.insert(0, (Span(number, Tone.STRONG), f"{name.words}, {name.spec.unit}"))
        unit = f"{uncertainty_text(uncertainty)} {name.spec.unit}".strip()
        values.append((Span(name.words), Span(number), Span(unit)))
    return Page(
        Span(f"LAST RUN: {run.outcome_word.upper()}", tone),
        (
            Span(f"{run.subject} {team}".rstrip(), Tone.STRONG),
            Span(f"run {run.run_number}, condition {run.condition}: {task}"),
        ),
        large,
        table=values,
        below=(Span(flags, Tone.WARN), Span(run.closing if run.valid else "")),
    )


def _number(
    name: IndicatorName, value: float | None, uncertainty: Uncertainty | None, sign: str
) -> str:
    text = "-" if value is None else number_text(value, name.spec.decimals, 12, uncertainty)
    return f"{text}{sign}"


def next_page(attempt: PlannedAttempt, snapshot: Snapshot) -> Page:
    """What the plan has next, when, and how late it is."""
    subject, condition = attempt.task
    late = late_words(attempt.time, snapshot.time).removeprefix(", ")
    return Page(
        Span("NEXT", Tone.STRONG),
        (
            Span(f"{subject} {snapshot.teams.names.get(subject, '')}".rstrip(), Tone.STRONG),
            Span(f"condition {condition}: {', '.join(condition_words(condition))}"),
        ),
        [(Span(attempt.time, Tone.STRONG), "planned")] if attempt.time else (),
        below=[Span(late, Tone.WARN)],
    )


def standings_pages(rows: Sequence[Standing], height: int) -> Iterator[Page]:
    room = max(1, height - _ROWS_AROUND)
    titles = ("team", "condition", "runs", *(name.spec.column for name in _INDICATORS))
    signs = any(row.signs(name) for row in rows for name in _INDICATORS)
    for begin in range(0, len(rows), room):
        part = f" {begin // room + 1} of {-(-len(rows) // room)}" if len(rows) > room else ""
        shown = rows[begin : begin + room]
        tasks = {f"{row.condition}: {', '.join(condition_words(row.condition))}" for row in shown}
        below = (
            "; ".join(sorted(tasks)),
            "each team's best run by level, then time; no ranking",
            f"{DOUBTED} doubted" if signs else "",
        )
        yield Page(
            Span(f"STANDINGS{part}", Tone.STRONG),
            table=[[Span(title, Tone.DIM) for title in titles], *map(_standing, shown)],
            below=[Span(text, Tone.DIM) for text in below],
        )


def _standing(row: Standing) -> Sequence[Span]:
    cells = [Span(row.who, Tone.STRONG), Span(f"{row.condition}"), Span(f"{row.counted}")]
    values = (f"{best_text(row, name)}{row.signs(name)}" for name in _INDICATORS)
    return [*cells, *(Span(text, Tone.STRONG) for text in values)]


class WallScreen(Screen[None]):
    """The screen of the wall display; what it shows is its app's."""

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES


class WallApp(MadrobApp, inherit_bindings=False):
    """The console's look and engine link, as a spectator; its only keys leave."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,escape,f10,ctrl+q,ctrl+c", "quit", show=False)
    ]
    COMMANDS = set()  # noqa: RUF012  textual's declaration
    ENABLE_COMMAND_PALETTE = False

    def __init__(
        self,
        open_client: OpenClient,
        defaults: ConsoleDefaults,
        look: ConsoleSettings | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(open_client, defaults, look, monotonic)
        self._history = History(defaults.results)
        self._wall = Wall()
        self._active = monotonic()
        self._read_of: object = None

    def get_default_screen(self) -> Screen[None]:
        return WallScreen()

    def compose(self) -> ComposeResult:
        yield self._wall

    async def show_engine(self) -> None:
        self.set_interval(BUSY_PERIOD, self.poll)
        self.poll()

    def poll(self) -> None:
        """Show the state, or the next page; `_active` is when a run went on, or was begun with."""
        snapshot = self._link.snapshot()
        assert snapshot is not None
        run, wall = snapshot.run, self._wall
        if snapshot.pulse.gone:
            self._link.look_for_engine(partial(self.run_worker, thread=True, group="engine"))
        if run.active:
            self._active = self._monotonic()
        wall.page = int((self._monotonic() - self._active) / PAGE_TIME)
        lists = snapshot.teams, snapshot.plan, snapshot.competition
        basis = (snapshot.result, run.issue, run.closure, *lists, snapshot.practice)
        if basis != self._read_of:
            self._read_of = basis
            self.run_worker(partial(self._read, snapshot), thread=True, exclusive=True)
        wall.show(snapshot)

    def _read(self, snapshot: Snapshot) -> None:
        try:
            every = self._history.refresh()
            runs = of_competition(every, snapshot.competition)
            self._wall.plan = plan_progress(snapshot.plan, every, snapshot.competition)
        except (MadrobError, OSError, MemoryError):
            return  # what was read before stays; the referee's screens say what is wrong
        practice = snapshot.practice
        done = [
            run
            for run in runs
            if run.outcome is not None
            and run.problem is None
            and (run.practice if practice else run.official)
        ]
        latest = max(done, key=lambda run: run.started, default=None)
        self._wall.runs = (
            latest,
            leaders_first(
                standings(runs, official=not practice, best=1, listed=snapshot.teams.names)
            ),
        )
