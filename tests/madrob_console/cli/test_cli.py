"""The `madrob` command as people and scripts use it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

from madrob_console.cli.main import COMMANDS, main
from recorder.message import RawMessage
from recorder.reader import read_bag
from tests.slowly import slow_but_for

PRACTICE = ["run", "--testbed", "simulated", "--countdown", "1", "--no-report"]
RUN = [*PRACTICE, "--speed", "0", "--subject", "3"]


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


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


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ("[run]\ntimeout = 'long'\n", "timeout"),
        ("[run]\ntimeuot = 3.0\n", "timeuot"),
        ("[[topics]]\nsignal = 'door angle'\ntype = 'no_msgs/msg/Angle'\nfield = 'x'\n", "no_msgs"),
        ("[thresholds]\ntouch_force = nan\n", "touch_force"),
        ("not toml at all", "TOML"),
    ],
)
def test_a_bad_setting_is_named(
    settings: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "madrob.toml"
    path.write_text(settings)
    flags = ["--settings", str(path), "--results", str(tmp_path / "results")]
    assert madrob(*RUN, *flags) == 2
    assert named in one_line(capsys.readouterr().err)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--subject", "0"], "subject"),
        (["--start-pose", "-1,0,0"], "CCW side"),
        (["--start-pose", "1.5,0,nan"], "--start-pose"),
        (["--timeout", "0"], "timeout"),
        (["--team", "Delft"], "--team"),
        (["--team-name", "x" * 200], "--team-name"),
        (["--speed", "-1"], "--speed"),
        (["--testbed", "replay"], "replay"),
        (["--testbed", "moon"], "moon"),
        (["--subject", "three"], "--subject"),
        (["--start-pose", "here"], "--start-pose"),
    ],
)
def test_a_bad_flag_is_refused_in_one_line(
    flags: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert madrob(*RUN, *flags, "--results", str(tmp_path / "results")) == 2
    assert named in one_line(capsys.readouterr().err)


def test_an_existing_run_is_refused_and_kept(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (run_folder / "result.json").read_bytes()
    assert madrob(*RUN, "--run", "1", "--results", str(tmp_path / "results")) == 2
    assert "use run 2" in one_line(capsys.readouterr().err)
    assert (run_folder / "result.json").read_bytes() == before


def test_a_results_folder_that_is_a_file_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "results").write_text("")
    assert madrob(*RUN, "--results", str(tmp_path / "results")) == 2
    assert str(tmp_path / "results") in one_line(capsys.readouterr().err)


def test_a_bag_of_somebody_else_says_why_it_cannot_be_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--testbed", "replay", str(tmp_path / "nothing"), "--results", str(tmp_path)]
    assert madrob("run", *flags) == 2
    assert "nothing" in one_line(capsys.readouterr().err)


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
