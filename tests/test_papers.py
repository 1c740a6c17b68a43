"""The blocks of README and guide do what the pages say."""

from __future__ import annotations

import json
import math
import re
import runpy
import shlex
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from random import Random
from textwrap import dedent
from typing import Any
from unittest.mock import ANY

import msgspec
import numpy as np
import pytest

import recorder
import scoring
from madrob_console import archive
from madrob_console.archive import score
from madrob_console.cli.guide_command import PAGES
from madrob_console.cli.main import build_parser, main
from madrob_console.common.names import REHEARSAL, Scenario, is_rehearsal
from madrob_console.config import Settings
from madrob_console.config.settings import parse_settings
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Condition, EventName, Outcome
from scoring.result import Result
from tests.madrob_console.engine.drive import Drive, OfficialDrive, make_setup
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.robots import Played, Robot
from tests.madrob_console.run_folders import summary, write

ROOT = Path(__file__).parents[1]
PACKAGES = ("madrob_console", "scoring", "recorder")
GUIDE = sorted(f"madrob_console/guide/{page}.md" for page in PAGES)
USERS = ("README.md", *GUIDE)
"""The papers of those who use the console."""

_PLACEHOLDERS = {
    "PATH": "somewhere",
    "PATH...": "somewhere",
    "N": "3",
    "KG": "2.5",
    "RUN": "somewhere",
    "FOLDER": "somewhere",
}


def read(paper: str) -> str:
    """A paper's text."""
    return (ROOT / paper).read_text(encoding="utf-8")


def fenced(text: str, language: str) -> list[str]:
    """The blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def section(page: str, title: str) -> str:
    """A part of a page of the guide."""
    text = read(f"madrob_console/guide/{page}.md").partition(f"\n## {title}\n")[2]
    return text.partition("\n## ")[0]


def blocks(language: str) -> list[str]:
    """The blocks of README and guide in a language."""
    return [block for paper in USERS for block in fenced(read(paper), language)]


def example(words: str) -> str:
    """The one program of the papers with these words."""
    (found,) = (one for one in blocks("python") if words in one)
    return found


def commands(texts: Iterable[str]) -> list[list[str]]:
    """What sh blocks give `madrob`, word by word."""
    lines = [part for text in texts for part in re.split(r"\n|&&", text)]
    return [
        [_PLACEHOLDERS.get(word, word) for word in words[1:]]
        for words in (shlex.split(line.partition(" > ")[0], comments=True) for line in lines)
        if words and words[0].rpartition("/")[2] == "madrob"
    ]


@pytest.mark.parametrize("words", commands(blocks("sh")), ids=" ".join)
def test_the_commands_of_the_papers_parse(words: list[str]) -> None:
    build_parser().parse_args(words)


@pytest.mark.parametrize("block", blocks("toml"), ids=lambda block: block.split()[0])
def test_the_settings_of_the_papers_are_settings(block: str) -> None:
    assert parse_settings(block) != Settings()


@pytest.mark.parametrize(
    ("chapter", "competition"),
    [
        ("## A competition day in nine commands", "Euro Door Cup"),
        ("**5. Rehearse a whole day.**", "REHEARSAL Euro Door Cup"),
    ],
)
def test_the_commands_of_a_day_do_what_they_are_for(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    chapter: str,
    competition: str,
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / ".config"))
    monkeypatch.chdir(tmp_path)
    settings = tmp_path / ".config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    readme = read("README.md")
    settings.write_text(fenced(readme, "toml")[0])
    Path("teams.csv").write_text("3,Delft\n4,Ghent\n")
    Path("plan.csv").write_text(fenced(read("madrob_console/guide/organiser.md"), "text")[0])
    rehearsed = is_rehearsal(competition)
    end = "_rehearsal" if rehearsed else ""
    kind = Drive if rehearsed else OfficialDrive  # the first says that it is simulated
    hall = kind(tmp_path / f"madrob_runs{end}", competition=competition)
    hall.whole_run(make_setup())
    hall.engine.close()
    day = readme.partition(chapter)[2].partition("\n## ")[0]
    every = commands(fenced(day, "sh"))
    assert len(every) == 9
    said = {}
    for words in every:
        if words[0] not in ("doctor", "console", "watch"):  # they need a testbed or a terminal
            assert main(words) == 0, words
            said[words[0]] = capsys.readouterr().out
    assert "Delft" in said["plan"]
    assert "Delft" in said["standings"]
    assert "same digits" in said["score"]
    page = Path(f"site{end}", "index.html").read_text()
    zipped = Path(said["export"].splitlines()[-1])
    assert zipped.is_file()
    marked = [REHEARSAL in text for text in (said["standings"], said["plan"], page, zipped.name)]
    assert marked == [rehearsed] * 4


def test_ros_finds_the_package_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    packages = pytest.importorskip("ament_index_python.packages")
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    share = Path(packages.get_package_share_directory("madrob_console"))
    source = ROOT / "madrob_console/ros_package"
    assert (share / "package.xml").read_bytes() == (source / "package.xml").read_bytes()
    assert [path.name for path in share.glob("**/*.launch.py")] == ["referee.launch.py"]


def test_the_notebook_of_the_guide_gives_the_digits_that_the_console_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = archived_for_examples(tmp_path, monkeypatch)
    told: dict[str, Any] = {}
    for cell in fenced(read("madrob_console/guide/library.md"), "python"):
        exec(cell, told)
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "my_run: completed, by protocol"
    assert said[1:9] == [
        f"{name} {one['value']} {one['unit']} " for name, one in stored["indicators"].items()
    ]
    assert "is torn at byte" in said[-2]
    assert said[-1] == "100 messages are there"
    mine = msgspec.to_builtins(told["mine"].indicators)
    assert mine == {name: one | {"doubts": ANY} for name, one in stored["indicators"].items()}
    assert told["runs"].folder.tolist() == [
        path.name for path in sorted(Path("my_results").iterdir())
    ]
    assert len(told["indicators"]) == 8 * len(told["runs"])
    assert set(told["events"].event) <= {*EventName}
    assert len(set(told["samples"].signal)) == 12
    assert told["pull"].gt(40).all()
    assert told["motion"].velocity.abs().max() > 0.1
    assert Path("figure_1_acceleration.svg").stat().st_size > 1000


@pytest.mark.parametrize("number", [2, 7, 12, 17])
def test_guide_scores_arrays_of_every_condition(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = Drive(Path("runs"), seed=number)
    drive.whole_run(make_setup(Condition.from_number(number)))
    drive.engine.close()
    drive.folder.rename("my_run")
    parts = section("library", "Score recorded runs"), section("library", "Score your own arrays")
    told: dict[str, Any] = {}

    exec("\n".join([fenced(parts[0], "python")[0], *fenced(parts[1], "python")]), told)

    assert told["mine"].condition.number == number
    assert told["mine"].to_frame().equals(told["result"].to_frame())


def test_the_interface_of_a_package_is_what_it_names_and_its_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archived_for_examples(tmp_path, monkeypatch)
    times = np.arange(-2.0, 3.0, 0.02)
    given = {"times": times, "angles": 0 * times, "forces": 0 * times, "start": 0.0}
    given |= {"ranges": np.full((times.size, 4), 2.0), "Path": Path, "now": 1, "cdr": bytes(12)}
    made: dict[Any, dict[str, Any]] = {}
    for package in (scoring, recorder, archive):
        for name in package.__all__:
            assert getattr(package, name).__module__.partition(".")[0] in PACKAGES
        with pytest.raises(AttributeError):
            _ = package.evaluate_all
        example = re.findall(
            r"^    .*\n|^\n", str(package.__doc__).partition(":\n\n")[2], re.MULTILINE
        )
        made[package] = dict(given)
        exec(dedent("".join(example)), made[package])
    assert made[scoring]["result"].outcome == "interrupted"
    assert made[recorder]["message"].topic == "/door"
    assert made[archive]["levels"].value.tolist() == [6, 6]


def archived_for_examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Put a run and a results folder where the examples look; what is stored of the run."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(completed(), "my_run")
    for number in (1, 2):
        shutil.copytree(run := completed(number), f"my_results/{run.name}")
    stored: dict[str, Any] = json.loads(Path("my_run/result.json").read_bytes())
    return stored


def test_the_guide_s_lines_for_pandas_give_the_mean_of_each_team(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for subject, hall in ((3, "Hall A"), (3, "Hall B"), (4, "Hall B")):
        for number, seconds in ((1, 20.0), (2, 21.0 + subject)):
            told: dict[str, Any] = {"testbed": hall, "run_id": f"{hall}{subject}{number}"}
            told |= {"team": f"T{subject}", "values": {"execution_time": seconds}}
            write(Path(hall), summary(subject, run_number=number, **told))
    write(Path("Hall A"), summary(5, outcome=Outcome.ABORTED, values={}, run_id="x"))
    assert main(["table", "indicators", ".", "--output", "indicators.csv"]) == 0
    Path("example.py").write_text(example("indicators.csv"), encoding="utf-8")
    times = runpy.run_path("example.py")["times"]
    means = times.groupby(["team", "testbed"])["value"].mean().to_dict()
    assert means == {("T3", "Hall A"): 22.0, ("T3", "Hall B"): 22.0, ("T4", "Hall B"): 22.5}


@pytest.mark.parametrize(
    ("scenario", "condition", "timeout", "outcome", "level"),
    [
        (Scenario.NOMINAL, 11, 60.0, Outcome.COMPLETED, 6),  # push
        (Robot.CLOSES_UNDER_SENSORS, 1, 8.2, Outcome.TIMEOUT, 4),  # under the sensors then
        (Scenario.NO_TOUCH, 17, 20.0, Outcome.TIMEOUT, 0),
    ],
)
def test_the_guide_s_program_computes_the_indicators_from_the_tables_alone(
    scenario: Played,
    condition: int,
    timeout: float,
    outcome: Outcome,
    level: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = Drive(tmp_path / "results", scenario)
    result = run_as_in_the_guide(drive, condition, timeout)
    assert result.outcome == outcome
    assert result.indicators[IndicatorName.CAPABILITY_LEVEL].value == level


@pytest.mark.slow
def test_the_guide_s_program_computes_the_indicators_of_any_run(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = Random(11)
    for seed in range(request.config.getoption("--runs")):
        folder = tmp_path_factory.mktemp(f"seed_{seed}")
        monkeypatch.chdir(folder)
        drive = Drive(folder / "results", Robot.RANDOM, seed)
        run_as_in_the_guide(drive, random.randint(1, 20), random.uniform(5.0, 30.0))


def run_as_in_the_guide(drive: Drive, condition: int, timeout: float) -> Result:
    """Make a run in the working folder and hold the guide's program to what it scores."""
    drive.whole_run(make_setup(Condition.from_number(condition), timeout=timeout))
    drive.engine.close()
    drive.folder.rename("my_run")
    assert main(["table", "samples", "my_run", "--output", "tables"]) == 0
    Path("example.py").write_text(example("tables/"), encoding="utf-8")
    computed = runpy.run_path("example.py")["indicators"]
    (run,) = score("my_run", RulesetName.PROTOCOL)
    finite = {name: one if abs(one) < math.inf else None for name, one in computed.items()}
    assert finite == {
        name: one.value if one.value is None else pytest.approx(one.value, rel=1e-9, abs=0)
        for name, one in run.result.indicators.items()
    }
    return run.result
