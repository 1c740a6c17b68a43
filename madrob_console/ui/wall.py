"""`madrob watch --big`: the wall display, seen from far away."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen

from madrob_console.archive.history import History, RunSummary, condition_words, of_competition
from madrob_console.common.errors import MadrobError
from madrob_console.pages.competition import SIGNS
from madrob_console.pages.tally import Standing, standings
from madrob_console.referee.flags import weighty
from madrob_console.referee.run import Phase
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.large_text import rows_of, width_of_large
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Span, Tone, View, line, width_of
from madrob_console.ui.frame.console_screen import BUSY_PERIOD
from madrob_console.ui.frame.frame_lines import WATCHING, source_badge
from madrob_console.ui.link import EngineSearch
from madrob_console.ui.look.words import fitted, shortened, time_of_day
from madrob_console.ui.panes.all_faults import banner
from madrob_console.ui.panes.run_status import (
    clock_span,
    in_large,
    phase_span,
    step_time,
    team_text,
)
from madrob_console.ui.panes.runs_pane import number_text
from scoring.indicator_table import IndicatorName
from scoring.procedure import UNSETTLED
from scoring.result import DOUBTED, uncertainty_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from madrob_console.config.tables import ConsoleSettings
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.engine.wire import EngineClient
    from madrob_console.ui.link import ConsoleDefaults, EngineLink

PAGE_TIME = 10.0
"""While nothing runs another page comes after so long, s."""

_STATE_SHARE = 6
_CLOCK_SHARE = 2
"""State and team take one row of so many at most, the clock one of so many."""

_BANDS = {
    Tone.GOOD: Tone.LIVE,
    Tone.WARN: Tone.NOTICE,
    Tone.BAD: Tone.ALARM,
    Tone.STRONG: Tone.CAP,
}
"""Tones of the band over the whole width, by the state's tone."""

_WAITING = "the engine has ended: what you see is old; waiting for the next one"
_NO_ENGINE = Span("NO ENGINE", Tone.BAD)

_INDICATORS = (IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME)


@dataclass(frozen=True, slots=True)
class WallRuns:
    """The last run with a result and all teams' standings by number, read once for many looks."""

    latest: RunSummary | None = None
    standings: Sequence[Standing] = ()

    @classmethod
    def of(
        cls, runs: Sequence[RunSummary], names: Mapping[int, str], *, practice: bool
    ) -> WallRuns:
        done = [
            run
            for run in runs
            if run.outcome is not None
            and run.problem is None
            and (run.practice if practice else run.official)
        ]
        latest = max(done, key=lambda run: run.started, default=None)
        return cls(latest, standings(runs, official=not practice, listed=names))


class Wall(View):
    """The run while one goes on; else in turn the run, the last result and the standings."""

    runs = WallRuns()
    page = 0

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        height = self.room.height
        head = _head(snapshot, width)
        room = max(0, height - len(head))
        pages = [partial(self._run_page, snapshot)]
        if not snapshot.run.active:
            if snapshot.run.setup is None:
                pages.clear()
            if self.runs.latest is not None:
                pages.append(partial(self._result_page, self.runs.latest, snapshot))
            pages += self._standings_pages(room)
        page = pages[self.page % len(pages)] if pages else partial(self._run_page, snapshot)
        return [*head, *page(width, room)][:height]

    def _run_page(self, snapshot: Snapshot, width: int, height: int) -> list[Line]:
        run = snapshot.run
        text, tone = banner(snapshot)
        steps = wall_steps(snapshot, width)
        foot = [line(Span(fitted(text, width), tone))] if text and tone is not Tone.PLAIN else []
        stands = _NO_ENGINE if snapshot.pulse.gone else phase_span(run)
        state = self._band(stands, width, height)
        team = self._large(Span(team_text(run), Tone.STRONG), width, height // _STATE_SHARE)
        left = height - len(state) - len(team) - len(steps) - len(foot) - 4
        clock = self._large(clock_span(snapshot), width, max(height // _CLOCK_SHARE, left))
        lines = [*state, line(), *_centred(clock, width), line(), *_centred(team, width)]
        lines += _centred([line(_condition(snapshot))], width)
        blank = height - len(lines) - len(steps) - len(foot)
        return [*lines, *[line()] * max(0, blank), *foot, *steps]

    def _result_page(
        self, run: RunSummary, snapshot: Snapshot, width: int, height: int
    ) -> list[Line]:
        tone = Tone.GOOD if run.valid and not run.reason else Tone.BAD
        state = self._band(Span(f"LAST RUN: {run.outcome_word.upper()}", tone), width, height)
        name = snapshot.teams.names.get(run.subject) or run.team
        who = Span(f"{run.subject} {name}".rstrip(), Tone.STRONG)
        team = self._large(who, width, height // _STATE_SHARE)
        task = ", ".join(filter(None, condition_words(run.condition)))
        lines = [*state, line(), *_centred(team, width)]
        lines += _centred([line(f"run {run.run_number}, condition {run.condition}: {task}")], width)
        lines += [line(), *_centred(_values(run), width)]
        if told := [flag.words for flag in weighty(run.flags)]:
            text = shortened("; ".join(told), width)
            lines += [line(), *_centred([line(Span(text, Tone.WARN))], width)]
        if run.valid:
            lines += [line(), *_centred([line(Span(run.closing, Tone.DIM))], width)]
        return lines[:height]

    def _standings_pages(self, height: int) -> Iterator[partial[list[Line]]]:
        rows, room = self.runs.standings, max(1, height - 4)
        for begin in range(0, len(rows), room):
            part = f" {begin // room + 1} of {-(-len(rows) // room)}" if len(rows) > room else ""
            title = f"STANDINGS{part}, by team: means of valid runs, no ranking"
            yield partial(_standings, title, rows[begin : begin + room])

    def _band(self, span: Span, width: int, height: int) -> list[Line]:
        rows = self._large(span, width, height // _STATE_SHARE)
        tone = _BANDS[span.tone]
        return [line(Span(_middle(row, width), tone)) for row in rows]

    def _large(self, span: Span, width: int, height: int) -> list[Line]:
        size = 0
        while rows_of(size + 1) <= height and width_of_large(span.text, size + 1) <= width:
            size += 1
        small = [line(Span(shortened(span.text, width), span.tone))]
        return in_large(span, width, size, ascii_only=self.ascii_only) or small


def _head(snapshot: Snapshot, width: int) -> list[Line]:
    clock = Span(f" {time_of_day(snapshot.time)} ", Tone.DIM)
    badge = source_badge(snapshot, max(4, width - 22))
    watching = Span(WATCHING, Tone.STRONG)
    gap = max(0, width - width_of((badge, watching, clock)))
    first = line(badge, watching, " " * gap, clock)
    pulse = snapshot.pulse
    words = _WAITING if pulse.gone else pulse.words
    return [first, line(Span(fitted(f" {words}", width), Tone.ALARM))] if words else [first]


def _condition(snapshot: Snapshot) -> str:
    setup = snapshot.run.setup
    if setup is None:
        return "no run is set up"
    condition = setup.condition
    what = f"condition {condition.number}: {condition.way}, {condition.benchmark_type}"
    return f"run {setup.run_number}, {what}"


def wall_steps(snapshot: Snapshot, width: int) -> list[Line]:
    """The six steps in as few rows as they need; times that may still change are marked."""
    steps, start = snapshot.steps, snapshot.run.start
    pending = next((record.step for record in steps if not record.done), None)
    cells = []
    for record in steps:
        mark = "✓" if record.done else "x" if record.denied else " "
        if record.step is pending and snapshot.run.phase is Phase.RUNNING:
            mark = ">"
        rough = snapshot.result is None and record.step in UNSETTLED
        at = f" {step_time(record.final, start, rough=rough)}" if record.done else ""
        tone = Tone.GOOD if record.done else Tone.STRONG if mark == ">" else Tone.DIM
        cells.append(Span(f"{mark} {record.step} {record.step.text}{at}", tone))
    each = 30
    in_a_row = max(1, min(6, width // each))
    while 6 % in_a_row:
        in_a_row -= 1
    each = width // in_a_row
    padded = [Span(f"{shortened(text, each - 1):<{each}}", tone) for text, tone in cells]
    return [tuple(padded[at : at + in_a_row]) for at in range(0, 6, in_a_row)]


def _values(run: RunSummary) -> list[Line]:
    rows, spread = [], any(map(uncertainty_text, run.uncertainties.values()))
    for name in IndicatorName:
        value = run.values.get(name)
        spec = name.spec
        known = run.uncertainties.get(name)
        text = "-" if value is None else number_text(value, spec.decimals, 12, known)
        rows.append(
            line(
                f"{name.words:>32}  ",
                Span(f"{text:>12}", Tone.STRONG),
                Span(f"{run.sign(name):<2}", Tone.WARN),
                f"{uncertainty_text(known):<10}" if spread else "",
                f"{spec.unit:<8}",
            )
        )
    if run.doubts:
        rows.append(line(Span(f"{'':>32}  {DOUBTED} doubted", Tone.WARN)))
    return rows


def _standings(title: str, rows: Sequence[Standing], width: int, _height: int) -> list[Line]:
    task = 34 if width >= 110 else 0
    numbers = [f"{'runs':>5}", *(f"{name.spec.column:>8}{'':3}" for name in _INDICATORS)]
    team = max(10, width - 14 - task - sum(map(len, numbers)) - 4)
    titles = f"{numbers[0]}  {''.join(numbers[1:])}"
    head = f" {fitted('team', team)} {'condition':<9}{'':<{task}}  {titles}"
    lines = [line(Span(fitted(f" {title}", width), Tone.CAP)), line(Span(head, Tone.DIM))]
    for row in rows:
        cells = [f"{row.counted:>5}"]
        for name in _INDICATORS:
            found = row.aggregates.get(name)
            value = (
                "-"
                if found is None
                else number_text(found.mean, name.spec.decimals, 8, found.uncertainty)
            )
            cells.append(f"{value:>8}{row.signs(name):<3}")
        words = fitted(", ".join(condition_words(row.condition)), task - 2) + "  " if task else ""
        values = f"{cells[0]}  {''.join(cells[1:])}"
        text = f" {fitted(row.who, team)} {row.condition:>5}    {words}  {values}"
        lines.append(line(fitted(text, width)))
    if any(row.signs(name) for row in rows for name in _INDICATORS):
        lines.append(line(Span(fitted(f" {SIGNS}", width), Tone.DIM)))
    return lines


def _middle(row: Line, width: int) -> str:
    text = "".join(span.text for span in row)
    gap = max(0, width - width_of(row))
    return f"{' ' * (gap // 2)}{text}{' ' * (gap - gap // 2)}"


def _centred(rows: Sequence[Line], width: int) -> list[Line]:
    widest = max((width_of(row) for row in rows), default=0)
    return [line(" " * max(0, (width - widest) // 2), *row) for row in rows]


# The screen of the wall display.


class WallScreen(Screen[None]):
    """Only the wall display; it takes only the keys that leave. `load` is called in a thread."""

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,escape,f10,ctrl+q,ctrl+c", "app.quit", show=False)
    ]
    AUTO_FOCUS = ""

    def __init__(
        self,
        link: EngineLink,
        load: Callable[[], Sequence[RunSummary]],
        monotonic: Callable[[], float],
    ) -> None:
        super().__init__()
        self._link = link
        aside = partial(self.run_worker, thread=True, group="engine")
        self._search = EngineSearch(link, monotonic, aside)
        self._load = load
        self._monotonic = monotonic
        self._turned = monotonic()
        self._read_of: object = None
        self._wall = Wall()

    def compose(self) -> ComposeResult:
        yield self._wall

    def begin_polling(self) -> None:
        self.set_interval(BUSY_PERIOD, self.poll)
        self.poll()

    def poll(self) -> None:
        snapshot = self._link.snapshot()
        if snapshot is None:
            return
        if snapshot.pulse.gone:
            self._search.look_for_engine()
        run = snapshot.run
        if run.active:
            self._wall.page, self._turned = 0, self._monotonic()
        elif (now := self._monotonic()) - self._turned >= PAGE_TIME:
            self._wall.page += 1
            self._turned = now
        seen = (snapshot.result, run.issue, run.closure, snapshot.teams, snapshot.practice)
        if seen != self._read_of:
            self._read_of = seen
            self.run_worker(partial(self._read, snapshot), thread=True, exclusive=True)
        self._wall.show(snapshot)

    def _read(self, snapshot: Snapshot) -> None:
        try:
            runs = self._load()
        except (MadrobError, OSError, MemoryError):
            return  # what was read before stays; the referee's screens say what is wrong
        self._wall.runs = WallRuns.of(runs, snapshot.teams.names, practice=snapshot.practice)


# `madrob watch --big`: the app around the wall display.


class WallApp(MadrobApp, inherit_bindings=False):
    """The console's look and engine link, another screen, no keys; connects as a spectator."""

    BINDINGS: ClassVar[list[BindingType]] = []
    COMMANDS = set()  # noqa: RUF012  textual's declaration
    ENABLE_COMMAND_PALETTE = False

    def __init__(
        self,
        open_client: Callable[[], EngineClient],
        defaults: ConsoleDefaults,
        look: ConsoleSettings | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(open_client, defaults, look, monotonic)
        history = History(defaults.results)
        self._wall = WallScreen(
            self._link,
            lambda: of_competition(history.refresh(), defaults.competition),
            self._monotonic,
        )

    def get_default_screen(self) -> Screen[None]:
        return self._wall

    async def show_engine(self) -> None:
        self._wall.begin_polling()
