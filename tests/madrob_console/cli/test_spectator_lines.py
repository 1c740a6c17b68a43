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
from madrob_console.engine.public_state import PublishedState, SpectatorState, watch_schema
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
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine_process import ROOT, EngineProcess
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
    def lines(self) -> list[str]:
        return self._out.read_text().splitlines()

    @property
    def last(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.lines[-1])
        return found

    def says(self, words: str) -> bool:
        return words in self._out.read_text()

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
        try:
            until(lambda: plain.lines and states.lines)
            yield engine, plain, states
        finally:
            for one in (plain, states):
                one.process.kill()
                one.process.wait()


@pytest.mark.machine
def test_a_run_is_told_from_its_set_up_to_its_signature(tmp_path: Path) -> None:
    with hall(tmp_path) as (engine, plain, states):
        engine.start(replace(make_setup(), practice=True))
        engine.result()
        engine.wait_for(lambda s: s.refusal(Finalise.name) is None)
        engine.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
        until(lambda: plain.says("is final") and states.last["phase"] == Phase.FINAL)
        engine.process.kill()
        until(lambda: plain.says("the engine has ended") and states.last["engine"] == "ended")
        assert [one.stop() for one in (plain, states)] == [(130, "madrob: stopped\n")] * 2

    told = [re.sub(r"\d+(?:[.:]\d+)+", "#", line) for line in plain.lines]
    # a step that can still change is told as one so far, unless the result came with it
    assert any(line.endswith("step 4, cross the threshold, is done so far") for line in told)
    told = [line.removesuffix(" so far") for line in told]
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
    assert [line for line in told if "fault: " not in line and "over: " not in line] == expected

    told_states = [json.loads(line) for line in states.lines]
    for state in told_states:
        jsonschema.validate(state, watch_schema())
    assert list(dict.fromkeys(state["phase"] for state in told_states)) == list(Phase)
    last = told_states[-1]
    assert (last["team"], last["practice"], last["outcome"]) == ("Delft", True, "completed")
    result, times = last["result"], [step["time"] for step in last["steps"]]
    assert (result["final"], result["valid"], result["values"]["capability_level"]) == (1, 1, 6)
    assert last["elapsed"] == pytest.approx(result["values"]["execution_time"], abs=0.1)
    assert times == sorted(times)
    assert not any(state["result"] for state in told_states if state["phase"] == "running")


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
def told(tmp_path: Path) -> Iterator[Told]:
    drive = Drive(tmp_path)
    told = Told(drive)
    told.lines()
    yield told
    drive.engine.close()


def test_decisions_of_the_referee_are_told_with_their_reasons(told: Told) -> None:
    drive = told.drive
    drive.prepare(make_setup())
    assert told.lines()[:1] == [f"{WHO} is set up in condition 1: pull, from CCW to CW, No Force"]
    assert told.after(Start()) == [f"the countdown of {WHO} begins: 2 s"]
    drive.wait(1.0)
    again = told.after(RestartCountdown("a person in the way"))
    assert again == [
        "restart the countdown: a person in the way",
        f"the countdown of {WHO} begins: 2 s",
    ]
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
    denied += told.lines()
    assert denied[0] == "referee denies step 4: fell back"
    assert denied[-1].startswith(f"{WHO} has ended after ")
    assert denied[-1].endswith(" s: 3 of 6 steps")
    assert "run voided: a person in the way" in told.after(Void("a person in the way"))


def test_an_earlier_run_that_is_opened_is_told_once(told: Told) -> None:
    told.drive.whole_run(make_setup())
    folder = told.drive.folder
    told.drive.act(SetUp(make_setup(run_number=2)))
    told.lines()
    assert told.drive.open(folder) is None
    (line,) = told.lines()
    assert line == f"an earlier run is opened: {WHO}"


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


def test_a_fault_is_told_once_and_when_it_is_over(told: Told) -> None:
    before = told.drive.engine.snapshot()

    def lines(then: str, now: str) -> list[str]:
        first = replace(before, faults=(then,) if then else ())
        second = replace(before, faults=(now,) if now else (), time=before.time + 1.0)
        changed = list(json_lines(first, second))
        words = [line.partition(" ")[2] for line in plain_lines(first, second)]
        assert len(changed) == len(words)
        return words

    assert lines("", "door: silent for 0.7 s") == ["fault: door: silent for 0.7 s"]
    assert lines("door: silent for 0.7 s", "door: silent for 1.2 s") == []
    assert lines("door: silent for 1.2 s", "") == ["over: door: silent for 1.2 s"]


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
    told.drive.whole_run(make_setup())
    state = json.loads(SpectatorState.of_snapshot(told.drive.engine.snapshot()).text)
    robots = json.loads(PublishedState.of(told.drive.engine.run).text)
    assert [*robots, *named] == [*state, *state["result"]]
    for key in state["steps"][0]:
        assert f"`{key}`" in text
    assert list(state["result"]["values"]) == list(IndicatorName)


def test_the_schema_describes_every_key(madrob: Madrob) -> None:
    schema = json.loads(madrob("schema watch"))
    assert schema == watch_schema()
    for name in ("SpectatorState", "PublicStep", "PublicResult"):
        for key, about in schema["$defs"][name]["properties"].items():
            assert about["description"], key
