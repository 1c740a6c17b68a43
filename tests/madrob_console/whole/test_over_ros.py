"""Testbeds, referees and consoles in processes of their own, DDS between them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from subprocess import PIPE, STDOUT
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from madrob_console.archive import score
from madrob_console.cli.main import main
from madrob_console.common.clock import NS, Clock, SystemClock
from madrob_console.engine.core import Engine
from madrob_console.engine.engine_config import EngineConfig
from madrob_console.engine.engine_thread import LocalEngine
from madrob_console.engine.requests import Perform
from madrob_console.engine.snapshot import Snapshot
from madrob_console.messages.codec import DEFAULT_MAPPINGS, REFEREE_STATE_TOPIC, decode_text
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.checks import CheckState, blocking
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.connection import RosObject
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import INFO_TOPIC
from recorder.bag import RawMessage
from recorder.reader import read_bag
from scoring.protocol import Signal
from tests.madrob_console.camera_peer import Kind, Stream, cameras
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.spoilt import DOOR
from tests.madrob_console.engine_process import ROOT, EngineProcess
from tests.madrob_console.ros_peer import KEPT, TYPES, Peer
from tests.watching import until

TOPICS = [m.topic for m in DEFAULT_MAPPINGS if m.signal is not Signal.LATCH]

LOGGING_TESTBED = """
import sys
from hashlib import sha256
from madrob_console.cli.main import main
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource

take, log = SimulatedSource.take_messages, open(sys.argv[1], "w", buffering=1)

def logged(self, timeout):
    messages = take(self, timeout)
    for message in messages:
        log.write(f"{message.topic} {sha256(message.data).hexdigest()}\\n")
    return messages

SimulatedSource.take_messages = logged
sys.exit(main(["testbed", "--scenario", "nominal"]))
"""


@pytest.mark.parametrize(
    ("settings", "offered"), [("", []), ("[ros]\nabort = true\n", ["std_srvs/srv/Trigger"])]
)
def test_an_engine_offers_an_abort_only_where_the_settings_allow_it(
    settings: str, offered: list[str], peer: Peer, tmp_path: Path
) -> None:
    with EngineProcess(tmp_path / "results", None, settings=settings):
        peer.until(lambda: peer.own.get_publishers_info_by_topic(REFEREE_STATE_TOPIC))
        found = dict(peer.own.get_service_names_and_types())
    assert [types for name, (types,) in found.items() if name.endswith("/abort")] == offered


@pytest.mark.slow
def test_a_run_over_dds_is_completed_recorded_whole_and_scored_the_same_again(
    ros_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "published"
    with subprocess.Popen(
        [sys.executable, "-c", LOGGING_TESTBED, str(log)], env=os.environ
    ) as testbed:
        try:
            run = subprocess.run(
                [sys.executable, "-m", "madrob_console.cli.main", "run", "--testbed", "ros",
                 "--countdown", "2", "--timeout", "60", "--results", str(tmp_path / "results")],
                env=os.environ, capture_output=True, text=True, check=False, timeout=120,
            )  # fmt: skip
            assert testbed.wait(30) == 0
        finally:
            testbed.kill()
    assert run.returncode == 0, run.stdout + run.stderr
    folder = Path(run.stdout.splitlines()[-1].removeprefix("run folder: "))
    result = json.loads((folder / "result.json").read_text())
    assert "testbed: SIMULATED over ROS domain " in run.stdout
    assert folder.parent == tmp_path / "results" / "practice"
    assert (result["outcome"], result["source"]) == ("completed", "simulated")
    assert result["setup"]["practice"]
    assert result["indicators"]["capability_level"]["value"] == 6
    assert all(i["value"] is not None for i in result["indicators"].values())
    assert result["quality"]["remarks"] == []
    recorded = read_recorded(folder)
    assert len(recorded[INFO_TOPIC]) == 1
    published = read_published(log)
    for topic in TOPICS:
        first = published[topic].index(recorded[topic][0])
        count = len(recorded[topic])
        assert recorded[topic] == published[topic][first : first + count]
        print(f"{topic}: {count} messages, as published")
    read_by_others(folder, {topic: len(recorded[topic]) for topic in TOPICS})
    capsys.readouterr()
    assert main(["score", "--json", str(folder)]) == 0
    again = json.loads(capsys.readouterr().out)["runs"][0]
    for part in ("indicators", "events", "steps", "quality"):
        assert again[part] == result[part]


GUIDE = ROOT / "madrob_console/guide/robots.md"


@pytest.mark.timeout(300)
def test_the_robot_of_the_guide_starts_on_the_signal_and_the_result_says_when(
    ros_domain: int, tmp_path: Path
) -> None:
    (node,) = re.findall(
        r"^```python\n(import json\n(?:.*\n)+?)```$", GUIDE.read_text(), re.MULTILINE
    )
    robot, said = tmp_path / "robot.py", tmp_path / "said"
    robot.write_text(node)
    with (
        program(tmp_path / "testbed", *TESTBED),
        program(said, str(robot), ending=signal.SIGINT),
    ):
        run = subprocess.run(
            [sys.executable, "-m", "madrob_console.cli.main", "run", "--testbed", "ros",
             "--countdown", "2", "--timeout", "60", "--wait", "60", "--no-report",
             "--results", str(tmp_path / "results")],
            env=os.environ, capture_output=True, text=True, check=False, timeout=200,
        )  # fmt: skip
        assert run.returncode == 0, run.stdout + run.stderr
        until(lambda: "stop" in said.read_text())
    folder = Path(run.stdout.splitlines()[-1].removeprefix("run folder: "))
    result = json.loads((folder / "result.json").read_text())
    after = result["robot_start"] - result["start"]
    print(f"the robot answered {after:.3f} s after the start")
    assert 0 < after < LARGEST_DELAY + BUSY
    words = f"the robot answered to the start {after:.3f} s after it"
    assert words in result["quality"]["remarks"]
    assert f"note: {words}" in run.stdout
    assert [line.rpartition(": ")[2] for line in said.read_text().splitlines()] == [
        "set out",
        "stop",
    ]


def read_recorded(folder: Path) -> dict[str, list[str]]:
    recorded = defaultdict(list)
    for message in read_bag(folder).messages():
        recorded[message.topic].append(sha256(message.data).hexdigest())
    return recorded


def read_published(log: Path) -> dict[str, list[str]]:
    published = defaultdict(list)
    for line in log.read_text().splitlines():
        topic, digest = line.split()
        published[topic].append(digest)
    return published


def read_by_others(folder: Path, counts: dict[str, int]) -> None:
    with AnyReader([folder]) as reader:
        seen = Counter(connection.topic for connection, _, _ in reader.messages())
    assert {topic: seen[topic] for topic in counts} == counts
    with next(folder.glob("*.mcap")).open("rb") as file:
        decoding = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = Counter(m.channel.topic for m in decoding.iter_decoded_messages())
    assert {topic: decoded[topic] for topic in counts} == counts


SOON = 2.0
"""s; and as long as DDS takes beside two busy cores."""
BUSY = 8.0


@pytest.fixture
def local(ros_domain: int, tmp_path: Path) -> Iterator[LocalEngine]:
    """An engine that no lock of this machine keeps out: as one of another machine."""
    clock, types = SystemClock(), MessageTypes()
    source = RosSource(DEFAULT_MAPPINGS, types, clock, ros_domain)
    config = EngineConfig(tmp_path / "own", DEFAULT_MAPPINGS, disk_needed=0)
    engine = LocalEngine(Engine(source, clock, config, types))
    try:
        yield engine
    finally:
        engine.close()


def referee_check(snapshot: Snapshot) -> tuple[CheckState, str]:
    check = next(c for c in snapshot.checks if c.name is CheckName.REFEREE)
    return check.state, check.reason


def named(snapshot: Snapshot) -> bool:
    return any(line.startswith("another referee: ") for line in snapshot.faults)


def test_each_of_two_engines_in_a_domain_names_the_other_and_one_that_was_killed_is_gone(
    local: LocalEngine, tmp_path: Path
) -> None:
    assert not named(local.snapshot())
    with EngineProcess(tmp_path / "other", None) as other:
        there = time.monotonic()
        until(lambda: named(local.snapshot()) and named(other.snapshot()), SOON + BUSY)
        print(f"both named after {time.monotonic() - there:.2f} s")
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
        killed = time.monotonic()
        until(lambda: not named(local.snapshot()), SOON + BUSY)
        print(f"gone after {time.monotonic() - killed:.2f} s")
    assert referee_check(local.snapshot())[0] is CheckState.OK


BEGIN = 100.0
_BUSY = "the disk did not take it within"
STRING, CLOCK = "std_msgs/msg/String", "rosgraph_msgs/msg/Clock"


class WorldClock(Clock):
    """The time in the simulated world; `pace` is so many times as fast as the machine's clock."""

    def __init__(self, pace: float) -> None:
        self._pace = pace
        self._from, self._since = BEGIN, time.monotonic()

    def now_ns(self) -> int:
        return round((self._from + (time.monotonic() - self._since) * self._pace) * NS)

    def go_on(self, pace: float, at: float | None = None) -> None:
        """From now on at this pace; from another time of the world, s, if one is given."""
        self._from = self.now_ns() / NS if at is None else at
        self._pace, self._since = pace, time.monotonic()

    def sleep(self, duration: float) -> None:
        """Nobody waits for it."""


Accident = tuple[float, Callable[[WorldClock], object]]
"""So long after the start, s of the machine's time, this happens to the simulation."""


class World:
    """What Gazebo would publish; it does not say that it is simulated."""

    def __init__(self, peer: Peer, pace: float) -> None:
        self._peer, self._clock = peer, WorldClock(pace)
        self._testbed = SimulatedSource(None, self._clock, TYPES)
        self._testbed.open()
        self._publishers = {
            s.topic: peer.publisher(s.topic, s.type) for s in self._testbed.status()
        }
        self._clock_publisher = peer.publisher("/clock", CLOCK)
        self._states = peer.listen_raw(REFEREE_STATE_TOPIC, STRING, KEPT)
        self._started: float | None = None

    def go_on(self) -> None:
        """Publish what is due, and heed the referee."""
        self._peer.spin(0.005)
        now = self._clock.now_ns()
        stamp = TYPES.make("builtin_interfaces/msg/Time", sec=now // NS, nanosec=now % NS)
        self._clock_publisher.publish(TYPES.encode(CLOCK, TYPES.make(CLOCK, clock=stamp)))
        for message in self._testbed.take_messages(0):
            self._publishers[message.topic].publish(message.data)
        while self._states:
            data = self._states.pop(0)
            self._testbed.publish(RawMessage(REFEREE_STATE_TOPIC, STRING, data, 0, 0))
            if json.loads(decode_text(TYPES, data))["phase"] == Phase.RUNNING:
                self._started = time.monotonic()

    def run(self, *options: str, accidents: Sequence[Accident] = ()) -> tuple[int, str, str]:
        """`madrob run` in this world: its exit code, what it said, what it complained of."""
        program = [sys.executable, "-m", "madrob_console.cli.main", "run", "--testbed", "ros"]
        self._started, left = None, list(accidents)
        with subprocess.Popen(
            [*program, *options],
            env=os.environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            while process.poll() is None:
                self.go_on()
                if left and self._started and time.monotonic() - self._started > left[0][0]:
                    left.pop(0)[1](self._clock)
            said, complained = process.communicate()
        return process.returncode, said, complained

    def result(self, *options: str, code: int = 0, accidents: Sequence[Accident] = ()) -> Path:
        """The folder of a run that ended with this code."""
        complained = _BUSY
        while _BUSY in complained:  # nothing was done: a referee starts again
            ended, said, complained = self.run(*options, accidents=accidents)
        assert ended == code, said + complained
        return Path(said.splitlines()[-1].removeprefix("run folder: "))


def lenient(tmp_path: Path, more: str = "") -> str:
    """Settings for a busy machine, which publishes late."""
    settings = tmp_path / "madrob.toml"
    settings.write_text(f"[checks]\nlargest_skew = 2.0\n{more}")
    return f"--settings={settings}"


def result_of(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return result


@pytest.mark.timeout(300)
@pytest.mark.parametrize("pace", [3.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_a_run_on_the_time_of_a_simulation_is_practice_completed_and_scored(
    pace: float,
    peer: Peer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    settings = lenient(tmp_path, "[testbed]\nuse_sim_time = true\n")
    folder = World(peer, pace).result(
        "--countdown=2", "--timeout=60", "--wait=100", settings, f"--results={tmp_path}"
    )
    assert folder.parent == tmp_path / "practice"
    result = result_of(folder)
    assert (result["outcome"], result["source"]) == ("completed", "simulated")
    assert BEGIN < result["start"] < BEGIN + 100 * pace
    assert result["indicators"]["execution_time"]["value"] == pytest.approx(13.85, abs=0.1)
    assert result["indicators"]["capability_level"]["value"] == 6
    assert all(i["value"] is not None for i in result["indicators"].values())
    assert main(["score", "--check", str(folder)]) == 0
    capsys.readouterr()
    assert main(["run", "--testbed", "replay", str(folder), "--speed=0"]) == 0
    replayed = capsys.readouterr().out
    assert "replay: equals the stored result to the last digit" in replayed, replayed


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_simulation_that_stops_or_begins_anew_costs_its_run_and_no_other(
    peer: Peer, tmp_path: Path
) -> None:
    world = World(peer, 1.0)
    results, settings = f"--results={tmp_path}", lenient(tmp_path)
    options = ("--countdown=2", "--wait=60", "--no-report", results, settings)
    code, said, complained = world.run(*options, "--wait=10", "--waive=a proof")
    assert code == 2, said
    words = "start the engine again with --use-sim-time: stamps are of simulated time"
    assert f"the check 'clock skew' cannot be waived: {words}" in complained

    follow = (*options, "--ros-args", "-p", "use_sim_time:=true")
    stops = [(3.0, lambda clock: clock.go_on(0.0)), (8.0, lambda clock: clock.go_on(1.0))]
    paused = result_of(world.result("--timeout=60", *follow, accidents=stops))
    assert (paused["outcome"], paused["indicators"]["capability_level"]["value"]) == (
        "completed",
        6,
    )
    assert paused["indicators"]["execution_time"]["value"] == pytest.approx(13.85, abs=0.1)
    assert any("/clock is silent" in remark for remark in paused["quality"]["remarks"])

    anew = [(3.0, lambda clock: clock.go_on(1.0, at=10.0))]
    reset = result_of(world.result("--timeout=10", *follow, code=3, accidents=anew))
    assert (reset["outcome"], reset["indicators"]["capability_level"]["value"]) == ("timeout", 1)
    assert reset["start"] > paused["start"]
    assert any("clock stepped by -" in remark for remark in reset["quality"]["remarks"])

    after = result_of(world.result("--timeout=60", *follow))
    assert (after["outcome"], after["indicators"]["capability_level"]["value"]) == ("completed", 6)
    assert 10.0 < after["start"] < BEGIN


NAMES = 500_000
RATE = 5.0
RUNS = 3
HEAVY = 4_000_000
WATCHED = 6.0
"""s of a run in which nothing happens but heavy messages."""
LONGEST_WAIT = 1.0
"""s; 0.2 on a machine that has nothing else to do."""

PUBLISH = f"""
import os, sys, time
from tests.madrob_console.ros_peer import TYPES, Peer
with Peer(int(os.environ["ROS_DOMAIN_ID"])) as peer:
    publisher = peer.publisher("{DOOR}", "sensor_msgs/msg/JointState")
    data = TYPES.encode("sensor_msgs/msg/JointState",
        TYPES.make("sensor_msgs/msg/JointState", name=[""] * {NAMES}))
    begin, count = time.monotonic(), 0
    while True:
        time.sleep(max(0.0, begin + count / {RATE} - time.monotonic()))
        publisher.publish(data)
        print(time.time(), flush=True)
        count += 1
"""
TESTBED = ["-m", "madrob_console.cli.main", "testbed", "--scenario", "nominal", "--repeat", "0"]


@contextmanager
def program(
    output: Path, *arguments: str, ending: signal.Signals = signal.SIGKILL
) -> Iterator[None]:
    """A Python program beside the engine, until the end."""
    with output.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, *arguments], cwd=ROOT, stdout=out, stderr=STDOUT
        )
    try:
        yield
    finally:
        process.send_signal(ending)
        assert process.wait(30) == (0 if ending is signal.SIGINT else -ending)


def said(states: Sequence[RosObject]) -> str:
    return "".join(state.data for state in states)


def count_between(published: Path, begin: float, end: float) -> int:
    """How many heavy messages were sent in a run."""
    return sum(begin <= float(line) < end for line in published.read_text().splitlines())


def processor_time(pid: int) -> float:
    """Of a process and its threads, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def begin_run(engine: EngineProcess, number: int) -> None:
    engine.act(SetUp(make_setup(run_number=number, countdown=1.0)))
    mendable = {CheckName.POSE, CheckName.HANDLE, CheckName.TOPICS}
    engine.wait_for(lambda s: {c.name for c in blocking(s.checks)} <= mendable)
    fresh = engine.snapshot().time
    engine.wait_for(lambda s: s.time > fresh + 1.1)
    engine.act(ZeroHandle(), ConfirmPose())
    for check in blocking(engine.snapshot().checks):
        engine.act(Waive(check.name, "a proof"))
    engine.act(Start())
    engine.wait_for(lambda s: s.run.phase is Phase.RUNNING)


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
    states = peer.listen(REFEREE_STATE_TOPIC, "std_msgs/msg/String", KEPT)
    clocks, aborts, announced, loads = [], [], [], []
    published = tmp_path / "published"
    with program(tmp_path / "testbed", *TESTBED), EngineProcess(tmp_path / "runs", None) as engine:
        engine.wait_for(lambda s: all(t.rate for t in s.topics if not t.optional))
        used, at = processor_time(engine.process.pid), time.monotonic()
        until(lambda: time.monotonic() > at + 3.0)
        idle = (processor_time(engine.process.pid) - used) / (time.monotonic() - at)
        with program(published, "-c", PUBLISH):
            engine.wait_for(lambda s: any("bytes, not read above" in line for line in s.all_faults))
            for number in range(1, RUNS + 1):
                begin_run(engine, number)
                used, at = processor_time(engine.process.pid), time.monotonic()
                clocks.append(clock_behind(engine, WATCHED))
                loads.append((processor_time(engine.process.pid) - used) / (time.monotonic() - at))
                before, pressed = len(states), time.monotonic()
                assert engine.client.send_request(Perform.of(Abort("enough"))) is None
                aborts.append(time.monotonic() - pressed)
                peer.until(lambda before=before: "aborted" in said(states[before:]))  # type: ignore[misc]
                announced.append(time.monotonic() - pressed)
                document = engine.result()
                lost = [t.lost for t in engine.snapshot().topics if t.topic != DOOR]
                assert not any(lost), lost
                folder = engine.folder
                begin, end = document["start"], document["stop"]
                recorded = sum(len(m.data) > HEAVY for m in read_bag(folder).messages())
                assert recorded >= count_between(published, begin, end) > 0
                remarks = document["quality"]["remarks"]
                assert any("not read above" in line for line in remarks)
                assert next(score(folder)).result.quality.remarks == tuple(remarks)
    print(
        f"{len(aborts)} runs: clock at most {1000 * max(clocks):.0f} ms behind, abort answered "
        f"after {1000 * max(aborts):.0f} ms, announced after {1000 * max(announced):.0f} ms at "
        f"most; CPU {100 * idle:.0f} % without, {100 * max(loads):.0f} % with heavy messages"
    )
    assert max(clocks) < LONGEST_WAIT
    assert max(aborts) < LONGEST_WAIT
    assert max(announced) < LONGEST_WAIT


HALL = Stream(Kind.JPEG, count=4, rate=30, size=200_000, reliable=True)
FAR_TOO_MUCH = (
    Stream(Kind.RAW, "/camera/raw{}", count=4, rate=60, size=3_000_000),
    Stream(Kind.POSE, "/camera/flood{}", count=4, rate=1000),
    Stream(Kind.RAW, "/camera/huge", count=1, rate=2, size=50_000_000),
)
LARGEST_DELAY = 0.2  # s, of an abort
SAMPLE = 0.02  # s, of the simulated sensors


@dataclass(frozen=True, slots=True)
class Ran:
    """A run as it lies on disk, and what the testbed had published."""

    folder: Path
    said: str
    published: dict[str, list[str]]

    @property
    def entries(self) -> tuple[Entry, ...]:
        return read_journal(self.folder / "journal.jsonl")[0]

    def lateness(self) -> list[float]:
        """How long after its stamp each event was noted, s."""
        events = (entry for entry in self.entries if entry.what == Change.EVENT)
        return [entry.time - float(entry.details["time"]) for entry in events]

    def demand_testbed_whole(self) -> None:
        """Every message of the testbed, from the first that is recorded to the last."""
        recorded = read_recorded(self.folder)
        for topic in TOPICS:
            first = self.published[topic].index(recorded[topic][0])
            count = len(recorded[topic])
            assert recorded[topic] == self.published[topic][first : first + count]


@contextmanager
def a_testbed(log: Path) -> Iterator[None]:
    with subprocess.Popen([sys.executable, "-c", LOGGING_TESTBED, str(log)]) as process:
        try:
            yield
        finally:
            process.send_signal(signal.SIGINT)


@contextmanager
def patient(stream: Stream) -> Iterator[None]:
    """Cameras that stand for machines of their own: they leave the testbed its processor."""
    with cameras(stream) as process:
        os.setpriority(os.PRIO_PROCESS, process.pid, 19)
        yield


def ran(tmp_path: Path, *, evidence: bool = True, abort_after: float | None = None) -> Ran:
    """One run of `madrob run`, aborted so long after its start, s."""
    settings, log = tmp_path / "hall.toml", tmp_path / "published"
    wished = '[recording]\ntopics = ["/camera/**"]\nleast_room = 0\n' if evidence else ""
    settings.write_text(wished)
    command = [
        *(sys.executable, "-m", "madrob_console.cli.main", "run", "--testbed", "ros"),
        *("--settings", str(settings), "--countdown", "2", "--timeout", "60", "--no-report"),
        *("--results", str(tmp_path / "results"), "--wait", "40", "--waive", "it is a test"),
    ]
    with (
        a_testbed(log),
        subprocess.Popen(command, stdout=PIPE, stderr=STDOUT, text=True) as process,
    ):
        assert process.stdout is not None
        lines = []
        aborted = 0.0
        for line in process.stdout:
            lines.append(line)
            if abort_after is not None and "run starts" in line:
                time.sleep(abort_after)
                aborted = time.time()
                process.send_signal(signal.SIGTERM)
        code = process.wait(60)
    said = "".join(lines)
    assert code == (0 if abort_after is None else 4), said
    folder = Path(said.splitlines()[-1].removeprefix("run folder: "))
    run = Ran(folder, said, read_published(log))
    if abort_after is not None:
        stops = next(entry for entry in run.entries if entry.what == "abort")
        print(f"abort took effect after {stops.time - aborted:.3f} s")
        assert stops.time - aborted < LARGEST_DELAY
    return run


@pytest.mark.slow
def test_a_run_with_cameras_has_them_from_before_its_start_to_after_its_end(
    ros_domain: int, tmp_path: Path
) -> None:
    with cameras(HALL):
        run = ran(tmp_path)
    evidence = rebuild(run.entries).evidence
    assert evidence is not None
    recorded = list(read_bag(run.folder, evidence=True).messages())
    counts = Counter(message.topic for message in recorded)
    print(evidence.words, [one.lost_words for one in evidence.topics])
    assert counts == {one.topic: one.messages for one in evidence.topics}
    assert set(counts) == set(HALL.topics)
    run.demand_testbed_whole()
    testbed_times = [m.receive_ns for m in read_bag(run.folder).messages() if m.topic in TOPICS]
    for topic in HALL.topics:
        times = [m.receive_ns for m in recorded if m.topic == topic]
        assert times[0] - testbed_times[0] < 0.5e9
        assert testbed_times[-1] - times[-1] < 0.5e9
    until(lambda: "evidence" in (run.folder / "metadata.yaml").read_text())
    with AnyReader([run.folder]) as reader:
        assert set(HALL.topics) < {connection.topic for connection in reader.connections}


@pytest.mark.slow
def test_evidence_beyond_all_measure_costs_the_score_nothing_and_is_told(
    ros_domain: int, tmp_path: Path
) -> None:
    for part in ("calm", "flooded", "aborted"):
        (tmp_path / part).mkdir()
    calm = ran(tmp_path / "calm", evidence=False)
    with patient(FAR_TOO_MUCH[0]), patient(FAR_TOO_MUCH[1]), patient(FAR_TOO_MUCH[2]):
        flooded = ran(tmp_path / "flooded")
        ran(tmp_path / "aborted", abort_after=2.0)
    flooded.demand_testbed_whole()
    result = json.loads((flooded.folder / "result.json").read_text())
    evidence = rebuild(flooded.entries).evidence
    assert evidence is not None
    print(evidence.words, *evidence.remarks(), sep="\n  ")
    late, usual = flooded.lateness(), calm.lateness()
    print(f"events noted after {[round(1000 * x) for x in late]} ms, without evidence after "
          f"{[round(1000 * x) for x in usual]} ms")  # fmt: skip
    assert result["outcome"] == "completed"
    assert not [remark for remark in result["quality"]["remarks"] if "not in the rec" in remark]
    assert max(late) < max(usual) + SAMPLE
    assert any(sum(one["lost"].values()) for one in result["evidence"]["topics"])
    assert "evidence: /camera/" in flooded.said
