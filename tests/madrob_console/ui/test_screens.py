"""Every screen as it was looked at and found good; `pytest --update-screens` stores new ones."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path, PurePath
from typing import ClassVar
from xml.etree import ElementTree as ET

import pyte
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.color import Color, ColorSystem
from rich.console import RenderableType
from rich.segment import Segment
from textual._compositor import Compositor, CompositorUpdate
from textual.app import App, ComposeResult
from textual.containers import Vertical
from textual.screen import Screen

import madrob_console.ui
from madrob_console.common.formatting import format_size, relative_text
from madrob_console.common.names import ThemeName
from madrob_console.referee.acts import AddNote, MarkIncident
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.records import IncidentKind
from madrob_console.referee.team_list import TeamList
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.cells.field import Field
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Lines, Span, Tone, line
from madrob_console.ui.look.themes import THEMES
from madrob_console.ui.look.words import clock_text, fitted, minutes_text, wrapped
from scoring.protocol import Outcome, Side, Step
from scoring.result import value_text
from tests.madrob_console.run_folders import EPOCH, summary
from tests.madrob_console.ui.driver import (
    LARGE,
    SMALL,
    Driver,
    Item,
    Story,
    acting,
    answered,
    driving,
    engine_does,
    follow,
    has,
    passes,
    play,
    sets,
)
from tests.madrob_console.ui.inline_engine import HandEngine, SimulatedEngine
from tests.madrob_console.ui.test_results import DOUBTED, OVER, TEXT

RENDER_UPDATE = Compositor.render_update
STORED = Path(__file__).parent / "screens"
PICTURE = Path(__file__).parents[3] / ".readme" / "live.svg"
SVG = "{http://www.w3.org/2000/svg}"


TEAMS, CONDITIONS = range(1, 13), range(1, 21)
LARGE_PLAN = {
    "plan": Plan(
        tuple(PlanLine(Task(team, condition), 2) for team in TEAMS for condition in CONDITIONS)
    ),
    "teams": TeamList({team: f"Robots of university {team}" for team in TEAMS}),
    "history": [
        summary(
            *(team, condition, run),
            hour=team + condition / 50 + run / 1000,
            values={"capability_level": (team * condition) % 7},
            outcome=Outcome.ABORTED if (team + condition) % 9 == 0 else Outcome.COMPLETED,
        )
        for team in TEAMS
        for condition in CONDITIONS
        for run in (1, 2)
        if team * condition * run < 60
    ],
}
HELD_OPEN = {"angle": 0.52, "force": 7.4, "occupied": {(Side.CCW, 1), (Side.CCW, 3)}}
"""By a robot that stands in the doorway."""
PROTEST = Flag(
    FlagKind.PROTEST, "protest 1 (step 4) OPEN, UNDECIDED", FlagWeight.ALARM, undecided=True
)
LISTED = (
    summary(1, hour=0, final=True, team_word="acknowledged"),
    summary(2, hour=2, protest_filed=EPOCH, protest_at=6.5, flags=(PROTEST,)),
    summary(2, run_number=2, hour=3, final=True, team_word="acknowledged"),
)
TWO_EACH = Plan((PlanLine(Task(1, 7), 2), PlanLine(Task(2, 7), 2)))


def opens_the_door(driver: Driver) -> None:
    """A robot pulls at the handle; 5 s later the door is open."""
    move = driver.engine.move
    move(4.0, lambda _: 0.001, lambda at: 0.4 + 3.1 * at)
    move(1.0, lambda at: 0.03 * at, lambda at: 12.4 - 8 * at)
    move(4.0, lambda at: 0.03 + 1.17 * math.sin(at * math.pi / 8), lambda _: 4.4)
    move(2.0, lambda _: 1.2, lambda _: 0.4)


SCREENS: Mapping[str, tuple[tuple[int, int], Sequence[tuple[Item, str]]]] = {
    "a run from its set-up to its result": (
        (160, 50),
        [
            ("f2 enter", "setup"),
            ("f6 f5", ""),
            (passes(6.0), ""),
            (acting(Driver.do_steps, Step.TOUCH, Step.OPEN), ""),
            (sets(**HELD_OPEN), ""),
            (engine_does(HandEngine.act, MarkIncident(IncidentKind.COLLISION)), ""),
            *[(Driver.settle, "")] * 3,
            (Driver.settle, "live"),
            ("f8", "abort"),
            ("escape", ""),
            (Driver.finish, ""),
            (Driver.settle, "results"),
            ("f1", "help"),
        ],
    ),
    "the course of a run": (
        LARGE,
        [
            ("f2 enter f6 f5", ""),
            (passes(6.0), ""),
            (opens_the_door, ""),
            (sets(occupied={(Side.CCW, 1), (Side.CCW, 2)}), ""),
            *[(Driver.settle, "")] * 14,
            (Driver.settle, "course"),
        ],
    ),
    "a large plan": ((160, 50), [(has(**LARGE_PLAN), ""), (answered("f3 p"), "plan")]),
    "a doubted result": (
        (160, 50),
        [*((deed, "") for (deed,) in DOUBTED), (Driver.settle, "doubts")],
    ),
    "the dialogs and the result of a protest": (
        LARGE,
        [
            *((deed, "") for (deed,) in OVER),
            ("enter P", "protest_about"),
            ("4", "protest_who"),
            (f"1 '={TEXT}' enter", "protest_open"),
            ("enter P", "protest_waits"),
            ("d", "protest_decision"),
            ("escape enter", "protest_unsigned"),
            ("escape enter P d p '=seen on video' enter", "protest_decided"),
        ],
    ),
    "lists with a protest": (
        LARGE,
        [
            (has(history=list(LISTED), plan=TWO_EACH), ""),
            *(
                row
                for key, name in (("h", "history"), ("s", "standings"), ("p", "plan"))
                # the one with a protest
                for row in ((answered(f"escape {key}"), ""), ("down", f"protest_{name}"))
            ),
        ],
    ),
}


@pytest.mark.parametrize("large", [False, True], ids=["small", "large"])
@pytest.mark.parametrize("screens", SCREENS)
async def test_the_screens_are_as_they_were_looked_at(
    screens: str, request: pytest.FixtureRequest, *, large: bool
) -> None:
    largest, rows = SCREENS[screens]
    width, height = largest if large else SMALL
    runs = LISTED if screens == "lists with a protest" else ()
    async with driving(HandEngine(), (width, height), runs=runs) as driver:
        for deed, name in rows:
            await follow(driver, [(deed,)])
            path = STORED / f"{name}_{width}x{height}.txt"
            if name and request.config.getoption("--update-screens"):
                path.write_text(driver.text + "\n")
            assert not name or driver.text + "\n" == path.read_text(), path.name


async def test_picture_of_the_readme_shows_a_real_run(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.setattr(Compositor, "render_update", RENDER_UPDATE)
    async with driving(SimulatedEngine(), LARGE) as driver:
        await driver.press("f2", "enter")
        await driver.let_pass(2.0)
        await driver.press("f7", "f6", "f5")
        for _ in range(17):
            await driver.let_pass(1.0)
        picture = driver.app.export_screenshot(title="madrob console")
    if request.config.getoption("--update-screens"):
        PICTURE.write_text(picture)

    assert words_of(picture) == words_of(PICTURE.read_text())


def words_of(picture: str) -> list[str]:
    """The texts of an SVG, in their order."""
    texts = (element.text or "" for element in ET.fromstring(picture).iter(f"{SVG}text"))
    return [words for text in texts if (words := text.strip())]


async def test_what_is_written_adds_up_to_the_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = pyte.Screen(*SMALL)
    stream = pyte.Stream(terminal)
    display = MadrobApp._display

    def show(app: MadrobApp, screen: Screen[object], update: RenderableType | None) -> None:
        if isinstance(update, CompositorUpdate) and not app._batch_count:
            # a pty makes CR LF of its line feeds
            stream.feed(update.render_segments(app.console).replace("\n", "\r\n"))
        display(app, screen, update)

    monkeypatch.setattr(MadrobApp, "_display", show)
    monkeypatch.setattr(Compositor, "render_update", RENDER_UPDATE)

    def same(driver: Driver) -> bool:
        return [row.rstrip() for row in terminal.display] == driver.rows()

    rows: Story = [
        (Driver.run, same),
        *(
            row
            for tick, key in enumerate(("f2", "f3", "f8", "escape", "question_mark", "f3", "f4"))
            for row in (
                (sets(angle=0.1 * tick, force=3.0 - tick, occupied={(Side.CCW, tick % 5)}),),
                (engine_does(HandEngine.act, AddNote(f"門 event {tick} ❤")),),
                (passes(0.3), same),
                (key, same),
            )
        ),
        (acting(Driver.do_steps, Step.TOUCH),),
        ("f3",),
        (Driver.finish, same),
    ]
    await play(HandEngine, rows)


UI = Path(next(iter(madrob_console.ui.__path__)))
Rgb = tuple[int, int, int]
LEAST = {ThemeName.DARK: 4.5, ThemeName.LIGHT: 4.5, ThemeName.HIGH_CONTRAST: 7.0}


class Tones(Lines):
    """A line in each tone."""

    def lines(self, width: int) -> Sequence[Line]:
        return [line(Span(f"{tone}", tone)) for tone in Tone]


class ConsoleScreen(Screen[None]):
    """Has the name to which the tones are tied, and what text stands on."""

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES

    def compose(self) -> ComposeResult:
        yield Tones()
        yield Vertical(Tones(), classes="surface")
        yield Vertical(Tones(), classes="panel")
        self.chosen, self.other = Field(), Field()
        self.chosen.value, self.other.value = "field in use", "another field"
        yield self.chosen
        yield self.other


class TonesApp(App[None]):
    CSS_PATH: ClassVar[list[str | PurePath]] = [
        UI / "frame" / "console_screen.tcss",
        UI / "cells" / "field.tcss",
        UI / "cells" / "lines.tcss",
    ]
    CSS = """
    .surface { background: $surface; height: auto; }
    .panel { background: $panel; height: auto; }
    """

    def __init__(self) -> None:
        super().__init__()
        for theme in THEMES:
            self.register_theme(theme)

    def get_default_screen(self) -> Screen[None]:
        return ConsoleScreen()


@cache
def drawn() -> dict[str, list[Segment]]:
    """What is not blank on the screen, in each theme."""
    seen = {}

    async def drive() -> None:
        app = TonesApp()
        async with app.run_test(size=(40, 50)) as pilot:
            screen = app.screen
            assert isinstance(screen, ConsoleScreen)
            for theme in THEMES:
                app.theme = theme.name
                screen.set_focus(screen.other)
                screen.set_focus(screen.chosen)  # selects its text
                await pilot.pause()
                segments = [s for row in screen._compositor.render_strips() for s in row]
                await pilot.press("home")
                segments += [s for row in screen._compositor.render_strips() for s in row]
                seen[theme.name] = [s for s in segments if s.text.strip()]

    asyncio.run(drive())
    return seen


def colours(segment: Segment, system: ColorSystem = ColorSystem.TRUECOLOR) -> tuple[Color, Color]:
    """Text and background as a terminal with such colours has them."""
    style = segment.style
    assert style is not None
    assert style.color is not None
    assert style.bgcolor is not None
    pair = style.color.downgrade(system), style.bgcolor.downgrade(system)
    return pair[::-1] if style.reverse else pair


def contrast(one: Rgb, other: Rgb) -> float:
    """As WCAG 2 has it."""
    lighter, darker = sorted((luminance(one), luminance(other)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(rgb: Rgb) -> float:
    red, green, blue = (
        c / 12.92 if (c := v / 255) <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for v in rgb
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_all_tones_and_fields_are_looked_at() -> None:
    for segments in drawn().values():
        texts = {segment.text for segment in segments}
        assert {*Tone, "field in use", "ield in use", "another field"} <= texts
    backgrounds = {colours(segment)[1].name for segment in drawn()["dark"]}
    assert {"#121212", "#1c1c1c", "#262626"} <= backgrounds


@pytest.mark.parametrize("system", [ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT])
def test_every_tone_can_be_read_on_every_background(system: ColorSystem) -> None:
    for name in ThemeName:
        for segment in drawn()[name]:
            text, back = (colour.get_truecolor() for colour in colours(segment, system))
            assert contrast(text, back) >= LEAST[name], (name, segment)


TEXTS = st.text(st.characters(categories=["L", "N", "P", "Zs", "So"]), max_size=60)


@pytest.mark.parametrize(
    ("shown", "text"),
    [
        # a clock never runs ahead
        (clock_text(0.0), "0:00.0"),
        (clock_text(0.3), "0:00.3"),
        (clock_text(59.999), "0:59.9"),
        (clock_text(63.04), "1:03.0"),
        (clock_text(-4.25), "-0:04.2"),
        (clock_text(-0.04), "0:00.0"),
        (clock_text(86400.0), "1440:00.0"),
        # time to go is zero only when none is left
        (minutes_text(300.0), "5:00"),
        (minutes_text(299.2), "5:00"),
        (minutes_text(0.1), "0:01"),
        (minutes_text(0.0), "0:00"),
        (minutes_text(-3.0), "0:00"),
        # times count from the start
        (relative_text(None, 1.0), "-"),
        (relative_text(1.0, None), "-"),
        (relative_text(1_700_000_003.25, 1_700_000_000.0), "3.250"),
        (relative_text(5000.0, 0.0), "5000.0"),
        # sizes have the unit that people read
        (format_size(0), "0 B"),
        (format_size(999), "999 B"),
        (format_size(1000), "1.0 kB"),
        (format_size(99_949), "99.9 kB"),
        (format_size(123_456), "123 kB"),
        (format_size(999_499), "999 kB"),
        (format_size(999_600), "1.0 MB"),
        (format_size(41_000_000_000), "41.0 GB"),
        (format_size(2_500_000_000_000), "2.5 TB"),
        # values keep four decimals
        (value_text(6), "6"),
        (value_text(0.0), "0.0000"),
        (value_text(17.43216), "17.4322"),
        (value_text(0.00123), "1.2300e-03"),
        (value_text(2e7), "2.0000e+07"),
    ],
)
def test_times_sizes_and_values_read_well(shown: str, text: str) -> None:
    assert shown == text


@given(TEXTS, st.integers(1, 40))
def test_a_fitted_text_takes_exactly_its_cells(text: str, width: int) -> None:
    shown = fitted(text, width)
    assert cell_len(shown) == width
    if cell_len(text) > width:
        assert "…" in shown
    else:
        assert shown.rstrip(" ") == text.rstrip(" ")


@given(TEXTS, st.integers(2, 40))
def test_wrapping_loses_nothing_and_stays_inside(text: str, width: int) -> None:
    lines = wrapped(text, width)
    assert all(cell_len(line) <= width for line in lines)
    assert "".join("".join(lines).split()) == "".join(text.split())
