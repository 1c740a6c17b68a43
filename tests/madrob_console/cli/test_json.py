"""`--json`: one object on standard output, with the keys that the guide names."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from madrob_console.cli.doctor_ros import Severity
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.reference_set import FOLDER, read_references
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.recorded_runs import completed

GUIDE = (Path(__file__).parents[3] / "madrob_console" / "guide" / "data.md").read_text()
TABLE = re.findall(r"^\| `madrob ([a-z ]+)` \| (`.*`) \|$", GUIDE, re.MULTILINE)
KEYS = {command: re.findall(r"`(\w+)`", keys) for command, keys in TABLE}


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    file = tmp_path / "plan.csv"
    file.write_text("3,1,2\n")
    return file


def document(
    capsys: pytest.CaptureFixture[str], line: str, *paths: Path, code: int = 0
) -> dict[str, Any]:
    """What a command prints; it has the keys that the guide names."""
    assert main([*line.split(), "--json", *map(str, paths)]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert list(found) == KEYS[line.partition(" -")[0]]
    return found


def test_lists_and_results_have_the_keys_of_the_guide(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = completed()
    document(capsys, f"plan --plan {plan}", run.parent)
    document(capsys, "standings", run.parent)
    document(capsys, "score", run)


@pytest.mark.machine
def test_an_engine_is_told_with_its_run_and_the_line_that_stops_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with EngineProcess(tmp_path, "nominal") as engine:
        engines = document(capsys, "engine status")["engines"]
        (found,) = (one for one in engines if one["pid"] == engine.process.pid)
        assert (found["kind"], found["domain"]) == ("simulated", None)
        assert (found["phase"], found["run"], found["busy"]) == ("idle", None, False)
        assert found["stop"] == f"madrob engine stop --results {found['results']}"
        for key in found:
            assert f"`{key}`" in GUIDE


def test_the_doctor_says_in_json_what_it_says_in_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "door")
    (tmp_path / "teams.csv").write_text("x,Late\n")
    (tmp_path / "plan.csv").write_text("3,21\n")
    lists = [f"--{name}={tmp_path / name}.csv" for name in ("teams", "plan")]
    named = ["doctor", *lists, f"--results={tmp_path / 'runs'}"]
    told = document(capsys, " ".join(named), code=BAD_INPUT)
    assert (told["passed"], told["verdict"]) == (False, "not usable: see the errors above")
    assert {one["severity"] for one in told["findings"]} <= {one.name.lower() for one in Severity}
    found = {one["subject"]: (one["severity"], one["text"]) for one in told["findings"]}
    for name in ("teams", "plan"):
        assert found[name][0] == "warning"
        assert found[name][1].startswith(f"{name}.csv line 1: ")
    assert found["results"][1].startswith(f"{tmp_path / 'runs'}: ")
    assert main(named) == BAD_INPUT
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == [one["severity"] for one in told["findings"]]


def test_the_references_are_told_too(capsys: pytest.CaptureFixture[str]) -> None:
    told = document(capsys, "doctor --reference")
    assert told["passed"] is True
    assert len(told["findings"]) == 1 + len(read_references(FOLDER))
