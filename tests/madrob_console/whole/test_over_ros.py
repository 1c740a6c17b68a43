"""Testbeds, referees and consoles in processes of their own, DDS between them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from madrob_console.archive import score
from madrob_console.common.clock import SystemClock
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.requests import Perform
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import Snapshot
from madrob_console.messages.codec import REFEREE_RUNNING_TOPIC, REFEREE_STATE_TOPIC
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import Abort, SetUp
from madrob_console.referee.checks import CheckState
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import CheckName
from madrob_console.testbeds.ros import RosSource
from recorder.reader import Bag
from scoring.protocol import Signal
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.engine.spoilt import DOOR
from tests.madrob_console.engine_process import (
    ROOT,
    EngineProcess,
    journal_of,
    madrob_beside,
    result_of,
)
from tests.madrob_console.ros_peer import (
    BOOL,
    KEPT,
    Kind,
    Peer,
    Stream,
    cameras,
    truth,
)
from tests.watching import Stutter, until

TOPICS = [m.topic for m in DEFAULT_MAPPINGS if m.signal is not Signal.LATCH]
STRING = "std_msgs/msg/String"
SAMPLE = 0.02  # s, of the simulated sensors
AT_ONCE = 0.2  # s, of an abort
BUSY = 8.0  # s; as long as DDS takes beside two busy cores

LOGGED = """
import sys
from hashlib import sha256
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource

take, log = SimulatedSource.take_messages, open(sys.argv.pop(1), "w", buffering=1)

def logged(self, timeout):
    messages = take(self, timeout)
    for message in messages:
        log.write(f"{message.topic} {sha256(message.data).hexdigest()}\\n")
    return messages

SimulatedSource.take_messages = logged
"""
"""A testbed that writes down what it publishes."""


def digests(folder: Path) -> dict[str, list[str]]:
    """Of the recorded messages of each topic."""
    recorded = defaultdict(list)
    for message in Bag(folder).messages():
        recorded[message.topic].append(sha256(message.data).hexdigest())
    return recorded


@dataclass(frozen=True, slots=True)
class Ran:
    """A run of `madrob run` as it lies on disk.

    Attributes:
        folder: of the run.
        said: by the command.
        published: digests of what the testbed had published, by topic.
        stutter: of the machine meanwhile.
    """

    folder: Path
    said: str
    published: dict[str, list[str]]
    stutter: Stutter = field(default_factory=Stutter)

    @property
    def result(self) -> dict[str, Any]:
        return result_of(self.folder)

    @property
    def entries(self) -> tuple[Entry, ...]:
        return journal_of(self.folder)

    def events(self) -> list[tuple[str, float]]:
        return [(event["event"], event["since_start"]) for event in self.result["events"]]

    def lateness(self) -> list[float]:
        """How long after its stamp each event was noted, s."""
        events = (entry for entry in self.entries if entry.what == Change.EVENT)
        return [entry.time - float(entry.details["time"]) for entry in events]

    def check_whole(self) -> None:
        """Completed; every message of the testbed is there, from the first recorded to the last."""
        assert self.result["outcome"] == "completed"
        recorded = digests(self.folder)
        for topic in TOPICS:
            first = self.published[topic].index(recorded[topic][0])
            count = len(recorded[topic])
            assert recorded[topic] == self.published[topic][first : first + count]


def ran(
    folder: Path, settings: str = "", abort_after: float | None = None, stall: float = 0.0
) -> Ran:
    """One run of `madrob run` with a testbed over DDS.

    It is aborted so long after its start, or stands still for so long while the robot passes, s.
    """
    folder.mkdir()
    file, log = folder / "hall.toml", folder / "published"
    file.write_text(settings)
    lines, aborted = [], 0.0
    with (
        madrob_beside(log, "testbed", "--scenario=nominal", before=LOGGED) as testbed,
        madrob_beside(
            *("run", "--testbed", "ros", "--settings", file, "--countdown=2", "--timeout=60"),
            *("--no-report", "--results", folder / "results", "--wait=60", "--waive", "a test"),
        ) as run,
        Stutter() as stutter,
    ):
        assert run.stdout is not None
        for line in run.stdout:
            lines.append(line)
            if stall and "run starts" in line:
                time.sleep(9.6)
                run.send_signal(signal.SIGSTOP)
                time.sleep(stall)
                run.send_signal(signal.SIGCONT)
            if abort_after is not None and "run starts" in line:
                time.sleep(abort_after)
                aborted = time.time()
                run.send_signal(signal.SIGTERM)
        run.wait()
        testbed.send_signal(signal.SIGINT)
    said = "".join(lines)
    assert run.returncode == (0 if abort_after is None else 4), said
    seen = defaultdict(list)
    for published in log.read_text().splitlines():
        topic, digest = published.split()
        seen[topic].append(digest)
    one = Ran(Path(said.splitlines()[-1].removeprefix("run folder: ")), said, seen, stutter)
    if abort_after is not None:
        stops = next(entry for entry in one.entries if entry.what == "abort")
        print(f"abort took effect after {stops.time - aborted:.3f} s")
        assert stops.time - aborted < AT_ONCE + stutter.allowance
    return one


@contextmanager
def program(output: Path, *arguments: str, ending: signal.Signals) -> Iterator[None]:
    """A Python program beside the engine, until the end."""
    with output.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, *arguments], cwd=ROOT, stdout=out, stderr=subprocess.STDOUT
        )
    try:
        yield
    finally:
        process.send_signal(ending)
        assert process.wait(30) == (0 if ending is signal.SIGINT else -ending)


def robot_of_the_guide(folder: Path) -> str:
    guide = (ROOT / "madrob_console/guide/robots.md").read_text()
    (node,) = re.findall(r"^```python\n(import rclpy\n(?:.*\n)+?)```$", guide, re.MULTILINE)
    robot = folder / "robot.py"
    robot.write_text(node)
    return str(robot)


def what_it_did(said: Path) -> list[str]:
    return [line.rpartition(": ")[2] for line in said.read_text().splitlines()]


def test_the_robot_of_the_guide_joins_late_and_is_misled_by_no_order_of_messages(
    peer: Peer, ros_domain: int, tmp_path: Path
) -> None:
    said = tmp_path / "said"
    running = peer.publisher(REFEREE_RUNNING_TOPIC, BOOL, KEPT)
    running.publish(truth(True))  # before the robot is there
    with program(said, robot_of_the_guide(tmp_path), ending=signal.SIGINT):
        peer.until(lambda: said.exists() and what_it_did(said) == ["set out"])
        done = ["set out"]
        for goes_on, does in ((False, "stop"), (True, "set out"), (False, "stop")):
            done.append(does)
            for _ in range(2):
                running.publish(truth(not goes_on))  # as it was, once more
            for _ in range(2):
                running.publish(truth(goes_on))
            peer.until(lambda: what_it_did(said) == done)


def test_a_held_engine_shifts_no_stamp(ros_domain: int, tmp_path: Path) -> None:
    """Messages that waited come at once."""
    stalled = ran(tmp_path / "stalled", stall=3.5)
    quality = stalled.result["quality"]
    assert [signal["shifted"] for signal in quality["signals"]] == [0] * len(quality["signals"])
    faults = " ".join(fault["text"] for fault in stalled.result["faults"])
    assert "the engine stood still for 3." in faults
    again = next(score(stalled.folder)).result.events
    assert [(str(event.event), event.since_start) for event in again] == stalled.events()


def referee_check(snapshot: Snapshot) -> tuple[CheckState, str]:
    check = next(c for c in snapshot.checks if c.name is CheckName.REFEREE)
    return check.state, check.reason


def named(snapshot: Snapshot) -> bool:
    return any(line.startswith("another referee: ") for line in snapshot.faults)


def test_each_of_two_engines_in_a_domain_names_the_other_until_it_is_killed(
    peer: Peer, ros_domain: int, tmp_path: Path
) -> None:
    """One is as of another machine: no lock of this one keeps it out."""
    clock, types = SystemClock(), MessageTypes()
    source = RosSource(DEFAULT_MAPPINGS, types, clock, ros_domain)
    config = EngineConfig(tmp_path / "own", DEFAULT_MAPPINGS, disk_needed=0)
    own = Engine(source, clock, config, types)
    with closing(LocalEngine(own, no_reporting(config.results))) as local:
        peer.until(lambda: peer.own.get_publishers_info_by_topic(REFEREE_STATE_TOPIC))
        assert not named(local.snapshot())
        with EngineProcess(tmp_path / "other", None) as other:
            until(lambda: named(local.snapshot()) and named(other.snapshot()), BUSY)
            for engine in (local, other.client):
                assert engine.send_request(Perform.of(SetUp(make_setup()))) is None
                until(lambda engine=engine: engine.snapshot().run.setup is not None)  # type: ignore[misc]
                state, reason = referee_check(engine.snapshot())
                assert state is CheckState.FAILED  # one of those that block a start
                assert "publishes" in reason
            # a publisher may be known before the name of its node
            until(lambda: f"(pid {other.process.pid} on " in referee_check(local.snapshot())[1])
            other.process.kill()
            other.process.wait()
            until(lambda: not named(local.snapshot()), BUSY)
        assert referee_check(local.snapshot())[0] is CheckState.OK


NAMES = 500_000
RATE = 5.0
HEAVY = 4_000_000
WATCHED = 6.0
"""s of a run in which nothing happens but heavy messages."""
LONGEST_WAIT = 1.0  # s; 0.2 on a machine that has nothing else to do
UNDER_WAY = 1.0
"""s; what was sent so long before the end has come before it."""

PUBLISH = f"""
import os, sys, time
from madrob_console.testbeds.ros.connection import load_module
from tests.madrob_console.ros_peer import TYPES, Peer
patience = load_module("rclpy.duration").Duration(seconds=30)
with Peer(int(os.environ["ROS_DOMAIN_ID"])) as peer:
    publisher = peer.publisher("{DOOR}", "sensor_msgs/msg/JointState")
    data = TYPES.encode("sensor_msgs/msg/JointState",
        TYPES.make("sensor_msgs/msg/JointState", name=[""] * {NAMES}))
    begin, count = time.monotonic(), 0
    while True:
        time.sleep(max(0.0, begin + count / {RATE} - time.monotonic()))
        publisher.publish(data)
        assert publisher.wait_for_all_acked(patience)
        print(time.time(), flush=True)  # the engine has it
        count += 1
"""


def clock_behind(engine: EngineProcess, duration: float) -> float:
    """How far the clock on the screen was behind at most, s."""
    worst, end = 0.0, time.monotonic() + duration

    def watched() -> bool:
        nonlocal worst
        worst = max(worst, time.time() - engine.snapshot().time)
        return time.monotonic() > end

    until(watched, duration + LONGEST_WAIT)
    return worst


@pytest.mark.slow
def test_4_mb_five_times_a_second_delay_neither_clock_nor_abort_and_are_recorded(
    peer: Peer, tmp_path: Path
) -> None:
    states = peer.listen(REFEREE_STATE_TOPIC, STRING, KEPT)
    published = tmp_path / "published"
    with (
        madrob_beside("testbed", "--scenario=nominal", "--repeat=0", output=tmp_path / "testbed"),
        EngineProcess(tmp_path / "runs", None) as engine,
        Stutter() as stutter,
    ):
        engine.wait_for(lambda s: all(t.rate for t in s.topics if not t.optional))
        with program(published, "-c", PUBLISH, ending=signal.SIGKILL):
            engine.wait_for(lambda s: any("bytes, not read above" in line for line in s.all_faults))
            engine.start(make_setup(countdown=1.0), waived=(CheckName.TOPICS,))
            behind = clock_behind(engine, WATCHED)
            pressed = time.monotonic()
            engine.act(Abort("enough"))
            answered = time.monotonic() - pressed
            peer.until(lambda: any("aborted" in state.data for state in states))
            announced = time.monotonic() - pressed
            document = engine.result()
            lost = [t.lost for t in engine.snapshot().topics if t.topic != DOOR]
            folder = engine.folder
    print(f"clock {behind:.2f} s behind, abort answered after {answered:.2f}, {announced:.2f} s")
    assert not any(lost), lost
    begin, end = document["start"], document["stop"] - UNDER_WAY
    sent = sum(begin <= float(line) < end for line in published.read_text().splitlines())
    assert sum(len(m.data) > HEAVY for m in Bag(folder).messages()) >= sent > 0
    remarks = document["quality"]["remarks"]
    assert any("not read above" in line for line in remarks)
    assert next(score(folder)).result.quality.remarks == tuple(remarks)
    assert max(behind, answered, announced) < LONGEST_WAIT + stutter.allowance


HALL = Stream(Kind.JPEG, count=4, rate=30, size=200_000, reliable=True)
FAR_TOO_MUCH = (
    Stream(Kind.RAW, "/camera/raw{}", count=4, rate=60, size=3_000_000),
    Stream(Kind.POSE, "/camera/flood{}", count=4, rate=1000),
    Stream(Kind.RAW, "/camera/huge", count=1, rate=2, size=50_000_000),
)


def evidence_of(*streams: Stream) -> str:
    """The settings that record cameras beside the run."""
    return f"[evidence]\ntopics = {[topic for stream in streams for topic in stream.topics]}\n"


def check_cameras(run: Ran) -> None:
    """They are recorded to the end of the run, into a bag that any reader takes."""
    evidence = rebuild(run.entries).evidence
    assert evidence is not None
    recorded = list(Bag(run.folder, evidence=True).messages())
    counts = Counter(message.topic for message in recorded)
    assert counts == {name: topic.recorded for name, topic in evidence.topics.items()}
    assert set(counts) == set(HALL.topics)
    start, stop = run.result["start"] * 1e9, run.result["stop"] * 1e9
    for topic in HALL.topics:
        times = [m.receive_ns for m in recorded if m.topic == topic]
        assert times[0] < start
        assert times[-1] > stop
    with AnyReader([run.folder / f"{run.folder.name}_evidence"]) as reader:
        assert {connection.topic for connection in reader.connections} == set(HALL.topics)


@pytest.mark.slow
def test_evidence_beyond_all_measure_costs_the_score_nothing_and_is_told(
    peer: Peer, tmp_path: Path
) -> None:
    """Beside a run without any; as many cameras as a hall has are all recorded."""
    calm = ran(tmp_path / "calm")
    with cameras(HALL):
        own = peer.own
        peer.until(lambda: all(map(own.get_publishers_info_by_topic, HALL.topics)))
        filmed = ran(tmp_path / "filmed", evidence_of(HALL))
    filmed.check_whole()
    check_cameras(filmed)
    with ExitStack() as stack:
        for stream in FAR_TOO_MUCH:  # machines of their own: they leave the testbed its processor
            process = stack.enter_context(cameras(stream))
            os.setpriority(os.PRIO_PROCESS, process.pid, 19)
        flooded = ran(tmp_path / "flooded", evidence_of(*FAR_TOO_MUCH))
        ran(tmp_path / "aborted", evidence_of(*FAR_TOO_MUCH), abort_after=2.0)
    flooded.check_whole()
    late, usual = max(flooded.lateness()), max(calm.lateness())
    print(f"events noted after {late:.3f} s at most, without evidence after {usual:.3f} s")
    assert late < usual + SAMPLE + calm.stutter.allowance
    remarks = flooded.result["quality"]["remarks"]
    assert not [remark for remark in remarks if "not in the rec" in remark]
    assert any(one["lost"] for one in flooded.result["evidence"]["topics"].values())
    (told,) = [line for line in flooded.said.splitlines() if "evidence recorded: " in line]
    assert told.endswith(" lost")
