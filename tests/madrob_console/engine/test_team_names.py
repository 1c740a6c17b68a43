"""A team's name comes from the list; another one stands with its reason wherever the run does."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from madrob_console.archive.history import History
from madrob_console.cli.unattended import UnattendedRun
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import SetUp, Start, Waive
from madrob_console.referee.flags import FlagKind
from madrob_console.referee.journal import read_journal
from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import Check, CheckState
from madrob_console.referee.teams import TeamList
from madrob_console.standings.tally import overall
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.test_practice import Rehearsal

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


UNLISTED = "start refused: team: 9 is not in the list: F2 corrects it, w waives"


def test_an_official_run_of_a_team_that_does_not_exist_starts_only_waived(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    hall.engine.hear_of_teams(TeamList({3: "Delft Walkers"}))
    hall.prepare(replace(make_setup(), subject=9, team=""))
    assert f"start refused: {hall.engine.perform(Start())}" == UNLISTED
    hall.act(Waive(CheckName.TEAM, "a guest"), Start())
    hall.finish()
    result = json.loads((hall.folder / "result.json").read_text())
    (waived,) = result["waivers"]
    assert (waived["check"], waived["reason"]) == ("team", "a guest")
    hall.engine.close()


@pytest.mark.parametrize("waive", [None, "a guest"])
def test_a_run_without_screens_waits_for_no_team_and_takes_the_waiver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waive: str | None
) -> None:
    hall = Rehearsal(tmp_path)
    monkeypatch.setattr(hall.engine, "open", lambda: None)  # it is open
    hall.engine.hear_of_teams(TeamList({3: "Delft Walkers"}))
    run, began = UnattendedRun(hall.engine, None), hall.engine.now()
    go = partial(
        run.go, lambda *, simulated: replace(make_setup(), subject=9, team=""), 20.0, waive
    )
    if waive is None:
        with pytest.raises(MadrobError, match=UNLISTED):
            go()
        assert hall.engine.now() < began + 10.0
    else:
        assert go() is Outcome.COMPLETED


def test_practice_and_a_competition_without_a_list_need_no_team(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    unlisted = replace(make_setup(), subject=9, team="")
    hall.prepare(unlisted)
    assert team_check(hall) is None
    hall.engine.hear_of_teams(TeamList({3: "Delft Walkers"}))
    assert team_check(hall) is not None
    hall.prepare(replace(unlisted, practice=True))
    assert team_check(hall) is None
    hall.act(Start())
    hall.engine.close()


def test_the_list_counts_as_it_is_now(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    without, having = TeamList({3: "Delft Walkers"}), TeamList({3: "Delft Walkers", 9: "Ghent"})
    hall.prepare(replace(make_setup(), subject=9, team=""))
    for teams, blocks in ((without, True), (having, False), (without, True)):
        hall.engine.hear_of_teams(teams)
        assert (team_check(hall) is not None) is blocks
    hall.engine.close()


def test_a_run_out_of_plan_starts_only_waived(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    hall.prepare(replace(make_setup(), out_of_plan=True))
    refused = hall.engine.perform(Start())
    assert refused == "team: out of plan: F2 corrects it, w waives"
    hall.act(Waive(CheckName.TEAM, "the organiser agrees"))
    check = team_check(hall)
    assert check is not None
    assert check.state is CheckState.WAIVED
    hall.act(Start())
    hall.engine.close()
