"""A rehearsal: as the competition, on a simulated testbed too, and never beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest

from madrob_console.archive.folders import REPORT_FILE, RESULT_FILE, rehearsal_folder
from madrob_console.archive.history import History
from madrob_console.cli.output import BAD_INPUT
from madrob_console.referee.competition_plan import Plan, PlanLine, Task, plan_progress
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.referee.run_summary import RunSummary
from madrob_console.referee.team_list import TeamList
from tests.madrob_console.cli.typed import Madrob
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


def listed(results: Path) -> RunSummary:
    (run,) = History(results).refresh()
    return run


def test_its_run_goes_through_all_that_an_official_one_does(hall: Drive, home: Path) -> None:
    engine = hall.engine
    hall.act(signed(engine.snapshot()))
    assert engine.run.phase is Phase.FINAL
    runs = History(home / "runs_rehearsal").refresh()
    assert plan_progress(Plan((PlanLine(Task(3, 1), 2),)), runs, NAMED).left == 1
    assert [run.official for run in runs] == [True]
    engine.set_teams(TeamList({4: "Ghent"}))
    hall.prepare(replace(make_setup(run_number=2), team_reason="a guest"))
    assert "3 is not in the list" in hall.check(CheckName.TEAM)
    assert not engine.snapshot().practice


def test_the_word_is_wherever_the_run_is(hall: Drive, home: Path, madrob: Madrob) -> None:
    madrob("report", hall.folder)
    for name in (REPORT_FILE, RESULT_FILE, "run_info_*"):
        texts = [path.read_text() for path in hall.folder.glob(name)]
        assert texts
        assert all("REHEARSAL" in text for text in texts)
    for line in (
        "standings --rehearsal",
        "standings --rehearsal --csv",
        "standings --rehearsal --html",
        "table runs --rehearsal",
        "table indicators --rehearsal",
        f"score {hall.folder}",
    ):
        assert "REHEARSAL" in madrob(line).upper(), line
    found = madrob.document("standings --rehearsal")
    assert (found["official"], found["source"]) == (False, "rehearsal")
    madrob("publish site --rehearsal")
    assert not Path("site").exists()
    pages = [path.read_text() for path in Path("site_rehearsal").rglob("*.html")]
    assert pages
    assert all("REHEARSAL" in page for page in pages)
    for options in ("--subject 3", f"--dossier --run {hall.folder}"):
        zipped = Path(madrob(f"export --rehearsal {options}").splitlines()[-1])
        with ZipFile(zipped) as opened:
            (readme,) = (name for name in opened.namelist() if name.endswith("README.txt"))
            words = [zipped.name, opened.read(readme).decode()]
        assert ["REHEARSAL" in text for text in words] == [True, True]
    assert "REHEARSAL" in hall.engine.snapshot().label


def test_its_runs_and_official_ones_never_stand_together(
    hall: Drive, home: Path, madrob: Madrob
) -> None:
    own = hall.folder
    hall.engine.close()
    other = OfficialDrive(home / "runs", competition=CUP)
    other.whole_run(make_setup())
    other.engine.close()
    both = madrob.refusal("standings runs runs_rehearsal")
    assert "runs of 2 competitions are here: 'Cup', 'REHEARSAL Cup'" in both
    other.folder.rename(home / "official")
    own.rename(home / "runs" / own.name)
    (home / "official").rename(home / "runs_rehearsal" / other.folder.name)
    for line, results, problem in (
        (
            "standings",
            home / "runs",
            "is of a rehearsal: move it into a results folder whose name ends in `rehearsal`",
        ),
        (
            "standings --rehearsal",
            home / "runs_rehearsal",
            "is not of a rehearsal: move it out of this rehearsal's results folder",
        ),
    ):
        assert listed(results).problem == problem
        assert "No run counts yet." in madrob(line, code=BAD_INPUT)


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
    home: Path, madrob: Madrob
) -> None:
    for link, target in (("today", "hall_rehearsal"), ("old_rehearsal", "hall")):
        (home / target).mkdir()
        (home / link).symlink_to(target)
    madrob("standings --results", home / "today")
    assert rehearsal_folder(home / "today") == home / "today"
    why = f"leads to {home / 'hall'}, which is no rehearsal's: name that folder"
    assert why in madrob.refusal("standings --results", home / "old_rehearsal")
