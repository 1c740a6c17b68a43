"""The team of a set-up comes from the list of teams; another name needs a reason."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

import pytest

from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.teams import NO_TEAMS, TeamList
from madrob_console.ui.cells.field import Field
from madrob_console.ui.defaults import ConsoleDefaults
from madrob_console.ui.panes.team_picker import matching
from tests.madrob_console.ui.driver import DEFAULTS, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

LONG = "The Very Long Name of a Team that Goes On to Sixty Letters!!"
NAMES = {
    1: "Delft Walkers",
    2: "門の騎士とロボットの会",
    3: "Équipe Müller",
    13: "Team 3",
    31: LONG,
}
MANY = {number: f"Team {number}" for number in range(1, 201)}


@pytest.fixture
def engine() -> FakeEngine:
    return FakeEngine(teams=TeamList(NAMES))


def setup_of(engine: FakeEngine) -> RunSetup:
    assert engine.run.setup is not None
    return engine.run.setup


def team(driver: Driver) -> str:
    """What stands in the row of the team."""
    (row,) = [row for row in driver.rows() if row.startswith(" Team (/ list)")]
    return row[15:34].strip()


def found(driver: Driver) -> Sequence[str]:
    """The rows of the picker."""
    rows = [row.strip() for row in driver.rows()]
    begin = next(number for number, row in enumerate(rows) if row.startswith("sub"))
    end = next(n for n, row in enumerate(rows) if " of " in row and n > begin and "by sub" in row)
    return [" ".join(row.split()) for row in rows[begin + 1 : end] if row]


@pytest.mark.parametrize(
    ("text", "subjects"),
    [
        ("", [1, 2, 3, 13, 31]),
        ("3", [3, 31]),
        ("003", [3, 31]),
        ("13", [13]),
        ("99", []),
        ("MULLER", [3]),
        ("equipe mü", [3]),
        ("walk delft", [1]),
        ("騎士", [2]),
        ("team", [13, 31]),
        ("nobody", []),
    ],
)
def test_a_search_finds_numbers_by_their_beginning_and_names_by_their_parts(
    text: str, subjects: list[int]
) -> None:
    assert [team.subject for team in matching(NAMES, text)] == subjects


def test_a_number_that_no_team_has_is_looked_for_in_the_names() -> None:
    assert [team.subject for team in matching({1: "Robots 2026"}, "2026")] == [1]


def test_the_name_of_the_list_stands_there_as_the_number_is_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            assert team(driver) == "Delft Walkers"
            await driver.type("3")
            assert team(driver) == "Équipe Müller"
            await driver.type("1")
            assert team(driver).startswith("The Very Long")
            await driver.type("1")
            assert team(driver) == "(not in the list)"
            await driver.press("enter")
            assert (setup_of(engine).subject, setup_of(engine).team) == (311, "")
            assert "x team failed 311 is not in the list: F2 corrects it" in " ".join(
                driver.text.split()
            )

    asyncio.run(drive())


@pytest.mark.parametrize("where", [(), ("tab",), ("tab", "tab"), ("escape",)])
def test_slash_asks_for_the_list_from_everywhere_but_a_name(
    engine: FakeEngine, where: tuple[str, ...]
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press(*where, "slash")
            assert "Teams: 5" in driver.text
            await driver.type("muller")
            assert found(driver)[0] == "> 3 Équipe Müller"
            await driver.press("enter")
            assert (setup_of(engine).subject, setup_of(engine).team) == (3, "Équipe Müller")
            assert setup_of(engine).team_reason == ""
            await driver.press("f6")
            assert engine.run.pose_confirmed

    asyncio.run(drive())


def test_a_slash_in_a_name_is_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab", "tab", "slash")
            assert "Teams: " not in driver.text
            assert driver.console.query_one("#referee", Field).value == "/"

    asyncio.run(drive())


def test_what_is_typed_on_the_team_looks_for_a_team_and_is_no_key(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab")
            await driver.pilot.press(*"next", "space", *"team")  # n, e, x, t are keys elsewhere
            await driver.settle()
            assert driver.console.query_one("#team-search", Field).value == "next team"
            assert engine.acts == []
            assert not driver.console.dialogs

    asyncio.run(drive())


def test_arrows_go_through_the_list_and_escape_leaves_it_as_it_was(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("slash", "down", "down")
            assert found(driver)[2] == "> 3 Équipe Müller"
            await driver.press("escape")
            assert team(driver) == "Delft Walkers"
            assert engine.acts == []
            await driver.press("slash", "down", "enter")
            assert setup_of(engine).subject == 2

    asyncio.run(drive())


@pytest.mark.parametrize("size", [(80, 24), (60, 18), (120, 36)])
def test_two_hundred_teams_are_shown_page_by_page(size: tuple[int, int]) -> None:
    engine = FakeEngine(teams=TeamList(MANY))

    async def drive() -> None:
        async with driving(engine, size=size) as driver:
            await driver.press("slash")
            rows = found(driver)
            assert len(rows) >= 4
            assert "of 201, by subject" in driver.text  # and one for another name
            await driver.press("pagedown")
            assert found(driver)[0] != rows[0]
            await driver.type("team 177")
            assert found(driver)[0] == "> 177 Team 177"
            await driver.press("enter")
            assert setup_of(engine).subject == 177

    asyncio.run(drive())


@pytest.mark.parametrize("size", [(80, 24), (60, 18)])
@pytest.mark.parametrize("number", [2, 31])
def test_a_long_name_is_shown_whole_before_it_is_taken(size: tuple[int, int], number: int) -> None:
    engine = FakeEngine(teams=TeamList(NAMES))

    async def drive() -> None:
        async with driving(engine, size=size) as driver:
            await driver.press("slash")
            await driver.type(str(number))
            assert f"{number} {NAMES[number]}" in " ".join(driver.text.split())

    asyncio.run(drive())


def test_another_name_is_asked_about_and_its_reason_stands_with_the_set_up(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("slash")
            await driver.type("Delft Runners")
            assert found(driver) == ["> - another name for subject 1: Delft Runners"]
            await driver.press("enter")
            assert "ANOTHER NAME for subject 1: it is Delft Walkers in the list" in driver.text
            await driver.press("enter", "2")
            assert setup_of(engine).team == "Delft Runners"
            assert setup_of(engine).team_reason == "renamed since"
            assert team(driver).endswith("OTHER")
            assert "Other name than the list's: renamed since." in " ".join(driver.text.split())
            await driver.press("f6")
            assert engine.run.pose_confirmed

    asyncio.run(drive())


@pytest.mark.parametrize("keys", [("escape",), ("enter", "enter"), ("enter", "escape")])
def test_without_a_reason_the_name_stays_that_of_the_list(
    engine: FakeEngine, keys: tuple[str, ...]
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter", "slash")
            await driver.type("Runners")
            await driver.press("enter", *keys)
            assert not driver.console.dialogs
            assert team(driver) == "Delft Walkers"
            assert setup_of(engine).team == "Delft Walkers"

    asyncio.run(drive())


def test_clearing_gives_the_lists_name_back(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("slash")
            await driver.type("Runners")
            await driver.press("enter", "enter", "1")
            assert setup_of(engine).team == "Runners"
            await driver.press("f2", "tab", "tab", "delete")
            assert team(driver) == "Delft Walkers"
            assert setup_of(engine).team == "Delft Walkers"
            assert setup_of(engine).team_reason == ""

    asyncio.run(drive())


def test_another_name_is_of_its_subject_alone(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("slash")
            await driver.type("Runners")
            await driver.press("enter", "enter", "1", "f2")
            await driver.type("2")
            await driver.press("enter")
            assert setup_of(engine).team == NAMES[2]
            await driver.press("f2")
            await driver.type("1")
            await driver.press("enter")
            assert setup_of(engine).team == NAMES[1]

    asyncio.run(drive())


def test_another_name_stays_for_the_next_run_of_the_team(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("slash")
            await driver.type("Runners")
            await driver.press("enter", "enter", "1", "f6", "f5")
            await driver.let_pass(6.0)
            engine.finish()
            await driver.settle()
            await driver.press("f", "a", "enter", "x")
            assert setup_of(engine).run_number == 2
            assert setup_of(engine).team == "Runners"
            assert setup_of(engine).team_reason == "the list is wrong"

    asyncio.run(drive())


def test_a_list_that_changes_is_taken_at_once(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter", "f6")
            engine.teams = TeamList({**NAMES, 1: "Delft Walkers II"})
            await driver.settle()
            assert "The list of teams was read again: 5 teams" in driver.console.status
            assert team(driver).startswith("Delft Walkers II")
            assert "Not set up yet" in driver.text
            await driver.press("f5")
            assert setup_of(engine).team == "Delft Walkers II"
            assert engine.run.phase is Phase.READY  # its pose was confirmed for the other
            engine.teams = replace(engine.teams, problems=("teams file t.csv: it names no team",))
            await driver.settle()
            assert "teams file t.csv: it names no team" in driver.console.status
            await driver.press("tab")
            assert "! teams  teams file t.csv: it names no team" in driver.text

    asyncio.run(drive())


def test_without_a_list_the_name_is_typed_and_slash_says_how_to_get_one() -> None:
    engine = FakeEngine()

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("slash")
            assert "There is no list of teams, names are free." in " ".join(driver.text.split())
            await driver.press("enter", "escape", "f2", "tab", "tab")
            await driver.type("Any Name")
            await driver.press("enter")
            assert setup_of(engine).team == "Any Name"

    asyncio.run(drive())


def test_a_list_that_comes_while_a_name_is_typed_sends_no_letter_into_another_field() -> None:
    engine = FakeEngine(teams=NO_TEAMS)

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("tab", "tab")
            await driver.type("Del")
            engine.teams = TeamList(NAMES)
            await driver.settle()
            await driver.type("ft")
            assert driver.console.query_one("#referee", Field).value == DEFAULTS.referee
            assert driver.console.query_one("#team-search", Field).value == "ft"

    asyncio.run(drive())


def test_another_pane_closes_the_list(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine, defaults=ConsoleDefaults()) as driver:
            await driver.press("slash", "f3", "f2")
            assert "Teams: " not in driver.text
            assert driver.app.focused is not None
            assert driver.app.focused.id == "subject"

    asyncio.run(drive())
