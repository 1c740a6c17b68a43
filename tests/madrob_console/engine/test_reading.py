"""What only reads is read beside the core, and tells what came of it when asked to."""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from madrob_console.archive.history import History
from madrob_console.cli.session import UnattendedRun
from madrob_console.common.errors import MadrobError
from madrob_console.engine.disk import ENDED, FULL, DiskThread, RepeatedReading
from madrob_console.engine.engine_thread import ListWatch, follow_lists
from madrob_console.pages.tally import overall
from madrob_console.referee.acts import SetUp, Start, Waive
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.competition_plan import Plan, PlanSource
from madrob_console.referee.flags import FlagKind
from madrob_console.referee.journal import read_journal
from madrob_console.referee.lists import TeamList, TeamSource
from madrob_console.referee.records import CheckName
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, Rehearsal, make_setup
from tests.watching import PATIENCE, until


@pytest.mark.machine
def test_the_referees_readings_go_before_the_others_and_too_many_are_refused() -> None:
    reading, go_on, order = DiskThread("reading", most_jobs=5), threading.Event(), list[int]()

    def asked(number: int, *, first: bool = False) -> Future[int]:
        def read() -> int:
            assert go_on.wait(PATIENCE)
            order.append(number)
            return number

        return reading.submit_job(read, first=first)

    hangs = asked(0)
    until(hangs.running)
    others = [asked(100 + number) for number in range(5)]
    with pytest.raises(MadrobError, match=FULL):
        asked(105).result(PATIENCE)
    referees = [asked(number, first=True) for number in (1, 2)]
    assert others[0].cancel()
    go_on.set()
    assert [one.result(PATIENCE) for one in (hangs, *referees, *others[1:])] == order
    reading.close(PATIENCE)


@pytest.mark.machine
def test_whoever_waits_for_a_reading_that_hangs_is_told_when_the_engine_ends() -> None:
    reading, go_on = DiskThread("reading"), threading.Event()
    hangs = reading.submit_job(lambda: go_on.wait(PATIENCE))
    until(hangs.running)
    waits = reading.submit_job(lambda: 7, first=False)
    reading.close(0.0)
    with pytest.raises(MadrobError, match=ENDED):
        waits.result(PATIENCE)
    go_on.set()


NEVER = 1e6
"""A period in which nothing is looked at but by the test, s."""


def watching(file: Path | None, told: list[TeamList]) -> ListWatch[TeamList]:
    watch = ListWatch(file, TeamSource({9: "Own"}, file).read, told.append)
    watch.read_if_changed()
    return watch


def test_without_a_file_the_settings_are_the_list() -> None:
    told = list[TeamList]()
    watching(None, told)
    assert told == [TeamList({9: "Own"})]


def test_a_list_that_changes_is_told_on_and_the_first_one_is_not(tmp_path: Path) -> None:
    file, told, changes = tmp_path / "teams.csv", list[TeamList](), list[int]()
    file.write_text("3,Walkers\n")
    read = TeamSource({}, file).read
    watch = ListWatch(file, read, told.append, lambda: changes.append(len(told)))
    watch.read_if_changed()
    assert (len(told), changes) == (1, [])
    file.write_text("3,Runners\n")
    watch.read_if_changed()
    watch.read_if_changed()
    assert (len(told), changes) == (2, [2])  # the engine knows it first


def test_a_file_that_is_being_written_is_read_when_it_rests(tmp_path: Path) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    watch = watching(file, told)
    file.write_text("3,Wal")
    watch.read_if_changed()  # it has changed: it may change again
    file.write_text("3,Walkers\n4,Runn")
    watch.read_if_changed()
    file.write_text("3,Walkers\n4,Runners\n")
    watch.read_if_changed()
    assert len(told) == 1
    watch.read_if_changed()
    assert told[1:] == [TeamList({3: "Walkers", 4: "Runners", 9: "Own"}, (), str(file))]
    watch.read_if_changed()
    assert len(told) == 2


def test_a_file_that_goes_and_comes_back_is_told_and_the_list_stays(tmp_path: Path) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    watch = watching(file, told)
    file.unlink()
    for _ in range(5):
        watch.read_if_changed()
    assert len(told) == 2
    assert told[1].names == told[0].names
    assert "the list stays as it was" in told[1].problems[0]
    file.write_text("3,Walkers\n4,Late\n")
    watch.read_if_changed()
    watch.read_if_changed()
    assert told[2].names == {3: "Walkers", 4: "Late", 9: "Own"}
    assert told[2].problems == ()


def test_a_link_to_the_list_is_followed_to_another_list(tmp_path: Path) -> None:
    day1, day2, file = tmp_path / "day1.csv", tmp_path / "day2.csv", tmp_path / "teams.csv"
    day1.write_text("3,Walkers\n")
    day2.write_text("4,Runners of day 2\n")
    file.symlink_to(day1)
    told = list[TeamList]()
    watch = watching(file, told)
    (tmp_path / "new").symlink_to(day2)
    os.replace(tmp_path / "new", file)  # noqa: PTH105  as `ln -sf` does
    watch.read_if_changed()
    watch.read_if_changed()
    assert told[-1].names == {4: "Runners of day 2", 9: "Own"}


@pytest.mark.machine
def test_the_lists_are_there_before_the_engine_goes_on_and_are_followed(tmp_path: Path) -> None:
    told, plans = list[TeamList](), list[Plan]()
    teams, plan = tmp_path / "teams.csv", tmp_path / "plan.csv"
    teams.write_text("3,Walkers\n")
    plan.write_text("3,1,2\n")
    close = follow_lists(
        (
            ListWatch(teams, TeamSource({9: "Own"}, teams).read, told.append),
            ListWatch(plan, PlanSource((), plan).read, plans.append),
        ),
        0.02,
    )
    try:
        assert [teams.names for teams in told] == [{3: "Walkers", 9: "Own"}]
        assert len(plans) == 1
        teams.write_text("3,Walkers\n4,Late\n")
        plan.write_text("3,1,3\n")
        until(lambda: told[-1].names.get(4) == "Late" and len(plans) == 2)
    finally:
        close()


class Archive:
    """A value that is read when a test says so."""

    def __init__(self, *, forgets: bool) -> None:
        self.asked: list[Future[str]] = []
        self.reading = RepeatedReading(str, self.submit, NEVER, "unknown", forgets=forgets)

    def submit(self, _job: Callable[[], str], done: Callable[[Future[str]], None]) -> None:
        self.asked.append(Future())
        self.asked[-1].add_done_callback(done)


def test_a_value_is_read_again_after_a_change_and_after_a_while_one_reading_at_a_time() -> None:
    archive = Archive(forgets=False)
    look = archive.reading.look
    assert look(0.0, "a result") == "unknown"
    archive.asked[-1].set_result("first")
    assert look(1.0, "a result") == "first"
    assert len(archive.asked) == 1
    assert look(1.0, "another") == look(2.0, "a third") == "first"  # the reading goes on
    assert len(archive.asked) == 2
    archive.asked[-1].set_result("second")
    assert look(2.0, "another") == "second"
    look(NEVER + 1.0, "another")
    assert len(archive.asked) == 3


@pytest.mark.parametrize("forgets", [False, True])
def test_a_value_that_cannot_be_read_is_forgotten_where_an_old_one_says_nothing(
    forgets: bool,
) -> None:
    archive, kept = Archive(forgets=forgets), "unknown" if forgets else "known"
    look = archive.reading.look
    look(0.0)
    archive.asked[-1].set_result("known")
    look(NEVER)
    assert look(NEVER + 1.0) == "known"  # its answer is not late yet
    assert look(2 * NEVER) == kept
    archive.asked[-1].set_exception(MadrobError("the disk is away"))
    assert look(2 * NEVER) == kept
    archive.asked[-1].set_result("known again")
    assert archive.reading.value == "known again"


REASON = "renamed since"


def test_the_engine_takes_no_name_beside_the_list_without_a_reason(tmp_path: Path) -> None:
    drive, setup = Drive(tmp_path), make_setup()
    assert drive.engine.perform(SetUp(setup)) is None  # no list: names are free
    teams = TeamList({setup.subject: "Delft Walkers"})
    drive.engine.hear_of_teams(teams)
    assert drive.engine.snapshot().teams == teams
    refused = drive.engine.perform(SetUp(setup))
    assert refused is not None
    assert "'Delft Walkers' in the list of teams: another name needs a reason" in refused
    assert drive.engine.perform(SetUp(replace(setup, team="Delft Walkers"))) is None
    assert drive.engine.perform(SetUp(replace(setup, subject=9, team=""))) is None
    assert drive.engine.perform(SetUp(replace(setup, subject=9))) is not None
    assert drive.engine.perform(SetUp(replace(setup, team_reason=REASON))) is None
    drive.engine.close()


def test_the_reason_for_another_name_stands_with_the_run(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    setup = replace(make_setup(), team="Runners", team_reason=REASON)
    listed = {setup.subject: "Delft Walkers"}
    drive.engine.hear_of_teams(TeamList(listed))
    drive.start(setup)
    drive.finish()
    drive.engine.close()
    first, *_ = read_journal(drive.folder / "journal.jsonl")[0]
    assert (first.what, first.reason) == (SetUp.name, REASON)
    result = json.loads((drive.folder / "result.json").read_text())
    assert (result["team"], result["setup"]["team_reason"]) == ("Runners", REASON)
    (run,) = History(tmp_path).refresh()
    (flag,) = (flag for flag in run.flags if flag.kind is FlagKind.OTHER_NAME)
    assert flag.words == f"team's name other than the list's: {REASON}"
    (team,) = overall([run], official=run.official, listed=listed)
    assert (team.team, team.other_names) == ("Delft Walkers", ("Runners",))


def team_check(drive: Drive) -> Check | None:
    checks = drive.engine.snapshot().checks
    return next((check for check in checks if check.name is CheckName.TEAM), None)


UNLISTED = "start refused: F2 corrects the team: 9 is not in the list (Enter waives)"


def test_an_official_run_of_a_team_that_does_not_exist_starts_only_waived(hall: Rehearsal) -> None:
    hall.engine.hear_of_teams(TeamList({3: "Delft Walkers"}))
    hall.prepare(replace(make_setup(), subject=9, team=""))
    assert f"start refused: {hall.engine.perform(Start())}" == UNLISTED
    hall.act(Waive(CheckName.TEAM, "a guest"), Start())
    hall.finish()
    result = json.loads((hall.folder / "result.json").read_text())
    (waived,) = result["waivers"]
    assert (waived["check"], waived["reason"]) == ("team", "a guest")


@pytest.mark.parametrize("waive", [None, "a guest"])
def test_a_run_without_screens_waits_for_no_team_and_takes_the_waiver(
    hall: Rehearsal, monkeypatch: pytest.MonkeyPatch, waive: str | None
) -> None:
    monkeypatch.setattr(hall.engine, "open", lambda: None)  # it is open
    hall.engine.hear_of_teams(TeamList({3: "Delft Walkers"}))
    run, began = UnattendedRun(hall.engine, None), hall.engine.now()
    go = partial(
        run.go, lambda *, simulated: replace(make_setup(), subject=9, team=""), 20.0, waive
    )
    if waive is None:
        with pytest.raises(MadrobError, match=re.escape(UNLISTED)):
            go()
        assert hall.engine.now() < began + 10.0
    else:
        assert go() is Outcome.COMPLETED


def test_practice_and_a_competition_without_a_list_need_no_team(hall: Rehearsal) -> None:
    unlisted = replace(make_setup(), subject=9, team="")
    hall.prepare(unlisted)
    assert team_check(hall) is None
    hall.engine.hear_of_teams(TeamList({3: "Delft Walkers"}))
    assert team_check(hall) is not None
    hall.prepare(replace(unlisted, practice=True))
    assert team_check(hall) is None
    hall.act(Start())


def test_the_list_counts_as_it_is_now(hall: Rehearsal) -> None:
    without, having = TeamList({3: "Delft Walkers"}), TeamList({3: "Delft Walkers", 9: "Ghent"})
    hall.prepare(replace(make_setup(), subject=9, team=""))
    for teams, blocks in ((without, True), (having, False), (without, True)):
        hall.engine.hear_of_teams(teams)
        assert (team_check(hall) is not None) is blocks


def test_a_run_out_of_plan_starts_only_waived(hall: Rehearsal) -> None:
    hall.prepare(replace(make_setup(), out_of_plan=True))
    refused = hall.engine.perform(Start())
    assert refused == "F2 corrects the team: this run is out of plan (Enter waives)"
    hall.act(Waive(CheckName.TEAM, "the organiser agrees"))
    check = team_check(hall)
    assert check is not None
    assert check.state is CheckState.WAIVED
    hall.act(Start())
