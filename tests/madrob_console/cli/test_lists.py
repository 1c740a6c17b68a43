"""The list of teams and the plan that a command line names: the engine that it starts has them."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.cli.attaching import engine_options
from madrob_console.cli.console_command import check_lists
from madrob_console.cli.main import build_parser
from madrob_console.cli.options import plan_source
from madrob_console.config import Settings
from madrob_console.config.tables import PlanSettings
from madrob_console.errors import MadrobError
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.teams import TeamList
from tests.madrob_console.ui.fake_engine import FakeEngine

SETTINGS = Settings(plan=PlanSettings(runs=((3, 1, 2),)))


def typed(*words: str) -> argparse.Namespace:
    return build_parser().parse_args(words)


def test_a_plan_that_is_named_stands_for_that_of_the_settings(tmp_path: Path) -> None:
    file = tmp_path / "plan.csv"
    file.write_text("4,20,1\n")
    assert plan_source(typed("engine", "serve"), SETTINGS).read().lines == (
        PlanLine(Task(3, 1), 2),
    )
    named = plan_source(typed("engine", "serve", f"--plan={file}"), SETTINGS).read()
    assert (named.lines, named.file) == ((PlanLine(Task(4, 20), 1),), str(file))
    file.unlink()
    gone = plan_source(typed("engine", "serve", f"--plan={file}"), SETTINGS).read()
    assert "correct --plan" in gone.problems[0]


@pytest.mark.parametrize("option", ["teams", "plan"])
def test_the_engine_that_a_console_starts_has_the_lists_that_were_named(option: str) -> None:
    words = engine_options(typed("console", "--testbed=simulated", f"--{option}=cup.csv"))
    assert getattr(typed("engine", "serve", *words), option) == Path("cup.csv")


def test_the_engine_that_a_console_starts_has_the_names_of_the_launch_file() -> None:
    ros = ["-r", "__ns:=/hall2", "--remap", "door/angle:=/lab/angle"]
    words = engine_options(typed("console", "--testbed=ros", "--domain=7", "--ros-args", *ros))
    serve = typed("engine", "serve", *words)
    assert (serve.ros_args, serve.testbed, serve.domain) == (ros, ["ros"], 7)


def test_the_engine_that_a_console_starts_has_the_network_that_was_named() -> None:
    words = ("--latency", "20ms,door=50ms", "--jitter=handle=60ms")
    served = engine_options(typed("console", "--testbed=simulated", *words))
    network = typed("engine", "serve", *served)
    assert (network.latency, network.jitter) == ("20ms,door=50ms", "handle=60ms")


def test_the_engine_that_a_console_starts_follows_simulated_time_where_that_was_asked_for() -> None:
    asked = engine_options(typed("console", "--testbed=ros", "--use-sim-time"))
    assert typed("engine", "serve", *asked).use_sim_time
    assert not typed("engine", "serve", *engine_options(typed("console"))).use_sim_time


@pytest.mark.parametrize(
    ("option", "there"), [("teams", "no teams file"), ("plan", "no plan's file")]
)
def test_a_console_brings_no_other_list_to_an_engine_that_runs(
    option: str, there: str, tmp_path: Path
) -> None:
    engine, file = FakeEngine(), tmp_path / "cup.csv"
    arguments = typed("console", f"--{option}={file}")
    with pytest.raises(MadrobError, match=f"--{option} {file}: the engine that runs has {there};"):
        check_lists(engine, arguments, SETTINGS)
    assert engine.closed
    engine.teams = replace(TeamList({}), file=str(file))
    engine.plan = replace(Plan(), file=str(file))
    check_lists(engine, arguments, SETTINGS)
