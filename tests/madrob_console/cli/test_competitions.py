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

from madrob_console.cli.batch import site_arguments
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.config import load_settings
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.run_folders import summary, write

FED = summary(1, 7, 1, team="Team 1", competition="Fed Cup", hour=1)
OTHER = summary(1, 7, 1, team="Zebra 1", competition="Other Cup", hour=2)
BOTH = "runs of 2 competitions are here: 'Fed Cup', 'Other Cup': choose one by --competition NAME"


@pytest.fixture
def halls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two halls, each with a team 1 of its own."""
    monkeypatch.chdir(tmp_path)
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
    assert drive.engine.snapshot().competition == "Other Cup"
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
    for option in ([], ["--csv", "--output", "x.csv"], ["--json"], ["--html", "--output", "x"]):
        assert main(["standings", "halls", *option]) == BAD_INPUT
        said = capsys.readouterr()
        assert (said.out, said.err) == ("", f"madrob: {BOTH}\n")
    assert not list(halls.glob("x.*"))
    assert main(["standings", "halls", "--competition", "Other Cup", "--csv"]) == 0
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
    named = Namespace(settings=path, teams=None, plan=None, results=None)
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


CUP = "Autumn Cup"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A competition after five runs."""
    (tmp_path / "plan.csv").write_text("subject,condition,attempts\n3,1,2\n4,20\n3,1\n7,5,2\n")
    (tmp_path / "teams.csv").write_text("3,Delft Walkers of the North Sea\n4,門の騎士\n7,Ghent\n")
    (tmp_path / "madrob.toml").write_text(
        f'[competition]\nname = "{CUP}"\nteams_file = "{tmp_path}/teams.csv"\n'
        f'[plan]\nfile = "{tmp_path}/plan.csv"\n[results]\nfolder = "{tmp_path}/runs"\n'
    )
    for run in (
        summary(3, 1, 1, hour=0, values={"capability_level": 4}),
        summary(3, 1, 2, hour=1, outcome=Outcome.ABORTED, values={}),
        summary(4, 20, 1, hour=2, outcome=Outcome.INTERRUPTED),
        summary(4, 20, 2, hour=3, source="simulated"),
        summary(9, 2, 1, hour=4),
    ):
        write(tmp_path / "runs", run)
    return tmp_path


def plan(folder: Path, *options: str) -> int:
    return main(["plan", f"--settings={folder}/madrob.toml", *options])


def test_it_prints_the_plan_in_its_order_with_what_is_done(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert plan(folder) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        f"MADROB plan {CUP}",
        "2 of 6 attempts done, 4 left.",
        "Next: 4 門の騎士, condition 20 (pull, from CW to CCW, Wind Ramp), attempt 1 of 1.",
    ]
    rows = [" ".join(line.split()) for line in lines[5:9]]
    assert rows == [
        "3 Delft Walkers 1 pull, from CCW to CW No Force 2/2 1 4",
        "> 4 門の騎士 20 pull, from CW to CCW Wind Ramp 0/1 0 -",
        "3 Delft Walkers 1 pull, from CCW to CW No Force 0/1 0 -",
        "7 Ghent 5 pull, from CCW to CW Wind Ramp 0/2 0 -",
    ]
    out = lines.index("Out of plan:")
    assert " ".join(lines[out + 1].split()) == "9 2 pull, from CCW to CW Constant Force +1 1 6"
    assert all(len(line) <= 80 for line in lines[3:])


def test_an_attempt_beyond_the_plan_is_told_apart(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (3, 4):
        write(folder / "runs", summary(3, 1, number, hour=10 + number))
    assert plan(folder) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "3 Delft Walkers 1 pull, from CCW to CW No Force 2/2 1 4" in lines
    assert "3 Delft Walkers 1 pull, from CCW to CW No Force 1/1 2 6" in lines
    assert "1 more than planned: 3 Delft Walkers of the North Sea, condition 1." in lines


def test_the_twenty_conditions_have_the_numbers_that_a_plan_needs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["plan", "--conditions"]) == 0
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert rows[0] == "no benchmark type opening side starting side task"
    assert rows[1] == "1 No Force CCW CCW pull, from CCW to CW"
    assert rows[7] == "7 Constant Force CW CCW push, from CCW to CW"
    assert [row.split()[0] for row in rows[1:21]] == [str(number) for number in range(1, 21)]


def test_json_says_the_same_to_programs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert plan(folder, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["planned"], found["done"], found["left"]) == (6, 2, 4)
    next_one = {"subject": 4, "team": "門の騎士", "condition": 20, "attempt": 1, "time": ""}
    assert found["next"] == next_one
    assert found["lines"][0] == {
        "subject": 3,
        "team": "Delft Walkers of the North Sea",
        "condition": 1,
        "attempts": 2,
        "done": 2,
        "beyond": 0,
        "valid": 1,
        "best_level": 4,
        "left": 0,
        "open_protests": 0,
        "time": "",
    }
    assert [one["subject"] for one in found["out_of_plan"]] == [9]


def test_a_line_that_cannot_be_used_is_named_and_the_exit_code_says_so(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "plan.csv").write_text("3,1,2\n4,No Force,1\n")
    assert plan(folder) == BAD_INPUT
    said = capsys.readouterr()
    assert "2 of 2 attempts done, 0 left." in said.out
    assert said.err == (
        "madrob: plan.csv line 2: condition 'No Force' is none: see `madrob plan --conditions`\n"
    )


@pytest.mark.parametrize("command", ["plan", "standings", "publish", "export"])
def test_every_command_that_reads_the_teams_names_a_bad_line_once(
    command: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "teams.csv").write_text("3,Delft\nx,Late\n")
    more = {"publish": [str(tmp_path / "site")], "export": ["--subject", "3"]}
    files = ["--teams", str(folder / "teams.csv"), "--settings", str(folder / "madrob.toml")]
    main([command, *more.get(command, []), *files])
    told = "madrob: teams.csv line 2: subject 'x' is no number from 1 to 999: write one\n"
    assert capsys.readouterr().err.count(told) == 1


def test_a_line_has_its_time_beside_the_team_and_its_day_above(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "plan.csv").write_text("4,1,1,9:30\n4,2,1,2026-11-26T14:00\n4,3,1\n")
    assert plan(folder) == 0
    shown = capsys.readouterr().out.splitlines()
    first = next(at for at, line in enumerate(shown) if " 09:30 " in line)
    assert shown[first + 1] == "2026-11-26"
    assert " 14:00 " in shown[first + 2]
    assert ":" not in shown[first + 3]
    assert all(len(line) <= 80 for line in shown)


def test_a_team_that_is_not_in_the_list_is_named_and_the_exit_code_says_so(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "plan.csv").write_text("3,1\n99,2\n12,1\n99,1\n")
    assert plan(folder) == BAD_INPUT
    said = capsys.readouterr()
    assert "1 of 4 attempts done, 3 left." in said.out
    told = "the plan has subject 12, 99, not in the list of teams: correct one of them"
    assert said.err == f"madrob: {told}\n"
    assert plan(folder, "--json") == BAD_INPUT
    assert json.loads(capsys.readouterr().out)["problems"] == [told]
    (folder / "teams.csv").write_text("")
    assert plan(folder) == 0  # no list: names are free


def test_another_competition_can_be_asked_for(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(folder / "runs", summary(3, 1, 3, hour=9, competition="Spring Cup"))
    assert plan(folder, "--competition", "Spring Cup") == 0
    assert capsys.readouterr().out.startswith("MADROB plan Spring Cup\n1 of 6 attempts done")


def test_a_plan_may_stand_in_the_settings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "madrob.toml"
    file.write_text("[plan]\nruns = [[3, 1, 2], [4, 1, 1]]\n")
    assert main(["plan", f"--settings={file}", f"--results={tmp_path}"]) == 0
    assert "0 of 3 attempts done, 3 left." in capsys.readouterr().out
    for text, problem in (
        ("runs = [[3, 21, 1]]", "plan.runs[0][1]: expected a whole number <= 20"),
        ("runs = [[3, 1]]", "plan.runs[0]: expected a list of length 3, got 2"),
        ('file = "/a.csv"\nruns = [[3, 1, 1]]', "plan: runs: the file says it, keep one"),
        ('file = "a.csv"', "plan: file: begin it with / or ~/"),
    ):
        file.write_text(f"[plan]\n{text}\n")
        assert main(["plan", f"--settings={file}"]) == BAD_INPUT
        assert problem in capsys.readouterr().err
