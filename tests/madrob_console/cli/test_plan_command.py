"""`madrob plan`: the plan and how much of a results folder's runs have done of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from madrob_console.cli.problems import BAD_INPUT
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import summary, write

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
    assert " ".join(lines[out + 1].split()) == "9 2 pull, from CCW to CW Constant Force 1 1 6"
    assert all(len(line) <= 80 for line in lines[3:])


def test_json_says_the_same_to_programs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert plan(folder, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["planned"], found["done"], found["left"]) == (6, 2, 4)
    assert found["next"] == {"subject": 4, "team": "門の騎士", "condition": 20, "attempt": 1}
    assert found["lines"][0] == {
        "subject": 3,
        "team": "Delft Walkers of the North Sea",
        "condition": 1,
        "attempts": 2,
        "done": 2,
        "valid": 1,
        "best_level": 4,
        "left": 0,
        "open_protests": 0,
    }
    assert [one["subject"] for one in found["out_of_plan"]] == [9]


def test_a_path_behind_json_is_one_of_runs_and_nothing_is_written_to_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert plan(folder, "--json") == 0
    found = capsys.readouterr().out
    assert plan(folder, "--json", str(folder / "runs")) == 0
    assert capsys.readouterr().out == found
    assert plan(folder, "--json", str(folder / "plan.json")) == BAD_INPUT
    assert "plan.json: no such folder; name a folder with runs" in capsys.readouterr().err
    assert not (folder / "plan.json").exists()


def test_a_line_that_cannot_be_used_is_named_and_the_exit_code_says_so(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "plan.csv").write_text("3,1,2\n4,No Force,1\n")
    assert plan(folder) == BAD_INPUT
    said = capsys.readouterr()
    assert "2 of 2 attempts done, 0 left." in said.out
    assert said.err == ("madrob: plan.csv line 2: condition 'No Force' is no number from 1 to 20\n")


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


def test_without_a_plan_it_says_how_to_make_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty.toml").write_text("")
    assert main(["plan", f"--settings={tmp_path}/empty.toml"]) == BAD_INPUT
    assert capsys.readouterr().err == (
        "madrob: no plan: name a file in [plan] of the settings, or with --plan\n"
    )
    assert main(["plan", f"--plan={tmp_path}/none.csv"]) == BAD_INPUT
    assert "cannot be read (No such file or directory); correct --plan" in capsys.readouterr().err


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
