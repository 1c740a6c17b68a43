"""Every competition has a team 1: no command puts two of them together. And `madrob plan`."""

from __future__ import annotations

import csv
import json
from argparse import Namespace
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from zipfile import ZipFile

import pytest

from madrob_console.cli.chosen_runs import site_arguments
from madrob_console.config import load_settings
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Outcome
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write

FED = summary(1, 7, 1, team="Team 1", competition="Fed Cup", hour=1)
OTHER = summary(1, 7, 1, team="Zebra 1", competition="Other Cup", hour=2)
BOTH = "runs of 2 competitions are here: 'Fed Cup', 'Other Cup': choose one by --competition NAME"
NONE = "--competition 'Cup': no such runs; there are 'Fed Cup'"


@pytest.fixture
def halls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two halls, each with a team 1 of its own."""
    monkeypatch.chdir(tmp_path)
    for run, place in ((FED, "a"), (OTHER, "b")):
        write(tmp_path / "halls" / place, run)
    return tmp_path / "halls"


EXPORT = "export --subject 1 --output x.zip halls"


def packed() -> tuple[set[str], str]:
    """The folders of the zip, and its README."""
    with ZipFile("x.zip") as file:
        folders = {name.partition("/")[0] for name in file.namelist() if "/" in name}
        return folders, file.read("README.txt").decode()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (EXPORT, BOTH),
        (f"{EXPORT} --competition Cup", NONE),
        *((f"standings halls {option}", BOTH) for option in ("", "--json", "--csv --output x")),
        ("standings halls --html --output x", BOTH),
        ("publish site halls", BOTH),
    ],
)
def test_no_zip_table_or_page_is_of_two_competitions(
    line: str, words: str, halls: Path, madrob: Madrob
) -> None:
    assert words in madrob.refusal(line)
    assert list(halls.parent.glob("*/**/*.html")) == []
    assert not [*halls.parent.glob("x*")]


@pytest.mark.parametrize(
    ("name", "run", "team"), [("Fed Cup", FED, "Delft"), ("Other Cup", OTHER, "Zebra 1")]
)
def test_a_zip_has_the_runs_of_the_competition_that_is_chosen_and_its_teams(
    name: str, run: RunSummary, team: str, halls: Path, madrob: Madrob
) -> None:
    write(halls / "b", summary(2, competition="Other Cup"))
    madrob(EXPORT, "--competition", name)
    folders, readme = packed()
    assert folders == {run.folder}
    assert readme.startswith(f"MADROB: runs of subject 1 {run.team}\n")
    Path("madrob.toml").write_text(
        '[competition]\nname = "Fed Cup"\n[[teams]]\nsubject = 1\nname = "Delft"\n'
    )
    madrob(EXPORT, "--competition", name, "--settings", "madrob.toml")
    assert packed()[1].startswith(f"MADROB: runs of subject 1 {team}\n")
    madrob("export --subject 2 --output x.zip halls")  # in one alone: there is no choice


def test_a_run_that_may_be_of_another_competition_is_named_and_in_no_zip(
    halls: Path, madrob: Madrob
) -> None:
    damaged = write(halls / "a", summary(1, 7, 2, hour=3))
    damaged.write_text("{")
    told = f"{damaged.parent.name}: does not say of which competition it is"
    assert told in madrob.complaint(EXPORT, "--competition", "Fed Cup")
    folders, readme = packed()
    assert folders == {FED.folder}
    assert told in readme


def test_a_run_that_was_cut_off_is_of_the_competition_of_its_journal(
    halls: Path, madrob: Madrob
) -> None:
    drive = Drive(halls / "c", competition="Other Cup")
    drive.start(make_setup())
    drive.engine.close()
    (drive.folder / "result.json").unlink(missing_ok=True)
    write(halls / "a", summary(3, competition="Fed Cup", source="simulated"))
    line = "export --practice --subject 3 --output x.zip --without-bags halls"
    for name in ("Fed Cup", "Other Cup"):
        madrob.say(line, "--competition", name)
        assert (drive.folder.name in packed()[0]) == (name == "Other Cup")


@pytest.mark.parametrize(
    ("line", "chosen"),
    [
        ("standings halls --csv", "Fed Cup"),
        ("standings halls --csv", "Other Cup"),
        ("table indicators halls", ""),
        ("table indicators halls", "Fed Cup"),
    ],
)
def test_rows_say_of_which_competition_they_are(
    line: str, chosen: str, halls: Path, madrob: Madrob
) -> None:
    out = madrob(line, *(["--competition", chosen] if chosen else []))
    found = {(row["competition"], row["team"]) for row in csv.DictReader(StringIO(out))}
    both = {("Fed Cup", "Team 1"), ("Other Cup", "Zebra 1")}
    assert found == {one for one in both if chosen in ("", one[0])}


def test_the_pages_that_an_engine_writes_are_of_its_competition(
    halls: Path, madrob: Madrob
) -> None:
    for run in (FED, OTHER):
        write(halls / "runs", run)
    path = halls / "madrob.toml"
    path.write_text(
        f'[competition]\nname = "Other Cup"\n'
        f'[results]\nfolder = "{halls}/runs"\npublish = "{halls}/site"\n'
    )
    named = Namespace(settings=path, teams=None, plan=None, results=None)
    madrob("publish", *site_arguments(named, load_settings(path)))
    assert "Zebra 1" in (halls / "site/teams/001.html").read_text()
    assert len(list((halls / "site/runs").iterdir())) == 1


def test_only_the_runs_of_a_competition_are_scored(tmp_path: Path, madrob: Madrob) -> None:
    fed, other = (completed(competition=name) for name in ("Fed Cup", "Other Cup"))
    bag = next(other.glob("*.mcap"))
    (tmp_path / bag.name).symlink_to(bag)  # neither result nor journal beside it
    said = madrob.say("score --json --competition 'Fed Cup'", fed, tmp_path)
    assert [run["competition"] for run in json.loads(said.out)["runs"]] == ["Fed Cup"]
    assert (said.code, "does not say of which competition it is, left out" in said.err) == (0, True)
    runs = madrob.document("score", fed, tmp_path)["runs"]
    assert {run["competition"] for run in runs} == {"Fed Cup", "Other Cup"}
    assert NONE in madrob.say("score --competition Cup", fed, tmp_path).err


# The plan of a competition.


CUP = "Autumn Cup"
PLAN = "plan --settings madrob.toml"


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Those of a competition after five runs; its files are where one is."""
    monkeypatch.chdir(tmp_path)
    Path("plan.csv").write_text("subject,condition,attempts\n3,1,2\n4,20\n3,1\n7,5,2\n")
    Path("teams.csv").write_text("3,Delft Walkers of the North Sea\n4,門の騎士\n7,Ghent\n")
    Path("madrob.toml").write_text(
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
    return tmp_path / "runs"


def spaced(text: str) -> Sequence[str]:
    return [" ".join(line.split()) for line in text.splitlines()]


@pytest.mark.usefixtures("runs")
def test_it_prints_the_plan_in_its_order_with_what_is_done(madrob: Madrob) -> None:
    printed = madrob(PLAN)
    lines = spaced(printed)
    assert [*lines[:3], *lines[5:9], *lines[lines.index("Out of plan:") :][1:2]] == [
        f"MADROB plan {CUP}",
        "2 of 6 attempts done, 4 left.",
        "Next: 4 門の騎士, condition 20 (pull, from CW to CCW, Wind Ramp), attempt 1 of 1.",
        "3 Delft Walkers 1 pull, from CCW to CW No Force 2/2 1 4",
        "> 4 門の騎士 20 pull, from CW to CCW Wind Ramp 0/1 0 -",
        "3 Delft Walkers 1 pull, from CCW to CW No Force 0/1 0 -",
        "7 Ghent 5 pull, from CCW to CW Wind Ramp 0/2 0 -",
        "9 2 pull, from CCW to CW Constant Force +1 1 6",
    ]
    assert all(len(line) <= 80 for line in printed.splitlines()[3:])


def test_the_twenty_conditions_have_the_numbers_that_a_plan_needs(madrob: Madrob) -> None:
    rows = spaced(madrob("plan --conditions"))
    assert rows[0] == "no benchmark type opening side starting side task"
    assert rows[1] == "1 No Force CCW CCW pull, from CCW to CW"
    assert rows[7] == "7 Constant Force CW CCW push, from CCW to CW"
    assert [row.split()[0] for row in rows[1:21]] == [str(number) for number in range(1, 21)]


def test_json_says_the_same_to_programs(runs: Path, madrob: Madrob) -> None:
    found = madrob.document(PLAN)
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
    assert madrob.document(PLAN, runs) == found  # a path is one of runs


TEAMS = "3,Delft\n4,Ghent\n"


@pytest.mark.parametrize(
    ("plan", "teams", "done", "told"),
    [
        (
            "3,1,2\n4,No Force,1\n",
            TEAMS,
            "2 of 2 attempts done, 0 left.",
            "plan.csv line 2: there is no condition 'No Force': see `madrob plan --conditions`",
        ),
        (
            "3,1\n99,2\n12,1\n99,1\n",
            TEAMS,
            "1 of 4 attempts done, 3 left.",
            "the plan has subject 12, 99, not in the list of teams: correct one of them",
        ),
        ("3,1\n99,2\n", "", "1 of 2 attempts done, 1 left.", ""),  # no list: names are free
    ],
)
@pytest.mark.usefixtures("runs")
def test_what_cannot_be_used_is_named_and_the_exit_code_says_so(
    plan: str, teams: str, done: str, told: str, madrob: Madrob
) -> None:
    Path("plan.csv").write_text(plan)
    Path("teams.csv").write_text(teams)
    said = madrob.say(PLAN)
    expected = (2, f"madrob: {told}\n") if told else (0, "")
    assert (said.code, said.err, done in said.out) == (*expected, True)
    assert madrob.document(PLAN, code=said.code)["problems"] == [told] * bool(told)


@pytest.mark.parametrize("command", ["plan", "standings", "publish site", "export --subject 3"])
@pytest.mark.usefixtures("runs")
def test_every_command_that_reads_the_teams_names_a_bad_line_once(
    command: str, madrob: Madrob
) -> None:
    Path("teams.csv").write_text("3,Delft\nx,Late\n")
    said = madrob.say(f"{command} --teams teams.csv --settings madrob.toml")
    told = "madrob: teams.csv line 2: subject 'x' is no number from 1 to 999: write one\n"
    assert said.err.count(told) == 1


@pytest.mark.usefixtures("runs")
def test_a_line_has_its_time_beside_the_team_and_its_day_above(madrob: Madrob) -> None:
    Path("plan.csv").write_text("4,1,1,9:30\n4,2,1,2026-11-26T14:00\n4,3,1\n")
    shown = madrob(PLAN).splitlines()
    first = next(at for at, line in enumerate(shown) if " 09:30 " in line)
    assert shown[first + 1] == "2026-11-26"
    assert (" 14:00 " in shown[first + 2], ":" in shown[first + 3]) == (True, False)
    assert all(len(line) <= 80 for line in shown)


def test_another_competition_can_be_asked_for(runs: Path, madrob: Madrob) -> None:
    write(runs, summary(3, 1, 3, hour=9, competition="Spring Cup"))
    said = madrob(PLAN, "--competition", "Spring Cup")
    assert said.startswith("MADROB plan Spring Cup\n1 of 6 attempts done")


def test_a_plan_may_stand_in_the_settings(tmp_path: Path, madrob: Madrob) -> None:
    file = tmp_path / "madrob.toml"
    file.write_text("[plan]\nruns = [[3, 1, 2], [4, 1, 1]]\n")
    assert "0 of 3 attempts done, 3 left." in madrob("plan --settings", file, "--results", tmp_path)
    missing = tmp_path / "typed wrongly"
    said = madrob.say("plan --settings", file, "--results", missing)
    note = f"madrob: note: {missing}: no such results folder, so no attempt is there\n"
    assert (said.code, said.err) == (0, note)
