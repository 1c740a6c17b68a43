"""A testbed in a simulation with a time of its own, over DDS: `/clock`, stamps that follow it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from madrob_console.clock import NS, SystemClock
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.message import RawMessage
from tests.madrob_console.ros_peer import KEPT, TYPES, Peer

BEGIN = 100.0
PACE = 2.0
"""So many times as fast as the machine's clock."""
_BUSY = "the disk did not take it within"
STRING, CLOCK = "std_msgs/msg/String", "rosgraph_msgs/msg/Clock"


class WorldClock(SystemClock):
    """The time in the simulated world."""

    def now_ns(self) -> int:
        return super().now_ns() - self._wall + round(BEGIN * NS)


class World:
    """What Gazebo would publish; it does not say that it is simulated."""

    def __init__(self, peer: Peer) -> None:
        self._peer, self._clock = peer, WorldClock(PACE)
        self._testbed = SimulatedSource(None, self._clock, TYPES)
        self._testbed.open()
        self._publishers = {
            s.topic: peer.publisher(s.topic, s.type) for s in self._testbed.status()
        }
        self._clock_publisher = peer.publisher("/clock", CLOCK)
        self._states = peer.listen_raw(REFEREE_STATE_TOPIC, STRING, KEPT)

    def go_on(self) -> None:
        """Publish what is due, and heed the referee."""
        self._peer.spin(0.005)
        now = self._clock.now_ns()
        stamp = TYPES.make("builtin_interfaces/msg/Time", sec=now // NS, nanosec=now % NS)
        self._clock_publisher.publish(TYPES.encode(CLOCK, TYPES.make(CLOCK, clock=stamp)))
        for message in self._testbed.take(0):
            self._publishers[message.topic].publish(message.data)
        while self._states:
            data = self._states.pop(0)
            self._testbed.publish(RawMessage(REFEREE_STATE_TOPIC, STRING, data, 0, 0))

    def run(self, *options: str) -> tuple[int, str, str]:
        """`madrob run` in this world: its exit code, what it said, what it complained of."""
        program = [sys.executable, "-m", "madrob_console.cli.main", "run", "--testbed", "ros"]
        with subprocess.Popen(
            [*program, *options],
            env=os.environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            while process.poll() is None:
                self.go_on()
            said, complained = process.communicate()
        return process.returncode, said, complained


@pytest.mark.timeout(300)
def test_a_run_on_the_time_of_a_simulation_is_practice_completed_and_scored(
    peer: Peer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "madrob.toml"  # a busy machine publishes late
    settings.write_text("[testbed]\nuse_sim_time = true\n[checks]\nlargest_skew = 2.0\n")
    world, complained = World(peer), _BUSY
    while _BUSY in complained:  # nothing was done: a referee starts again
        code, said, complained = world.run(
            "--countdown=2", "--timeout=60", "--wait=100", f"--settings={settings}",
            f"--results={tmp_path}",
        )  # fmt: skip
    assert code == 0, said + complained
    folder = Path(said.splitlines()[-1].removeprefix("run folder: "))
    assert folder.parent == tmp_path / "practice"
    result = json.loads((folder / "result.json").read_text())
    assert (result["outcome"], result["source"]) == ("completed", "simulated")
    assert BEGIN < result["start"] < BEGIN + 200
    assert result["indicators"]["capability_level"]["value"] == 6
    assert all(i["value"] is not None for i in result["indicators"].values())
    assert main(["score", "--check", str(folder)]) == 0
    capsys.readouterr()
    assert main(["run", "--testbed", "replay", str(folder), "--speed=0"]) == 0
    replayed = capsys.readouterr().out
    assert "replay: equals the stored result to the last digit" in replayed, replayed
