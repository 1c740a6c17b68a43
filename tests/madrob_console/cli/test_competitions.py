"""Every competition has a team 1: no command puts two of them together."""

from __future__ import annotations

import csv
import json
from argparse import Namespace
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from zipfile import ZipFile

import pytest

from madrob_console.cli.main import main
from madrob_console.cli.problems import BAD_INPUT
from madrob_console.cli.which_runs import site_arguments
from madrob_console.config import load_settings
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.run_folders import summary, write

FED = summary(1, 7, 1, team="Team 1", competition="Fed Cup", hour=1)
OTHER = summary(1, 7, 1, team="Zebra 1", competition="Other Cup", hour=2)
BOTH = "runs of 2 competitions are here: 'Fed Cup', 'Other Cup': choose one by --competition NAME"


@pytest.fixture
def halls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two halls, each with a team 1 of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for run, place in ((FED, "a"), (OTHER, "b")):
        write(tmp_path / "halls" / place, run)
    return tmp_path


def folders_in(zip_file: str) -> set[str]:
    names = ZipFile(zip_file).namelist()
    return {name.partition("/")[0] for name in names if "/" in name}


def export(*options: str) -> int:
    return main(["export", "--subject", "1", "--output", "x.zip", "halls", *options])


def test_no_zip_has_runs_of_two_competitions(
    halls: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export() == BAD_INPUT
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"madrob: {BOTH}\n")
    assert not Path("x.zip").exists()
    for name, run in (("Fed Cup", FED), ("Other Cup", OTHER)):
        assert export("--competition", name) == 0
        assert folders_in("x.zip") == {run.folder}
        assert f"runs of subject 1 {run.team}\n" in readme("x.zip")
    assert export("--competition", "Cup") == BAD_INPUT
    told = "--competition 'Cup': no such runs; there are 'Fed Cup', 'Other Cup'"
    assert told in capsys.readouterr().err


def readme(zip_file: str) -> str:
    with ZipFile(zip_file) as file:
        (name,) = (name for name in file.namelist() if name.endswith("README.txt"))
        return file.read(name).decode()


def test_a_team_that_is_in_one_competition_alone_needs_no_choice(halls: Path) -> None:
    write(halls / "halls/b", summary(2, competition="Other Cup"))
    assert main(["export", "--subject", "2", "--output", "x.zip", "halls"]) == 0


def test_a_run_that_may_be_of_another_competition_is_named_and_in_no_zip(
    halls: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = write(halls / "halls/a", summary(1, 7, 2, hour=3))
    damaged.write_text("{")
    assert export("--competition", "Fed Cup") == BAD_INPUT
    assert folders_in("x.zip") == {FED.folder}
    told = f"{damaged.parent.name}: does not say of which competition it is"
    assert told in capsys.readouterr().err
    assert told in readme("x.zip")


def test_a_run_that_was_cut_off_is_of_the_competition_of_its_journal(halls: Path) -> None:
    drive = Drive(halls / "halls/c", competition="Other Cup")
    drive.start(make_setup())
    cut_off = drive.folder.relative_to(halls / "halls/c")
    drive.engine.close()
    (drive.folder / "result.json").unlink(missing_ok=True)
    for name in ("Fed Cup", "Other Cup"):
        options = ["--practice", "--subject", "3", "--output", "x.zip", "--without-bags"]
        write(halls / "halls/a", summary(3, competition="Fed Cup", source="simulated"))
        assert main(["export", *options, "halls", "--competition", name]) in (0, BAD_INPUT)
        assert (cut_off.name in folders_in("x.zip")) == (name == "Other Cup")


def test_the_list_of_the_settings_names_the_teams_of_their_competition_alone(halls: Path) -> None:
    Path("madrob.toml").write_text(
        '[competition]\nname = "Fed Cup"\n[[teams]]\nsubject = 1\nname = "Delft"\n'
    )
    for name, team in (("Fed Cup", "Delft"), ("Other Cup", "Zebra 1")):
        assert export("--competition", name, "--settings", "madrob.toml") == 0
        assert readme("x.zip").startswith(f"MADROB: runs of subject 1 {team}\n")


def test_standings_are_of_one_competition_and_their_rows_say_of_which(
    halls: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ([], ["--csv", "x.csv"], ["--json", "-"], ["--html", "x.html"]):
        assert main(["standings", "halls", *option]) == BAD_INPUT
        said = capsys.readouterr()
        assert (said.out, said.err) == ("", f"madrob: {BOTH}\n")
    assert not list(halls.glob("x.*"))
    assert main(["standings", "halls", "--competition", "Other Cup", "--csv", "-"]) == 0
    rows = list(csv.DictReader(StringIO(capsys.readouterr().out)))
    assert {(row["competition"], row["team"]) for row in rows} == {("Other Cup", "Zebra 1")}


def test_no_page_is_of_two_teams(halls: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["publish", "site", "halls"]) == BAD_INPUT
    assert capsys.readouterr().err == f"madrob: {BOTH}\n"
    assert not list(Path("site").glob("**/*.html"))
    assert main(["publish", "site", "halls", "--competition", "Other Cup"]) == 0
    page = Path("site/teams/001.html").read_text()
    assert "Zebra 1" in page
    assert FED.team not in page.replace("Team 1 <bdi>", "").replace("<title>Team 1", "")
    assert len(list(Path("site/runs").iterdir())) == 1


def test_the_competition_of_the_settings_has_its_pages_before_its_first_run(halls: Path) -> None:
    Path("madrob.toml").write_text('[competition]\nname = "New Cup"\n')
    options = ["--settings", "madrob.toml", "--competition", "New Cup"]
    assert main(["publish", "site", "halls", *options]) == 0
    assert "New Cup" in Path("site/index.html").read_text()
    assert not list(Path("site").glob("runs/*"))


def test_the_pages_that_an_engine_writes_are_of_its_competition(halls: Path) -> None:
    for run in (FED, OTHER):
        write(halls / "runs", run)
    path = halls / "madrob.toml"
    path.write_text(
        f'[competition]\nname = "Other Cup"\n'
        f'[results]\nfolder = "{halls}/runs"\npublish = "{halls}/site"\n'
    )
    named = Namespace(settings=path, teams=None, results=None)
    assert main(["publish", *site_arguments(named, load_settings(path))]) == 0
    assert "Zebra 1" in Path("site/teams/001.html").read_text()
    assert len(list(Path("site/runs").iterdir())) == 1


@pytest.mark.parametrize("chosen", [None, "Fed Cup", "Other Cup"])
def test_rows_of_tables_say_of_which_competition_they_are(
    halls: Path, capsys: pytest.CaptureFixture[str], chosen: str | None
) -> None:
    option = [] if chosen is None else ["--competition", chosen]
    assert main(["table", "indicators", "halls", *option]) == 0
    rows = list(csv.DictReader(StringIO(capsys.readouterr().out)))
    both = {("Fed Cup", "Team 1"), ("Other Cup", "Zebra 1")}
    found = {(row["competition"], row["team"]) for row in rows}
    assert found == {one for one in both if chosen in (None, one[0])}


def test_only_the_runs_of_a_competition_are_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for hall, name in (("a", "Fed Cup"), ("b", "Other Cup")):
        drive = Drive(tmp_path / hall, competition=name)
        drive.whole_run(make_setup(timeout=1.0))
        drive.engine.close()
    bag = next((tmp_path / "b").glob("practice/*/*.mcap"))
    (tmp_path / "alone").mkdir()
    bag.rename(tmp_path / "alone" / bag.name)  # neither result nor journal beside it
    where = [str(tmp_path / hall) for hall in ("a", "alone")]
    assert main(["score", "--json", "--competition", "Fed Cup", *where]) == 0
    said = capsys.readouterr()
    assert competitions_of(json.loads(said.out)["runs"]) == {"Fed Cup"}
    assert "does not say of which competition it is, left out" in said.err
    assert main(["score", "--json", *where]) == 0
    assert competitions_of(json.loads(capsys.readouterr().out)["runs"]) == {"Fed Cup", "Other Cup"}
    assert main(["score", "--competition", "Cup", *where]) == BAD_INPUT
    assert "no such runs; there are 'Fed Cup'" in capsys.readouterr().err


def competitions_of(runs: Sequence[dict[str, str]]) -> set[str]:
    return {run["competition"] for run in runs}
