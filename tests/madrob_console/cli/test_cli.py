"""The `madrob` command as people and scripts use it."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.cli.attaching import engine_options
from madrob_console.cli.console_command import check_lists
from madrob_console.cli.main import COMMANDS, build_parser, main
from madrob_console.cli.options import plan_source
from madrob_console.common.errors import MadrobError
from madrob_console.config import Settings
from madrob_console.config.tables import PlanSettings
from madrob_console.referee.acts import Abort
from madrob_console.referee.competition_plan import Plan, PlanLine, Task
from madrob_console.referee.lists import TeamList
from recorder.bag import RawMessage
from recorder.reader import read_bag
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.slowly import slow_but_for

PRACTICE = ["run", "--testbed", "simulated", "--countdown", "1", "--no-report"]
RUN = [*PRACTICE, "--speed", "0", "--subject", "3"]


def madrob(*arguments: str) -> int:
    try:
        return main(list(arguments))
    except SystemExit as end:  # argparse
        return int(end.code or 0)


def one_line(text: str) -> str:
    assert text.count("\n") == 1, text
    assert "Traceback" not in text
    return text


@pytest.fixture
def run_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert madrob(*RUN, "--results", str(tmp_path / "results")) == 0
    return folder_in(capsys.readouterr().out)


def folder_in(output: str) -> Path:
    last = output.splitlines()[-1]
    assert last.startswith("run folder: ")
    return Path(last.removeprefix("run folder: "))


@pytest.mark.parametrize(
    ("scenario", "code"), [("nominal", 0), ("touch-only", 3), ("turns-back", 3)]
)
def test_the_exit_code_says_how_the_run_ended(
    scenario: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--scenario", scenario, "--timeout", "30", "--results", str(tmp_path)]
    assert madrob(*RUN, *flags) == code
    output = capsys.readouterr().out
    assert folder_in(output).is_dir()
    for name in ("execution time", "capability level"):
        assert name in output


def test_a_run_without_a_number_takes_the_next_free_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--timeout", "2", "--results", str(tmp_path)]
    names = []
    for _ in range(2):
        assert madrob(*RUN, *flags) == 3
        names.append(folder_in(capsys.readouterr().out).name[:28])
    assert names == ["subject_003_cond_001_run_001", "subject_003_cond_001_run_002"]


def test_a_run_over_a_slow_network_is_recorded_as_its_messages_arrive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert madrob(*RUN, "--latency", "door=50ms", "--results", str(tmp_path)) == 0
    late = {
        topic: [m.receive_ns - m.publish_ns for m in messages]
        for topic, messages in by_topic(folder_in(capsys.readouterr().out)).items()
        if topic.startswith(("/madrob/door", "/madrob/handle", "/madrob/passage"))
    }
    door = late.pop("/madrob/door/angle")
    assert 50_000_000 < min(door) < max(door) < 55_000_000
    assert len(late) == 5
    assert all(0 < min(of) < max(of) < 5_000_000 for of in late.values())


def by_topic(folder: Path) -> dict[str, list[RawMessage]]:
    found = defaultdict(list)
    for message in read_bag(folder).messages():
        found[message.topic].append(message)
    return found


def test_score_prints_the_digits_of_the_run(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = json.loads((run_folder / "result.json").read_text())
    assert madrob("score", "--json", str(run_folder)) == 0
    scored = json.loads(capsys.readouterr().out)["runs"][0]
    assert scored["indicators"] == stored["indicators"]
    assert scored["events"] == stored["events"]
    assert scored["quality"] == stored["quality"]
    assert (scored["path"], scored["outcome"]) == (str(run_folder), "completed")


def test_score_reads_the_published_files_of_a_run(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    published = tmp_path / "published"
    published.mkdir()
    for pattern in ("*.csv", "run_info*.yaml", "condition*.yaml"):
        for path in run_folder.glob(pattern):
            (published / path.name).write_bytes(path.read_bytes())
    stored = json.loads((run_folder / "result.json").read_text())
    assert madrob("score", "--json", str(published)) == 0
    scored = json.loads(capsys.readouterr().out)["runs"][0]
    times = ("execution_time", "time_to_handle", "door_occupation_time", "passage_time")
    for name in (*times, "roughness_of_door_actuation", "capability_level"):
        assert scored["indicators"][name]["value"] == pytest.approx(
            stored["indicators"][name]["value"], abs=1e-6
        )


def test_a_bad_path_is_named_and_the_rest_is_scored(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"not a bag at all")
    assert madrob("score", str(junk), str(run_folder)) == 2
    captured = capsys.readouterr()
    assert str(junk) in one_line(captured.err)
    assert "capability level" in captured.out


def damaged_csv(folder: Path) -> Path:
    path = next(folder.glob("*_jointState.csv"))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0].replace("position", "angle"), *lines[1:]]))
    (next(folder.glob("*.mcap"))).unlink()
    (folder / "metadata.yaml").unlink()
    return path


def test_a_csv_without_its_column_is_named(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = damaged_csv(run_folder)
    assert madrob("score", str(run_folder)) == 2
    error = one_line(capsys.readouterr().err)
    assert path.name in error
    assert "position" in error


def test_an_existing_run_is_refused_and_kept(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (run_folder / "result.json").read_bytes()
    assert madrob(*RUN, "--run-number", "1", "--results", str(tmp_path / "results")) == 2
    assert "use run 2" in one_line(capsys.readouterr().err)
    assert (run_folder / "result.json").read_bytes() == before


def test_names_are_cleaned_before_they_reach_files_and_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    team = "../Team\x1b[31m 名前\n🤖"
    assert madrob(*RUN, "--team-name", team, "--timeout", "2", "--results", str(tmp_path)) == 3
    output = capsys.readouterr().out
    stored = json.loads((folder_in(output) / "result.json").read_text())
    assert "\x1b" not in output
    assert "名前" in stored["team"]
    assert not set(stored["team"]) & set("/\\\x1b\n")


def test_settings_prints_a_file_that_can_be_read_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert madrob("settings") == 0
    told = capsys.readouterr()
    nowhere = tmp_path / "config" / "madrob" / "madrob.toml"
    assert told.err == f"{nowhere}: not there, the defaults hold\n"
    path = tmp_path / "again.toml"
    path.write_text(told.out)
    assert madrob("settings", "--settings", str(path)) == 0
    assert capsys.readouterr().err == f"{path}: read, it is fine\n"
    assert madrob("settings", "--settings", str(tmp_path / "none.toml")) == 2
    assert "none.toml" in one_line(capsys.readouterr().err)


@pytest.mark.machine
def test_no_help_text_waits_for_a_large_library() -> None:
    code = "import sys; from madrob_console.cli.main import build_parser; build_parser()"
    large = ("asyncio", "matplotlib", "mcap", "msgspec", "numpy", "pandas", "rclpy", "textual")
    code += f"; print(set(sys.modules) & {set(large)})"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "set()\n"


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_is_there(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert madrob(*command.split(), "--help") == 0
    assert "usage: madrob" in capsys.readouterr().out


@pytest.mark.machine
@pytest.mark.parametrize(
    "number", slow_but_for([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], signal.SIGTERM)
)
def test_a_signal_aborts_the_run_and_keeps_it_on_record(
    number: signal.Signals, tmp_path: Path
) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "madrob_console.cli.main", *PRACTICE, "--results", str(tmp_path)],
        stdout=subprocess.PIPE, text=True, env=os.environ,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        for line in process.stdout:
            if "run starts" in line:
                break
        process.send_signal(number)
        rest = process.stdout.read()
    assert process.returncode == 4
    stored = json.loads((folder_in(rest) / "result.json").read_text())
    assert (stored["outcome"], number.name in stored["outcome_reason"]) == ("aborted", True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was aborted after two seconds."""
    drive = Drive(tmp_path_factory.mktemp("results"))
    drive.start(make_setup(countdown=1.0))
    drive.wait(2.0)
    drive.act(Abort("robot on fire"))
    drive.finish()
    drive.engine.close()
    return drive.folder


def replay(path: Path, *flags: str) -> int:
    return main(["run", "--testbed", "replay", str(path), "--speed", "0", *flags])


def test_a_replay_without_screens_prints_the_run_and_records_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.parent.rglob("*"))
    assert replay(folder, "--results", str(tmp_path / "results")) == 4
    output = capsys.readouterr().out.splitlines()
    assert output[0] == f"testbed: REPLAY {folder.name}"
    assert any("referee   abort: robot on fire" in line for line in output)
    assert output[-2:] == [
        "replay: equals the stored result to the last digit; nothing was recorded",
        f"run folder: {folder}",
    ]
    assert sorted(folder.parent.rglob("*")) == before
    assert not (tmp_path / "results").exists()


def test_a_replay_of_a_torn_bag_says_where_it_ends(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bag,) = folder.glob("*.mcap")
    data = bag.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: len(data) * 2 // 3])
    assert replay(torn) in (4, 5)
    assert "note: " + str(torn) in capsys.readouterr().out


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
