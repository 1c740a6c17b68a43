"""`madrob watch --big`: the wall display, seen from far away."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from typing import ClassVar

from rich.cells import cell_len
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen

from madrob_console.archive.history import History, of_competition
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import time_of_day
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.competition import late_words
from madrob_console.pages.tally import Standing, leaders_first, standings
from madrob_console.referee.competition_plan import (
    PlannedAttempt,
    PlanProgress,
    plan_progress,
)
from madrob_console.referee.flags import FlagWeight
from madrob_console.referee.run import Phase
from madrob_console.referee.run_summary import RunSummary, condition_words
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.large_text import large_text
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Span, Tone, View, line, width_of
from madrob_console.ui.frame.console_screen import BUSY_PERIOD
from madrob_console.ui.frame.frame_lines import WATCHING, source_badge
from madrob_console.ui.link import ConsoleDefaults, OpenClient
from madrob_console.ui.look.words import fitted, shortened
from madrob_console.ui.panes.run_status import (
    banner,
    clock_span,
    condition_text,
    phase_span,
    step_time,
    team_text,
    who_text,
)
from madrob_console.ui.panes.runs_pane import number_text
from scoring.indicator_table import IndicatorName
from scoring.procedure import UNSETTLED
from scoring.result import DOUBTED, Uncertainty, uncertainty_text

PAGE_TIME = 10.0
"""While nothing runs another page comes after so long, s."""

_BLANK_SHARE = 8
"""One row of so many stays blank, between the blocks."""

_BANDS = {
    Tone.GOOD: Tone.LIVE,
    Tone.WARN: Tone.NOTICE,
    Tone.BAD: Tone.ALARM,
    Tone.STRONG: Tone.CAP,
}
_WAITING = "the engine has ended: what you see is old; waiting for the next one"
_INDICATORS = (IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME)

# A page is made of blocks, each as large as the others leave it room.


@dataclass(frozen=True, slots=True)
class Block:
    """Cells of one size; dim ones are always in ordinary letters.

    Attributes:
        cells: row by row.
        columns: how many cells may be in a row, the most first.
        left: how many columns begin at their left; the others end at their right.
        ahead: by how much its size is ahead of that of other blocks; one that is behind (below 0)
            stops growing with the last of those that are not.
        names: whether the first column may stay in ordinary letters beside the smallest large ones.
    """

    cells: tuple[Span, ...]
    columns: tuple[int, ...] = (1,)
    left: int = 9
    ahead: float = 0.0
    names: bool = False


@lru_cache(maxsize=256)
def draw_block(block: Block, size: int, width: int) -> Sequence[Line]:
    """Its rows in ordinary letters (size 0) or in large ones; none if those do not fit."""
    lines: Sequence[Line] = ()
    for columns, ordinary in product(block.columns, (0, 1)[: 1 + (block.names and size == 1)]):
        drawn = [
            _letters(cell, size if at % columns >= ordinary else 0)
            for at, cell in enumerate(block.cells)
        ]
        lines = [*_rows(block, drawn, columns, " " * max(2, 2 * size))]
        grown = len(lines) * columns > len(block.cells)
        if width_of(lines[0]) <= width and (grown or not size):
            return lines
    return () if size else lines


def _rows(block: Block, drawn: Sequence[Sequence[str]], columns: int, gap: str) -> Iterator[Line]:
    widths = [max(cell_len(cell[0]) for cell in drawn[at::columns]) for at in range(columns)]
    for begin in range(0, len(drawn), columns):
        row = drawn[begin : begin + columns]
        for at in range(height := max(map(len, row))):
            texts = [
                cell[at] if len(cell) == height else cell[0] * (at == height // 2) for cell in row
            ]
            yield tuple(
                Span(
                    gap * (column > 0)
                    + (fitted(text, width) if column < block.left else text.rjust(width)),
                    block.cells[begin + column].tone,
                )
                for column, (text, width) in enumerate(zip(texts, widths, strict=True))
            )


def _letters(cell: Span, size: int) -> Sequence[str]:
    large = large_text(cell.text, size) if size and cell.tone is not Tone.DIM else None
    return large or [cell.text]


def lay_out(blocks: Sequence[Block], width: int, height: int) -> list[Line]:
    """The blocks one below the other; the smallest one grows first, until none has room."""
    drawn = [draw_block(block, 0, width) for block in blocks]
    sizes = dict.fromkeys(range(len(blocks)), 0)
    while any(blocks[at].ahead >= 0 for at in sizes):
        at = min(sizes, key=lambda at: sizes[at] - blocks[at].ahead)
        larger = draw_block(blocks[at], sizes[at] + 1, width)
        rows = sum(map(len, drawn)) - len(drawn[at]) + len(larger)
        if larger and rows <= height - height // _BLANK_SHARE:
            drawn[at], sizes[at] = larger, sizes[at] + 1
        else:
            del sizes[at]
    lines: list[Line] = []
    for at, block in enumerate(drawn):
        spare = height - len(lines) - sum(map(len, drawn[at:]))
        lines += [line()] * (spare // (len(drawn) - at)) + [_centred(row, width) for row in block]
    return lines[:height]


def _centred(row: Line, width: int) -> Line:
    """A row in the middle; a band fills the width."""
    blank = max(0, width - width_of(row))
    tone = row[0].tone if row[0].tone in _BANDS.values() else Tone.PLAIN
    return line(Span(" " * (blank // 2), tone), *row, Span(" " * (blank - blank // 2), tone))


def _band(text: str, tone: Tone, ahead: float = 0.0) -> Block:
    return Block((Span(text, _BANDS[tone]),), ahead=ahead)


def _text(text: str, width: int, tone: Tone = Tone.PLAIN, ahead: float = -0.5) -> list[Block]:
    return [Block((Span(shortened(text, width), tone),), ahead=ahead)] if text else []


# The pages.


class Wall(View):
    """The run while one goes on; else in turn the run, the last result and the standings."""

    runs: tuple[RunSummary | None, Sequence[Standing]] = (None, ())
    plan = PlanProgress()
    page = 0

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        head = _head(snapshot, width)
        room = max(0, self.room.height - len(head))
        latest, standing = self.runs
        pages = [run_page(snapshot, width)]
        if not snapshot.run.active:
            if latest is not None:
                pages.append(result_page(latest, snapshot, width))
            if self.plan.next is not None and not snapshot.practice:
                pages.append(next_page(self.plan.next, snapshot, width))
            pages += standings_pages(standing, width, room)
            if snapshot.run.setup is None:
                pages = pages[1:] or pages
        return [*head, *lay_out(pages[self.page % len(pages)], width, room)]


def _head(snapshot: Snapshot, width: int) -> list[Line]:
    head = line(source_badge(snapshot, max(4, width - 22)), Span(WATCHING, Tone.STRONG))
    clock = time_of_day(snapshot.time).rjust(max(0, width - width_of(head) - 1))
    words = _WAITING if snapshot.pulse.gone else snapshot.pulse.words
    fault = [line(Span(fitted(f" {words}", width), Tone.ALARM))] if words else []
    return [line(*head, Span(clock, Tone.DIM)), *fault]


def run_page(snapshot: Snapshot, width: int) -> list[Block]:
    run = snapshot.run
    what = f"run {run.setup.run_number}, {condition_text(run)}" if run.setup else who_text(run)
    text, tone = banner(snapshot)
    stands = (
        Span("NO ENGINE", Tone.BAD) if snapshot.pulse.gone else phase_span(run, snapshot.result)
    )
    return [
        _band(*stands),
        Block((clock_span(snapshot),), ahead=1.5),
        *_text(team_text(run), width, Tone.STRONG, 0.5),
        *_text(what, width),
        *_text(text if tone is not Tone.PLAIN else "", width, tone),
        Block((*step_cells(snapshot),), (6, 3, 2, 1), ahead=0.4),
    ]


def step_cells(snapshot: Snapshot) -> Iterator[Span]:
    """The six steps: of what is done the time, s from the start, which is marked if rough."""
    running = snapshot.run.phase is Phase.RUNNING
    pending = next((record.step for record in snapshot.steps if not record.done), None)
    for record in snapshot.steps:
        step = record.step
        if record.done:
            rough = snapshot.result is None and step in UNSETTLED
            at = step_time(record.final, snapshot.run.start, rough=rough)
            yield Span(f"✓{step} {at}", Tone.GOOD)
        elif running and step is pending:
            yield Span(f">{step} {step.name}", Tone.WARN)
        else:
            yield Span(f"{'✗' if record.denied else '□'}{step} {step.name}")


def result_page(run: RunSummary, snapshot: Snapshot, width: int) -> list[Block]:
    tone = Tone.GOOD if run.valid and not run.reason else Tone.BAD
    team = snapshot.teams.names.get(run.subject) or run.team
    task = ", ".join(filter(None, condition_words(run.condition)))
    told = [flag.words for flag in run.flags if flag.weight is not FlagWeight.REMARK]
    values, counts = [], []
    for name in IndicatorName:
        known = run.uncertainties.get(name)
        number = _number(name, run.values.get(name), known, run.sign(name))
        counts += [Span(f"{number} {name.spec.unit}", Tone.STRONG)] if name in _INDICATORS else []
        values += [
            Span(name.words),
            Span(number),
            Span(f"{uncertainty_text(known)} {name.spec.unit}".strip()),
        ]
    return [
        _band(f"LAST RUN: {run.outcome_word.upper()}", tone),
        *_text(f"{run.subject} {team}".rstrip(), width, Tone.STRONG, 0.5),
        *_text(f"run {run.run_number}, condition {run.condition}: {task}", width),
        *([Block((*counts[::-1],), (2, 1), ahead=1.5)] if run.valid else []),
        Block((*values,), (3,)),
        *_text("; ".join(told), width, Tone.WARN),
        *_text(run.closing if run.valid else "", width),
    ]


def _number(name: IndicatorName, value: float | None, known: Uncertainty | None, sign: str) -> str:
    text = "-" if value is None else number_text(value, name.spec.decimals, 12, known)
    return f"{text}{sign}"


def next_page(attempt: PlannedAttempt, snapshot: Snapshot, width: int) -> list[Block]:
    """What the plan has next, when, and how late it is."""
    subject, condition = attempt.task
    team = snapshot.teams.names.get(subject, "")
    late = late_words(attempt.time, snapshot.time).removeprefix(", ")
    return [
        _band("NEXT", Tone.STRONG),
        *_text(f"{subject} {team}".rstrip(), width, Tone.STRONG, 0.5),
        *_text(f"condition {condition}: {', '.join(condition_words(condition))}", width),
        *([Block((Span(attempt.time, Tone.STRONG),), ahead=1.5)] if attempt.time else []),
        *_text(late, width, Tone.WARN, 0.5),
    ]


def standings_pages(rows: Sequence[Standing], width: int, height: int) -> Iterator[list[Block]]:
    room = max(1, height - height // _BLANK_SHARE - 5)
    titles = ("team", "condition", "runs", *(name.spec.column for name in _INDICATORS))
    signs = any(row.signs(name) for row in rows for name in _INDICATORS)
    for begin in range(0, len(rows), room):
        part = f" {begin // room + 1} of {-(-len(rows) // room)}" if len(rows) > room else ""
        shown = rows[begin : begin + room]
        cells = [cell for row in shown for cell in _standing(row)]
        tasks = {f"{row.condition}: {', '.join(condition_words(row.condition))}" for row in shown}
        yield [
            _band(f"STANDINGS{part}", Tone.STRONG, -0.5),
            *_text("each team's best run by level, then time; no ranking", width, Tone.DIM),
            Block((*(Span(title, Tone.DIM) for title in titles), *cells), (5,), 1, names=True),
            *_text("; ".join(sorted(tasks)), width, Tone.DIM),
            *_text(f"{DOUBTED} doubted" if signs else "", width, Tone.DIM),
        ]


def _standing(row: Standing) -> Iterator[Span]:
    yield from (Span(row.who), Span(f"{row.condition}"), Span(f"{row.counted}"))
    for name in _INDICATORS:
        found = row.aggregates.get(name)
        mean, known = (None, None) if found is None else (found.mean, found.uncertainty)
        yield Span(_number(name, mean, known, row.signs(name)), Tone.STRONG)


# `madrob watch --big`: the app around the wall display.


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
        seen = (snapshot.result, run.issue, run.closure, *lists, snapshot.practice)
        if seen != self._read_of:
            self._read_of = seen
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
