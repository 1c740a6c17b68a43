"""Lists of teams and runs are read beside the core, and say who may start."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from madrob_console.archive.history import History
from madrob_console.cli.unattended_run import UnattendedRun
from madrob_console.common.errors import MadrobError
from madrob_console.config import Settings
from madrob_console.engine.runtime.list_watch import ListWatch, follow_lists
from madrob_console.pages.tally import overall
from madrob_console.referee.acts import SetUp, Start, Waive
from madrob_console.referee.competition_plan import Plan, PlanSource
from madrob_console.referee.flags import FlagKind
from madrob_console.referee.journal import read_journal
from madrob_console.referee.records import CheckName
from madrob_console.referee.team_list import TeamList, TeamSource
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, FaultyDrive, document, make_setup
from tests.watching import until


def watching(
    file: Path | None, told: list[TeamList], on_change: Callable[[], None] = lambda: None
) -> Callable[[], None]:
    """Looks at a list of teams, as often as a test calls it."""
    watch = ListWatch(file, TeamSource({9: "Own"}, file).read, told.append, on_change)
    watch.read_if_changed()
    assert len(told) == 1
    return watch.read_if_changed


def test_a_list_that_changes_is_told_when_it_rests_and_the_engine_knows_it_first(
    tmp_path: Path,
) -> None:
    file, told, changes = tmp_path / "teams.csv", list[TeamList](), list[int]()
    file.write_text("3,Walkers\n")
    look = watching(file, told, lambda: changes.append(len(told)))
    for text in ("3,Wal", "3,Walkers\n4,Runn", "3,Walkers\n4,Runners\n"):
        file.write_text(text)
        look()  # it has changed: it may change again
    assert (len(told), changes) == (1, [])
    look()
    look()
    assert told[1:] == [TeamList({3: "Walkers", 4: "Runners", 9: "Own"}, (), str(file))]
    assert changes == [2]


def test_a_file_that_goes_is_told_and_its_list_stays_until_another_one_is_there(
    tmp_path: Path,
) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    look = watching(file, told)
    file.unlink()
    for _ in range(5):
        look()
    assert len(told) == 2
    assert told[1].names == told[0].names
    assert "the list stays as it was" in told[1].problems[0]
    for name in ("day 1", "day 2"):
        (tmp_path / name).write_text(f"4,{name}\n")
        (tmp_path / "new").symlink_to(tmp_path / name)
        os.replace(tmp_path / "new", file)  # noqa: PTH105  as `ln -sf` does
        look()
        look()
        assert (told[-1].names, told[-1].problems) == ({4: name, 9: "Own"}, ())


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


REASON = "renamed since"


def test_the_reason_for_another_name_stands_with_the_run(drive: Drive, tmp_path: Path) -> None:
    setup = replace(make_setup(timeout=1.0), team="Runners", team_reason=REASON)
    listed = {setup.subject: "Delft Walkers"}
    drive.engine.set_teams(TeamList(listed))
    drive.whole_run(setup)
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


UNLISTED = "correct the team, or waive the check: 9 is not in the list"
NINE = replace(make_setup(timeout=1.0), subject=9, team="")


def test_an_official_run_of_nobody_in_the_list_starts_only_waived(hall: FaultyDrive) -> None:
    hall.prepare(NINE)
    for names in ({9: "Ghent"}, {3: "Delft Walkers"}):  # the list counts as it is now
        hall.engine.set_teams(TeamList(names))
        checked = [check.name for check in hall.engine.snapshot().checks]
        assert (CheckName.TEAM in checked) is (9 not in names)
    assert hall.engine.perform(Start()) == UNLISTED
    hall.act(Waive(CheckName.TEAM, "a guest"))
    assert hall.check(CheckName.TEAM) == "waived: waived, a guest (9 is not in the list)"
    hall.act(Start())
    hall.finish()
    (waived,) = document(hall.folder)["waivers"]
    assert (waived["check"], waived["reason"]) == ("team", "a guest")


def test_an_unusable_line_of_the_plan_blocks_its_team_until_it_is_mended(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    file, answers = tmp_path / "plan.csv", list[str | None]()
    hall.prepare(make_setup())
    for lines in ('7,"push, from CCW",1\n', '3,"push, from CCW",1\n', "3,1,1\n"):
        file.write_text(lines)
        hall.engine.set_plan(PlanSource(file=file).read())
        answers.append(Start.impossible(hall.engine.situation()))
    words = "correct the plan, or waive the check: plan.csv line 1: condition 'push, from CCW': "
    assert [answer and answer[: len(words)] for answer in answers] == [None, words, None]


def test_what_differs_from_the_settings_is_said_before_the_start(tmp_path: Path) -> None:
    drive, usual = Drive(tmp_path, usual_setup=Settings().usual_setup), Settings().usual_setup
    pose = replace(usual(make_setup()).start_pose, x=1.25)
    drive.prepare(replace(usual(make_setup()), countdown=2.0, start_pose=pose))
    said = "warning: countdown 2 s, the settings say 5 s; start pose 1.25 0 180, the settings say "
    assert drive.check(CheckName.SETTINGS) == f"{said}1.5 0 180: change it in the set-up"
    assert Start.impossible(drive.engine.situation()) is None
    drive.prepare(usual(make_setup()))
    assert CheckName.SETTINGS not in [check.name for check in drive.engine.snapshot().checks]


@pytest.mark.parametrize("waive", [None, "a guest"])
def test_a_run_without_screens_waits_for_no_team_and_takes_the_waiver(
    hall: FaultyDrive, monkeypatch: pytest.MonkeyPatch, waive: str | None
) -> None:
    monkeypatch.setattr(hall.engine, "open", lambda: None)  # it is open
    hall.engine.set_teams(TeamList({3: "Delft Walkers"}))
    run, began = UnattendedRun(hall.engine, None), hall.engine.now()
    go = partial(run.go, lambda simulated: NINE, 20.0, waive)
    if waive is None:
        with pytest.raises(MadrobError, match=re.escape(f"start refused: {UNLISTED}")):
            go()
        assert hall.engine.now() < began + 10.0
    else:
        assert go() is Outcome.TIMEOUT
