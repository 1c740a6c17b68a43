"""Runs over DDS with cameras beside them, in processes of their own: the score comes first."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, STDOUT

import pytest
from rosbags.highlevel import AnyReader

from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change, rebuild
from recorder.reader import read_bag
from tests.madrob_console.camera_peer import Kind, Stream, cameras
from tests.madrob_console.whole.test_benchmark_over_ros import (
    LOGGING_TESTBED,
    TOPICS,
    read_published,
    read_recorded,
)
from tests.watching import until

pytestmark = pytest.mark.slow

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
