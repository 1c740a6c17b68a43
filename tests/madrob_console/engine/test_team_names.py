"""A team's name comes from the list; another one stands with its reason wherever the run does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from madrob_console.archive.history import History
from madrob_console.referee.acts import SetUp
from madrob_console.referee.flags import FlagKind
from madrob_console.referee.journal import read_journal
from madrob_console.referee.teams import TeamList
from madrob_console.standings.tally import overall
from tests.madrob_console.engine.drive import Drive, make_setup

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
