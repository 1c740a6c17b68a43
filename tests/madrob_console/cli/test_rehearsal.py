"""A rehearsal: as the competition, on a simulated testbed too, and never beside it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest

from madrob_console.archive.folders import REPORT_FILE, RESULT_FILE, rehearsal_folder
from madrob_console.archive.history import History
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.referee.competition_plan import Plan, PlanLine, Task, plan_progress
from madrob_console.referee.lists import TeamList
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.referee.run_summary import RunSummary
from tests.madrob_console.engine.drive import Drive, OfficialDrive, make_setup, signed

CUP, NAMED = "Cup", "REHEARSAL Cup"
SETTINGS = '[competition]\nname = "Cup"\n[results]\nfolder = "~/runs"\npublish = "~/site"\n'


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    settings = tmp_path / "config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(SETTINGS)
    return tmp_path


@pytest.fixture
def hall(home: Path) -> Iterator[Drive]:
    """A simulated testbed that says so, after one run of team 3."""
    hall = Drive(home / "runs_rehearsal", competition=NAMED)
    hall.whole_run(make_setup())
    yield hall
    hall.engine.close()


def official_run(home: Path) -> Path:
    hall = OfficialDrive(home / "runs", competition=CUP)
    hall.whole_run(make_setup())
    hall.engine.close()
    return hall.folder


def listed(results: Path) -> RunSummary:
    (run,) = History(results).refresh()
    return run


def test_its_run_goes_through_all_that_an_official_one_does(hall: Drive, home: Path) -> None:
    engine = hall.engine
    plan = Plan((PlanLine(Task(3, 1), 2),))
    hall.act(signed(engine.snapshot()))
    assert engine.run.phase is Phase.FINAL
    runs = History(home / "runs_rehearsal").refresh()
    assert plan_progress(plan, runs, NAMED).left == 1
    assert [run.official for run in runs] == [True]
    engine.set_teams(TeamList({4: "Ghent"}))
    hall.prepare(replace(make_setup(run_number=2), team_reason="a guest"))
    assert "3 is not in the list" in hall.check(CheckName.TEAM)
    assert not engine.snapshot().practice


def test_the_word_is_wherever_the_run_is(
    hall: Drive, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(hall.folder)]) == 0
    assert "REHEARSAL" in (hall.folder / REPORT_FILE).read_text()
    assert "REHEARSAL" in (hall.folder / RESULT_FILE).read_text()
    assert all("REHEARSAL" in path.read_text() for path in hall.folder.glob("run_info_*"))
    for words in (
        ["standings", "--rehearsal"],
        ["standings", "--rehearsal", "--csv"],
        ["standings", "--rehearsal", "--html"],
        ["table", "runs", "--rehearsal"],
        ["table", "indicators", "--rehearsal"],
        ["score", str(hall.folder)],
    ):
        capsys.readouterr()
        assert main(words) == 0, words
        assert "REHEARSAL" in capsys.readouterr().out.upper(), words
    assert main(["standings", "--rehearsal", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["official"], found["source"]) == (False, "rehearsal")
    assert main(["publish", "site", "--rehearsal"]) == 0
    assert not Path("site").exists()
    pages = [path.read_text() for path in Path("site_rehearsal").rglob("*.html")]
    assert pages
    assert all("REHEARSAL" in page for page in pages)
    for words in (["--subject", "3"], ["--dossier", "--run", str(hall.folder)]):
        capsys.readouterr()
        assert main(["export", "--rehearsal", *words]) == 0
        zipped = Path(capsys.readouterr().out.splitlines()[-1])
        assert "REHEARSAL" in zipped.name
        with ZipFile(zipped) as opened:
            (readme,) = (name for name in opened.namelist() if name.endswith("README.txt"))
            assert "REHEARSAL" in opened.read(readme).decode()
    assert "REHEARSAL" in hall.engine.snapshot().label


def test_its_runs_and_official_ones_never_stand_together(
    hall: Drive, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own, official = hall.folder, official_run(home)
    hall.engine.close()
    assert main(["standings", "runs", "runs_rehearsal"]) == BAD_INPUT
    assert "runs of 2 competitions are here: 'Cup', 'REHEARSAL Cup'" in capsys.readouterr().err
    official.rename(home / "official")
    own.rename(home / "runs" / own.name)
    assert listed(home / "runs").problem == (
        "is of a rehearsal: move it into a results folder whose name ends in `rehearsal`"
    )
    assert main(["standings"]) == BAD_INPUT
    assert "No run counts yet." in capsys.readouterr().out
    (home / "official").rename(home / "runs_rehearsal" / official.name)
    assert listed(home / "runs_rehearsal").problem == (
        "is not of a rehearsal: move it out of this rehearsal's results folder"
    )
    assert main(["standings", "--rehearsal"]) == BAD_INPUT
    assert "No run counts yet." in capsys.readouterr().out


@pytest.mark.parametrize("name", ["runs", "runs_rehearsal"])
def test_its_folder_has_its_name(name: str) -> None:
    assert rehearsal_folder(Path(name)) == Path("runs_rehearsal")


def test_a_simulated_testbed_is_practice_outside_of_a_rehearsal(home: Path) -> None:
    hall = Drive(home / "runs", competition=CUP)
    hall.whole_run(make_setup())
    hall.engine.close()
    assert listed(home / "runs").practice
    assert "REHEARSAL" not in hall.engine.snapshot().label


def test_a_link_is_what_its_target_is_and_one_that_says_otherwise_is_refused(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("hall", "hall_rehearsal"):
        (home / name).mkdir()
    (home / "today").symlink_to("hall_rehearsal")
    (home / "old_rehearsal").symlink_to("hall")
    assert main(["standings", "--results", str(home / "today")]) == 0
    assert rehearsal_folder(home / "today") == home / "today"
    capsys.readouterr()
    assert main(["standings", "--results", str(home / "old_rehearsal")]) == BAD_INPUT
    why = f"leads to {home / 'hall'}, which is no rehearsal's: name that folder"
    assert why in capsys.readouterr().err
