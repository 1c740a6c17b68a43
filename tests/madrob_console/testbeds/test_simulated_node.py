from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import Decoder
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.connection import load_module
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.testbed import parse_state
from madrob_console.testbeds.simulated_node import refusal, serve_testbed
from recorder.bag import RawMessage
from scoring.protocol import BenchmarkType, Condition, Side, Signal, StartPose
from scoring.samples import HandleSample, Sample
from tests.madrob_console import said
from tests.madrob_console.engine_process import madrob_beside
from tests.madrob_console.ros_peer import Peer, Taker, source
from tests.watching import PATIENCE, until

pytestmark = pytest.mark.machine
CW = Condition(BenchmarkType.CONSTANT_FORCE, opening_side=Side.CW, starting_side=Side.CW)


def state(phase: str, start: float | None = None) -> RawMessage:
    return said.state(phase, start, CW)


@contextmanager
def serving(
    testbed: SimulatedTestbed,
    condition: Condition | None = None,
    repeat: int = 1,
    ros_args: Sequence[str] = (),
) -> Iterator[list[str]]:
    """A testbed node in a thread; what it says."""
    lines: list[str] = []
    stop = threading.Event()
    node = threading.Thread(
        target=serve_testbed,
        args=(testbed, condition, repeat),
        kwargs={"say": lines.append, "stop": stop, "ros_args": ros_args},
    )
    node.start()
    try:
        yield lines
    finally:
        stop.set()
        node.join(PATIENCE)
        assert not node.is_alive()


class Console:
    """A console's source beside a testbed node."""

    def __init__(self, source: RosSource, testbed: SimulatedTestbed, lines: list[str]) -> None:
        self.source = source
        self.lines = lines
        self.samples: list[Sample] = []
        self._testbed = testbed
        self._decoder = Decoder(DEFAULT_MAPPINGS, MessageTypes())

    def until(self, condition: Callable[[], object]) -> None:
        ends = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < ends, f"it never happened; the node said {self.lines}"
            for message in self.source.take_messages(0.02):
                sample = self._decoder.decode(message)
                assert sample is not None
                self.samples.append(sample)

    def count_down(self, start: float) -> None:
        """Announce a run, until the node has found this console and heard it."""
        self.until(lambda: self.samples)
        self.source.publish(state("countdown", start))
        self.until(lambda: self._testbed.plan is not None)

    def run(self, start: float, number: int = 1) -> None:
        """The robot sets out, for the first or a later time."""
        self.source.publish(state("running", start))
        self.until(lambda: self.lines.count("robot sets out") == number)

    def stop(self, start: float, number: int = 1) -> None:
        self.source.publish(state("stopped", start))
        self.until(lambda: self.lines.count("run over") == number)


@contextmanager
def console_and_node(
    testbed: SimulatedTestbed, condition: Condition | None = None, repeat: int = 1
) -> Iterator[Console]:
    with Taker(source()) as taker, serving(testbed, condition, repeat) as lines:
        yield Console(taker.source, testbed, lines)


@pytest.mark.usefixtures("ros_domain")
def test_the_robot_sets_out_when_the_referee_says_running_and_not_before() -> None:
    testbed = SimulatedTestbed(Scenario.TOUCH_ONLY)
    with console_and_node(testbed) as console:
        wanted = {m.topic for m in DEFAULT_MAPPINGS if m.signal is not Signal.LATCH}
        console.until(lambda: {s.topic for s in console.source.status() if s.publishers} == wanted)
        console.source.configure(CW)
        console.until(lambda: console.source.sides_problem is None)
        console.source.publish(said.start_pose(StartPose(-1.0, 0.0, 0.0)))
        announced = time.time() + 0.2
        console.count_down(announced)
        console.until(lambda: console.samples[-1].time > announced + 0.3)
        assert "robot sets out" not in console.lines
        start = time.time()
        console.source.publish(state("running", start))
        console.samples.clear()

        def touched() -> bool:
            forces = [s.force for s in console.samples if isinstance(s, HandleSample)]
            return bool(forces) and max(forces) - min(forces) > 10

        console.until(touched)
        assert testbed.plan is not None
        assert testbed.plan.condition == CW
        assert console.samples[-1].time > start
        console.stop(start)
        console.source.publish(state("final", start))
        console.until(lambda: "messages on" in console.lines[-1])
    assert console.lines[0].startswith("simulated testbed touch-only in ROS domain ")
    assert console.lines[1:6] == [
        "opening side set to CW",
        "benchmark type set to Constant Force",
        "condition 17: Constant Force, opens to CW, robot on CW",
        "robot sets out",
        "run over",
    ]
    counts = {line.split()[-1]: int(line.split()[0]) for line in console.lines[6:]}
    assert counts.keys() == wanted
    assert min(counts.values()) > 50


@pytest.mark.usefixtures("ros_domain")
def test_it_ends_after_the_runs_it_was_asked_for() -> None:
    testbed = SimulatedTestbed()
    with console_and_node(testbed, CW, repeat=2) as console:
        for run in (1, 2):
            start = time.time()
            console.count_down(start)
            console.run(start, run)
            console.stop(start, run)
            console.source.publish(state("idle"))
            console.until(lambda: testbed.plan is None or "messages on" in console.lines[-1])
        console.until(lambda: "messages on" in console.lines[-1])
    assert console.lines.count("robot sets out") == 2


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("_again", range(3))
def test_two_signals_at_a_time_end_it(_again: int) -> None:
    with madrob_beside("testbed", "--repeat=0") as process:
        assert process.stdout is not None
        process.stdout.readline()

        for _ in range(400):  # until some come while another one is handled
            process.send_signal(signal.SIGINT)
            process.send_signal(signal.SIGTERM)
        process.wait(PATIENCE)


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(number: signal.Signals) -> None:
    program = """
        from madrob_console.testbeds.simulated_node import serve_testbed
        from madrob_console.testbeds.simulated import SimulatedTestbed
        serve_testbed(SimulatedTestbed(), None, 0, say=lambda line: print(line, flush=True))
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            assert process.stdout is not None
            domain = os.environ["ROS_DOMAIN_ID"]
            assert process.stdout.readline() == (
                f"simulated testbed nominal in ROS domain {domain}: waits for the referee; every "
                "run on it is practice\n"
            )
            with Taker(source()) as taker:
                until(lambda: taker.has(1) and len({m.topic for m in taker.taken}) == 6)
            process.send_signal(number)
            out, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, err) == (0, "")
    assert len(out.splitlines()) == 6
    assert "messages on /madrob/door/angle" in out


def test_a_state_names_phase_condition_and_start_and_nonsense_is_refused_in_a_line() -> None:
    parsed = parse_state(said.state_text("running", 12.5, CW))
    assert (parsed.phase, parsed.condition, parsed.start_time) == ("running", CW, 12.5)
    assert parse_state(said.state_text("idle", None, None)).condition is None
    for text in ("", "[]", "3", '{"phase": "idle", "condition_number": 77}', "{" * 100):
        with pytest.raises(MadrobError) as caught:
            parse_state(text)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 140


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("opening_side", "cw", "'cw' is neither CW nor CCW"),
        ("benchmark_type", "Hard", "'Hard' is no benchmark type"),
        ("brake_lut_cw", [0] * 180, "180 braking forces instead of 181"),
        ("brake_lut_ccw", [0] * 181, None),
        ("benchmark_type", "Wind Ramp", None),
        ("brake_enabled", True, None),
    ],
)
def test_parameters_that_mean_nothing_are_refused(
    name: str, value: str | bool | list[int], reason: str | None
) -> None:
    assert refusal(name, value) == reason


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ("opening_side:=cw", "parameter opening_side: 'cw' is neither CW nor CCW"),
        ("opening_side:=7", "parameter opening_side: "),
        ("benchmark_type:=Storm", "parameter benchmark_type: 'Storm' is no benchmark type"),
    ],
)
def test_a_parameter_that_makes_no_sense_is_refused(parameter: str, words: str) -> None:
    with pytest.raises(MadrobError, match=f"^{words}"):
        serve_testbed(SimulatedTestbed(), None, 1, say=print, ros_args=["-p", parameter])


def test_parameters_of_the_command_line_are_those_of_the_door(peer: Peer) -> None:
    testbed = SimulatedTestbed()
    ros_args = ["-p", "opening_side:=CW", "-p", "benchmark_type:=Constant Force"]
    with serving(testbed, ros_args=[*ros_args, "-r", "__ns:=/hall2"]) as lines:
        service = load_module("rcl_interfaces.srv").GetParameters
        client = peer.own.create_client(service, "/hall2/door/get_parameters")
        peer.until(client.service_is_ready)
        answer = client.call_async(service.Request(names=["opening_side", "benchmark_type"]))
        peer.until(answer.done)
    assert [one.string_value for one in answer.result().values] == ["CW", "Constant Force"]
    assert testbed.condition == Condition(BenchmarkType.CONSTANT_FORCE, Side.CW, Side.CCW)
    assert lines[:2] == ["opening side set to CW", "benchmark type set to Constant Force"]
