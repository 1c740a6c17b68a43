"""A whole benchmark: testbed and console in two processes, DDS between them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter, defaultdict
from hashlib import sha256
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from madrob_console.cli.main import main
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.testbeds.announcement import INFO_TOPIC
from recorder.reader import read_bag
from scoring.protocol import Signal

pytestmark = pytest.mark.slow

TOPICS = [m.topic for m in DEFAULT_MAPPINGS if m.signal is not Signal.LATCH]

LOGGING_TESTBED = """
import sys
from hashlib import sha256
from madrob_console.cli.main import main
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource

take, log = SimulatedSource.take, open(sys.argv[1], "w", buffering=1)

def logged(self, timeout):
    messages = take(self, timeout)
    for message in messages:
        log.write(f"{message.topic} {sha256(message.data).hexdigest()}\\n")
    return messages

SimulatedSource.take = logged
sys.exit(main(["testbed", "--scenario", "nominal"]))
"""


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
