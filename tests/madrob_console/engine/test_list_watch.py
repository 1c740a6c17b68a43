"""A list, here that of teams, is read again when its file changes, beside the engine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.engine.process.list_watch import ListWatch
from madrob_console.referee.teams import TeamList, TeamSource
from tests.watching import until

NEVER = 1e6
"""A period in which nothing is looked at but by the test, s."""


@contextmanager
def watching(
    file: Path | None, told: list[TeamList], period: float = NEVER
) -> Iterator[ListWatch[TeamList]]:
    watch = ListWatch(TeamSource({9: "Own"}, file), told.append, period)
    try:
        yield watch
    finally:
        watch.close()


def test_the_list_is_there_before_the_engine_goes_on(tmp_path: Path) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    with watching(file, told):
        assert [teams.names for teams in told] == [{3: "Walkers", 9: "Own"}]


def test_without_a_file_the_settings_are_the_list() -> None:
    told = list[TeamList]()
    with watching(None, told):
        assert told == [TeamList({9: "Own"})]


def test_a_list_that_changes_is_told_on_and_the_first_one_is_not(tmp_path: Path) -> None:
    file, told, changes = tmp_path / "teams.csv", list[TeamList](), list[int]()
    file.write_text("3,Walkers\n")
    source = TeamSource({}, file)
    watch = ListWatch(source, told.append, NEVER, lambda: changes.append(len(told)))
    try:
        assert (len(told), changes) == (1, [])
        file.write_text("3,Runners\n")
        watch.look()
        watch.look()
        assert (len(told), changes) == (2, [2])  # the engine knows it first
    finally:
        watch.close()


def test_a_file_that_is_being_written_is_read_when_it_rests(tmp_path: Path) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    with watching(file, told) as watch:
        file.write_text("3,Wal")
        watch.look()  # it has changed: it may change again
        file.write_text("3,Walkers\n4,Runn")
        watch.look()
        file.write_text("3,Walkers\n4,Runners\n")
        watch.look()
        assert len(told) == 1
        watch.look()
        assert told[1:] == [TeamList({3: "Walkers", 4: "Runners", 9: "Own"}, (), str(file))]
        watch.look()
        assert len(told) == 2


def test_a_file_that_goes_and_comes_back_is_told_and_the_list_stays(tmp_path: Path) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    with watching(file, told) as watch:
        file.unlink()
        for _ in range(5):
            watch.look()
        assert len(told) == 2
        assert told[1].names == told[0].names
        assert "the list stays as it was" in told[1].problems[0]
        file.write_text("3,Walkers\n4,Late\n")
        watch.look()
        watch.look()
        assert told[2].names == {3: "Walkers", 4: "Late", 9: "Own"}
        assert told[2].problems == ()


def test_a_link_to_the_list_is_followed_to_another_list(tmp_path: Path) -> None:
    day1, day2, file = tmp_path / "day1.csv", tmp_path / "day2.csv", tmp_path / "teams.csv"
    day1.write_text("3,Walkers\n")
    day2.write_text("4,Runners of day 2\n")
    file.symlink_to(day1)
    told = list[TeamList]()
    with watching(file, told) as watch:
        (tmp_path / "new").symlink_to(day2)
        os.replace(tmp_path / "new", file)  # noqa: PTH105  as `ln -sf` does
        watch.look()
        watch.look()
        assert told[-1].names == {4: "Runners of day 2", 9: "Own"}


@pytest.mark.machine
def test_its_thread_looks_by_itself(tmp_path: Path) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    with watching(file, told, 0.02):
        file.write_text("3,Walkers\n4,Late\n")
        until(lambda: told[-1].names.get(4) == "Late")
