"""`--json`: one object on standard output, with the keys that the guide names."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from madrob_console.cli.finding import Severity
from madrob_console.cli.output import BAD_INPUT
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.recorded_runs import completed

GUIDE = (Path(__file__).parents[3] / "madrob_console" / "guide" / "data.md").read_text()
TABLE = re.findall(r"^\| `madrob ([a-z ]+)` \| (`.*`) \|$", GUIDE, re.MULTILINE)
KEYS = {command: re.findall(r"`(\w+)`", keys) for command, keys in TABLE}


def document(madrob: Madrob, line: str, *paths: Path, code: int = 0) -> dict[str, Any]:
    """What a command prints; it has the keys that the guide names."""
    found: dict[str, Any] = madrob.document(line, *paths, code=code)
    assert list(found) == KEYS[line.partition(" -")[0]]
    return found


@pytest.mark.parametrize("command", ["plan --plan plan.csv", "standings", "score"])
def test_lists_and_results_have_the_keys_of_the_guide(
    command: str, tmp_path: Path, madrob: Madrob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.csv").write_text("3,1,2\n")
    document(madrob, command, completed())


@pytest.mark.machine
def test_an_engine_is_told_with_its_run_and_the_line_that_stops_it(
    tmp_path: Path, madrob: Madrob
) -> None:
    with EngineProcess(tmp_path, "nominal") as engine:
        engines = document(madrob, "engine status")["engines"]
        (found,) = (one for one in engines if one["pid"] == engine.process.pid)
        assert (found["kind"], found["domain"]) == ("simulated", None)
        assert (found["phase"], found["run"], found["busy"]) == ("idle", None, False)
        assert found["stop"] == f"madrob engine stop --pid {found['pid']}"
        for key in found:
            assert f"`{key}`" in GUIDE


def test_the_doctor_says_in_json_what_it_says_in_lines(
    madrob: Madrob, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "door")
    (tmp_path / "teams.csv").write_text("x,Late\n")
    (tmp_path / "plan.csv").write_text("3,21\n")
    lists = [f"--{name}={tmp_path / name}.csv" for name in ("teams", "plan")]
    named = " ".join(["doctor", *lists, f"--results={tmp_path / 'runs'}"])
    told = document(madrob, named, code=BAD_INPUT)
    assert (told["passed"], told["verdict"]) == (False, "not usable: see the errors above")
    severities = [one["severity"] for one in told["findings"]]
    assert set(severities) <= {one.name.lower() for one in Severity}
    found = {one["subject"]: f"{one['severity']} {one['text']}" for one in told["findings"]}
    for name, words in (("teams", "teams.csv line 1: "), ("plan", "plan.csv line 1: ")):
        assert found[name].startswith(f"warning {words}")
    assert f" {tmp_path / 'runs'}: " in found["results"]
    lines = madrob(named, code=BAD_INPUT).splitlines()
    assert [line.split()[0] for line in lines[:-1]] == severities
