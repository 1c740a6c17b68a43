"""The `madrob` command as people and scripts use it: runs, and what a console hands on."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from madrob_console.cli.attaching import engine_options
from madrob_console.cli.console_command import check_lists
from madrob_console.cli.main import build_parser
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario
from madrob_console.config import Settings
from madrob_console.config.tables import PlanSettings
from madrob_console.referee.competition_plan import Plan
from madrob_console.referee.team_list import TeamList
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive

RUN = "run --testbed simulated --countdown 1 --no-report --speed 0 --subject 3 --results"


def folder_in(output: str) -> Path:
    last = output.splitlines()[-1]
    assert last.startswith("run folder: ")
    return Path(last.removeprefix("run folder: "))


def test_a_run_without_a_number_takes_the_next_free_one_and_overwrites_none(
    tmp_path: Path, madrob: Madrob
) -> None:
    folders = [folder_in(madrob(RUN, tmp_path, "--timeout", "2", code=3)) for _ in range(2)]
    assert [folder.name[:28] for folder in folders] == [
        "subject_003_cond_001_run_001",
        "subject_003_cond_001_run_002",
    ]
    before = (folders[0] / "result.json").read_bytes()
    assert "use run 3" in madrob.complaint(RUN, tmp_path, "--run-number", "1")
    assert (folders[0] / "result.json").read_bytes() == before


def test_settings_prints_a_file_that_can_be_read_again(tmp_path: Path, madrob: Madrob) -> None:
    nowhere, path = tmp_path / "config" / "madrob" / "madrob.toml", tmp_path / "again.toml"
    told = madrob.say("settings")
    assert (told.code, told.err) == (0, f"{nowhere}: not there, the defaults hold\n")
    path.write_text(told.out)
    assert madrob.say("settings --settings", path).err == f"{path}: read, it is fine\n"
    path.write_text('[[topics]]\nsignal = "door angle"\nfield = "data[0..3]"\n')
    assert "'data[0..3]' is no field" in madrob.refusal("settings --settings", path)


def test_a_refused_run_names_each_reason_on_a_line(tmp_path: Path, madrob: Madrob) -> None:
    path = tmp_path / "strict.toml"
    path.write_text(f"[checks]\ndisk_space = {10**15}\nlargest_skew = 0.001\n")
    said = madrob.say(RUN, tmp_path, "--settings", path, "--wait", "1")
    notes = [line for line in said.out.splitlines() if line.startswith("note: ")]
    assert [note.split(": ")[1] for note in notes] == [
        "settings",
        "topics",
        "clock skew",
        "disk space",
    ]


REMAPPED = ["-r", "__ns:=/hall2", "--remap", "door/angle:=/lab/angle"]
SETTINGS = Settings(plan=PlanSettings(runs=((3, 1, 2),)))


def typed(*words: str) -> argparse.Namespace:
    return build_parser().parse_args(words)


@pytest.mark.parametrize(
    ("words", "served"),
    [
        (["--testbed=simulated", "--teams=cup.csv"], {"teams": Path("cup.csv")}),
        (["--testbed=simulated", "--plan=cup.csv"], {"plan": Path("cup.csv")}),
        (
            ["--testbed=ros", "--domain=7", "--ros-args", *REMAPPED],
            {"ros_args": REMAPPED, "testbed": ["ros"], "domain": 7},
        ),
        (["--testbed=simulated", "--scenario=slow"], {"scenario": Scenario.SLOW}),
    ],
)
def test_the_engine_that_a_console_starts_has_what_was_given(
    words: list[str], served: dict[str, object]
) -> None:
    engine = typed("engine", "serve", *engine_options(typed("console", *words)))
    assert vars(engine).items() >= served.items()


@pytest.mark.parametrize(
    ("option", "there"), [("teams", "no teams file"), ("plan", "no plan's file")]
)
def test_a_console_brings_no_other_list_to_an_engine_that_runs(
    option: str, there: str, tmp_path: Path, drive: Drive
) -> None:
    engine, file = Mock(snapshot=drive.engine.snapshot), tmp_path / "cup.csv"
    arguments = typed("console", f"--{option}={file}")
    with pytest.raises(MadrobError, match=f"--{option} {file}: the engine that runs has {there};"):
        check_lists(engine, arguments, SETTINGS)
    engine.close.assert_called_once_with()
    drive.engine.set_teams(replace(TeamList({}), file=str(file)))
    drive.engine.set_plan(replace(Plan(), file=str(file)))
    check_lists(engine, arguments, SETTINGS)
