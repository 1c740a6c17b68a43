"""`madrob watch --json` and `--plain`: what spectators' programs and screen readers can rely on."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from madrob_console.cli.spectator_lines import json_lines, plain_lines
from madrob_console.engine import state_schemas
from madrob_console.engine.public_state import PublishedState, SpectatorState
from madrob_console.engine.snapshot import Pulse
from madrob_console.referee.acts import (
    Finalise,
    Start,
)
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.indicator_table import IndicatorName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine_process import ROOT, EngineProcess
from tests.watching import until

PROGRAM = [sys.executable, "-m", "madrob_console.cli.main"]


class Watching:
    """`madrob watch` with its output in files."""

    def __init__(self, engine: EngineProcess, folder: Path, option: str) -> None:
        self._out, self._errors = folder / f"out{option}", folder / f"errors{option}"
        with self._out.open("wb") as out, self._errors.open("wb") as errors:
            self.process = subprocess.Popen(watch(engine, option), stdout=out, stderr=errors)

    @property
    def text(self) -> str:
        return self._out.read_text()

    @property
    def states(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.text.splitlines()]

    def stop(self) -> tuple[int, str]:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(30.0), self._errors.read_text()


def watch(engine: EngineProcess, option: str) -> list[str]:
    testbed = ["--testbed", "simulated", "--speed=4", f"--results={engine.results}"]
    return [*PROGRAM, "watch", *testbed, option]


@contextmanager
def hall(folder: Path) -> Iterator[tuple[EngineProcess, Watching, Watching]]:
    """An engine with a watcher of each kind, which has said its first line."""
    no_reports = "[results]\nreports = false\n"
    with EngineProcess(folder / "runs", "nominal", speed=4.0, settings=no_reports) as engine:
        plain, states = (Watching(engine, folder, option) for option in ("--plain", "--json"))
        with plain.process, states.process:
            try:
                until(lambda: plain.text and states.text)
                yield engine, plain, states
            finally:
                plain.process.kill()
                states.process.kill()


@pytest.mark.machine
def test_a_run_is_told_from_its_set_up_to_its_signature(tmp_path: Path) -> None:
    with hall(tmp_path) as (engine, plain, states):
        engine.start(replace(make_setup(), practice=True))
        engine.result()
        engine.wait_for(lambda s: s.refusal(Finalise.name) is None)
        engine.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
        until(
            lambda: (
                "result signed by R. Eferee" in plain.text
                and states.states[-1]["phase"] == Phase.FINAL
            )
        )
        engine.process.kill()
        until(
            lambda: "the engine has ended" in plain.text and states.states[-1]["engine"] == "ended"
        )
        assert [one.stop() for one in (plain, states)] == [(130, "madrob: stopped\n")] * 2

    told = [line.partition(" ")[2] for line in plain.text.splitlines()]
    expected = (
        "watching SIMULATED nominal",
        "set up",
        "countdown begins",
        "s run starts",
        "s door closes",
        "s run stops: completed: all six steps done",
        "the engine has ended: the next one is looked for",
    )
    assert [line for line in told if line in expected] == list(expected)

    for state in states.states:
        jsonschema.validate(state, state_schemas()["watch"])
    assert list(dict.fromkeys(state["phase"] for state in states.states)) == list(Phase)
    last = states.states[-1]
    assert (last["team"], last["practice"], last["outcome"]) == ("Delft", True, "completed")
    result, times = last["result"], [step["time"] for step in last["steps"]]
    assert (result["final"], result["valid"], result["values"]["capability_level"]) == (1, 1, 6)
    assert last["elapsed"] == pytest.approx(result["values"]["execution_time"], abs=0.1)
    assert times == sorted(times)
    assert not any(state["result"] for state in states.states if state["phase"] == "running")


@pytest.mark.machine
def test_a_reader_that_has_gone_ends_it_without_a_word(tmp_path: Path) -> None:
    with hall(tmp_path) as (engine, _, _):
        pipe, errors = subprocess.PIPE, tmp_path / "errors"
        with (
            errors.open("wb") as file,
            subprocess.Popen(watch(engine, "--json"), stdout=pipe, stderr=file) as watching,
        ):
            assert watching.stdout is not None
            assert json.loads(watching.stdout.readline())["phase"] == "idle"
            watching.stdout.close()  # as `head -1` does; nothing more is printed meanwhile
            assert watching.wait(30.0) == 0
        assert errors.read_bytes() == b""


def test_a_line_of_the_log_is_printed_once(drive: Drive) -> None:
    before = drive.engine.snapshot()
    drive.prepare(make_setup())
    set_up = drive.engine.snapshot()
    drive.act(Start())
    began = drive.engine.snapshot()
    told = [line.partition(" ")[2] for line in plain_lines(set_up, began)]
    assert told == [line.text for line in began.log[len(set_up.log) :]]
    assert "start" in told
    assert len(list(plain_lines(before, set_up))) == len(set_up.log) - len(before.log)


@pytest.mark.parametrize(
    ("then", "now", "count"),
    [
        ((), ("door: silent for 0.7 s",), 1),
        (("door: silent for 0.7 s",), ("door: silent for 1.2 s",), 0),
        (("door: silent for 1.2 s",), (), 1),
    ],
)
def test_numbers_in_the_words_of_a_fault_make_no_line_of_json(
    then: tuple[str, ...], now: tuple[str, ...], count: int, drive: Drive
) -> None:
    before = drive.engine.snapshot()
    first, second = replace(before, faults=then), replace(before, faults=now, time=before.time + 1)
    assert len(list(json_lines(first, second))) == count


def test_a_silent_engine_is_told_once_and_when_it_answers(drive: Drive) -> None:
    live = drive.engine.snapshot()
    silent, still = (replace(live, pulse=Pulse(server=seconds)) for seconds in (2, 3))
    assert "silent for 2 s" in next(plain_lines(live, silent))
    assert [json.loads(line)["engine"] for line in json_lines(live, silent)] == ["silent"]
    assert list(plain_lines(silent, still)) == list(json_lines(silent, still)) == []
    assert "the engine answers again" in next(plain_lines(still, live))
    gone = replace(live, pulse=Pulse(gone="the engine has ended"))
    assert "the engine has ended" in next(plain_lines(live, gone))
    assert f"watching {live.label}" in next(plain_lines(gone, live))  # the next one


def test_the_guide_has_the_keys_of_the_state(drive: Drive) -> None:
    page = (ROOT / "madrob_console/guide/robots.md").read_text()
    text = page.partition("\n## The same state without ROS\n")[2].partition("\n## ")[0]
    named = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    drive.whole_run(make_setup(timeout=1.0))
    state = json.loads(SpectatorState.of_snapshot(drive.engine.snapshot()).text)
    robots = json.loads(PublishedState.of(drive.engine.run).text)
    assert [*robots, *named] == [*state, *state["result"]]
    assert [key for key in state["steps"][0] if f"`{key}`" not in text] == []
    assert list(state["result"]["values"]) == list(IndicatorName)
