"""`madrob watch --json` and `--plain`: what spectators' programs and screen readers can rely on."""

from __future__ import annotations

import json
import re
import shutil
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
from madrob_console.engine.snapshot import Pulse, Snapshot
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    Void,
)
from madrob_console.referee.records import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from scoring.indicator_table import IndicatorName
from scoring.protocol import Step
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine_process import ROOT, EngineProcess
from tests.madrob_console.recorded_runs import completed
from tests.watching import until

PROGRAM = [sys.executable, "-m", "madrob_console.cli.main"]
WHO = "practice run 1 of team 3 Delft"


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
        until(lambda: "is final" in plain.text and states.states[-1]["phase"] == Phase.FINAL)
        engine.process.kill()
        until(
            lambda: "the engine has ended" in plain.text and states.states[-1]["engine"] == "ended"
        )
        assert [one.stop() for one in (plain, states)] == [(130, "madrob: stopped\n")] * 2

    told = [re.sub(r"\d+(?:[.:]\d+)+", "#", line) for line in plain.text.splitlines()]
    # a step that can still change is told as one so far, unless the result came with it
    assert any(line.endswith("step 4, cross the threshold, is done so far") for line in told)
    expected = [
        "# watching SIMULATED nominal: no run is set up",
        f"# {WHO} is set up in condition 1: pull, from CCW to CW, No Force",
        f"# the countdown of {WHO} begins: 2 s",
        f"# {WHO} starts",
        *(f"+# s step {step}, {step.text}, is done" for step in Step),
        "+# s the run has ended: completed, all six steps done",
        f"# {WHO} is completed in # +- # s: 6 of 6 steps",
        "# the result is final: signed by R. Eferee, team acknowledged",
        "# the engine has ended: the next one is looked for",
    ]
    assert expected == [
        line.removesuffix(" so far") for line in told if not re.search("(fault|over): ", line)
    ]

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


class Told:
    """An engine, and what has been said of it since the look before."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self._before: Snapshot | None = None

    def lines(self) -> list[str]:
        before, self._before = self._before, self.drive.engine.snapshot()
        return [line.partition(" ")[2] for line in plain_lines(before, self._before)]

    def after(self, *acts: Act) -> list[str]:
        self.drive.act(*acts)
        self.drive.engine.step(0.02)
        return self.lines()


@pytest.fixture
def told(drive: Drive) -> Told:
    told = Told(drive)
    told.lines()
    return told


def test_decisions_of_the_referee_are_told_with_their_reasons(told: Told) -> None:
    drive, begins = told.drive, f"the countdown of {WHO} begins: 2 s"
    drive.prepare(make_setup())
    assert told.lines()[:1] == [f"{WHO} is set up in condition 1: pull, from CCW to CW, No Force"]
    assert told.after(Start()) == [begins]
    drive.wait(1.0)
    again = told.after(RestartCountdown("a person in the way"))
    assert again == ["restart the countdown: a person in the way", begins]
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    assert told.lines() == [f"{WHO} starts"]
    drive.wait(1.0)
    assert told.after(MarkIncident(IncidentKind.FALL)) == ["s incident: fall"]
    assert told.after(AddNote("nice")) == ["s note: nice"]
    drive.finish()
    drive.wait(1.0)
    assert told.lines()[-1].endswith("s: 6 of 6 steps")
    denied = told.after(Rule(Step.CROSS, confirmed=False, reason="fell back"))
    drive.wait(1.0)
    first, *_, last = [*denied, *told.lines()]
    assert first == "referee denies step 4: fell back"
    assert re.fullmatch(rf"{WHO} has ended after .* s: 3 of 6 steps", last)
    assert "run voided: a person in the way" in told.after(Void("a person in the way"))


def test_an_earlier_run_that_is_opened_is_told_once(told: Told) -> None:
    folder = told.drive.engine.config.results / "practice" / completed().name
    shutil.copytree(completed(), folder)
    told.drive.act(SetUp(make_setup(run_number=2)))
    told.lines()
    assert told.drive.open(folder) is None
    assert told.lines() == [f"an earlier run is opened: {WHO}"]


@pytest.mark.parametrize(
    ("act", "ends"),
    [
        (Abort("robot unsafe"), ["abort: robot unsafe", "aborted, ", "is aborted and invalid: 0"]),
        (DeclareTimeout("they give up"), ["declare timeout", "timeout, ", "is over by timeout: 0"]),
    ],
)
def test_other_ends_have_their_own_words(told: Told, act: Act, ends: list[str]) -> None:
    told.drive.start(make_setup())
    told.lines()
    lines = told.after(act)
    told.drive.finish()
    told.drive.wait(1.0)
    text = "\n".join([*lines, *told.lines()])
    assert [words for words in ends if words not in text] == []


@pytest.mark.parametrize(
    ("then", "now", "words"),
    [
        ((), ("door: silent for 0.7 s",), ["fault: door: silent for 0.7 s"]),
        (("door: silent for 0.7 s",), ("door: silent for 1.2 s",), []),
        (("door: silent for 1.2 s",), (), ["over: door: silent for 1.2 s"]),
    ],
)
def test_a_fault_is_told_once_and_when_it_is_over(
    told: Told, then: tuple[str, ...], now: tuple[str, ...], words: list[str]
) -> None:
    before = told.drive.engine.snapshot()
    first, second = replace(before, faults=then), replace(before, faults=now, time=before.time + 1)
    assert [line.partition(" ")[2] for line in plain_lines(first, second)] == words
    assert len(list(json_lines(first, second))) == len(words)


def test_a_silent_engine_is_told_once_and_when_it_answers(told: Told) -> None:
    live = told.drive.engine.snapshot()
    silent, still = (replace(live, pulse=Pulse(server=seconds)) for seconds in (2, 3))
    assert "silent for 2 s" in next(plain_lines(live, silent))
    assert [json.loads(line)["engine"] for line in json_lines(live, silent)] == ["silent"]
    assert list(plain_lines(silent, still)) == list(json_lines(silent, still)) == []
    assert "the engine answers again" in next(plain_lines(still, live))
    gone = replace(live, pulse=Pulse(gone="the engine has ended"))
    assert "the engine has ended" in next(plain_lines(live, gone))
    assert f"watching {live.label}: " in next(plain_lines(gone, live))  # the next one


def test_the_guide_has_the_keys_of_the_state(told: Told) -> None:
    page = (ROOT / "madrob_console/guide/robots.md").read_text()
    text = page.partition("\n## The same state without ROS\n")[2].partition("\n## ")[0]
    named = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    told.drive.whole_run(make_setup(timeout=1.0))
    state = json.loads(SpectatorState.of_snapshot(told.drive.engine.snapshot()).text)
    robots = json.loads(PublishedState.of(told.drive.engine.run).text)
    assert [*robots, *named] == [*state, *state["result"]]
    assert [key for key in state["steps"][0] if f"`{key}`" not in text] == []
    assert list(state["result"]["values"]) == list(IndicatorName)
