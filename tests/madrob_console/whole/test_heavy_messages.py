"""A second publisher of megabytes on a testbed's topic: neither clock nor abort wait for it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.engine.shown.requests import Perform
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import Phase
from madrob_console.testbeds.ros.loading import RosObject
from recorder.reader import read_bag
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.spoilt import DOOR
from tests.madrob_console.engine_process import ROOT, EngineProcess
from tests.madrob_console.ros_peer import KEPT, Peer
from tests.watching import until

pytestmark = pytest.mark.slow

NAMES = 500_000
RATE = 5.0
RUNS = 3
HEAVY = 4_000_000
WATCHED = 6.0
"""s of a run in which nothing happens but heavy messages."""
BUSY = 1.0
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
def program(output: Path, *arguments: str) -> Iterator[None]:
    """A Python program beside the engine, until the end."""
    with output.open("wb") as out:
        process = subprocess.Popen([sys.executable, *arguments], cwd=ROOT, stdout=out)
    try:
        yield
    finally:
        process.kill()
        process.wait()


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

    until(watched, duration + BUSY)
    return worst


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
            engine.wait_for(lambda s: any("bytes, not read above" in line for line in s.faults))
            for number in range(1, RUNS + 1):
                begin_run(engine, number)
                used, at = processor_time(engine.process.pid), time.monotonic()
                clocks.append(clock_behind(engine, WATCHED))
                loads.append((processor_time(engine.process.pid) - used) / (time.monotonic() - at))
                before, pressed = len(states), time.monotonic()
                assert engine.client.ask(Perform.of(Abort("enough"))) is None
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
    assert max(clocks) < BUSY
    assert max(aborts) < BUSY
    assert max(announced) < BUSY
