"""Topics beside the run over real DDS: publishers, recording process and this one."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from madrob_console.common.clock import NS
from madrob_console.engine.runtime.evidence_process import EvidenceProcess
from madrob_console.engine.runtime.supervisor import Supervisor
from recorder import Bag, RawMessage
from tests.madrob_console.ros_peer import Kind, Stream, cameras
from tests.watching import until

pytestmark = pytest.mark.machine

CAMERAS = Stream(Kind.JPEG, count=2, rate=20, size=50_000, reliable=True)
LEFT, RIGHT = CAMERAS.topics
START_NS = 1_700_000_000 * NS
"""Steady time when a recording begins."""


@contextmanager
def recording(run: Path, domain: int, *topics: str, free: int = 0) -> Iterator[EvidenceProcess]:
    """Record beside a run until the block ends."""
    process = EvidenceProcess(domain, topics or CAMERAS.topics, free)
    run.mkdir(exist_ok=True)
    with closing(Supervisor(process)):
        process.begin_recording(run, START_NS)
        yield process
        process.end_recording()
        process.wait_until_ended(20.0)


def count(process: EvidenceProcess, topic: str = LEFT) -> int:
    topics = process.evidence.topics
    return topics[topic].recorded if topic in topics else 0


def recorded(run: Path) -> list[RawMessage]:
    return list(Bag(run, evidence=True).messages())


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return tmp_path / "run"


def test_cameras_are_recorded_whole_in_the_engines_time(ros_domain: int, run: Path) -> None:
    with cameras(CAMERAS), recording(run, ros_domain) as process:
        until(lambda: count(process) >= 40 and count(process, RIGHT) >= 40)

    messages = recorded(run)
    counts = Counter(message.topic for message in messages)
    assert counts == {name: topic.recorded for name, topic in process.evidence.topics.items()}
    assert [*process.evidence.remarks(None)] == []
    assert all(b"\xff\xd8\xff" in message.data for message in messages)
    times = [message.receive_ns for message in messages if message.topic == LEFT]
    assert times[0] > START_NS
    assert times[-1] < START_NS + 300 * NS
    with AnyReader([run / "run_evidence"]) as reader:
        assert reader.message_count == len(messages)


@pytest.mark.parametrize("spoil", [signal.SIGKILL, signal.SIGSTOP])
def test_process_that_dies_or_hangs_goes_on_in_a_second_bag(
    ros_domain: int, run: Path, spoil: signal.Signals
) -> None:
    with cameras(CAMERAS), recording(run, ros_domain) as process:
        until(lambda: count(process) >= 20)
        before = count(process)
        assert process.pid is not None

        os.kill(process.pid, spoil)

        until(lambda: process.evidence.problem)
        problem = process.evidence.problem
        until(lambda: count(process) >= before + 20)
    assert problem.startswith("the recorder of the evidence is started again: it was ")
    assert process.evidence.problem == ""
    assert sorted(path.name for path in run.iterdir()) == ["run_evidence", "run_evidence_2"]
    counts = Counter(message.topic for message in recorded(run))
    assert counts[LEFT] >= count(process) >= before + 20


def test_silent_topic_is_named_with_its_time(ros_domain: int, run: Path) -> None:
    with recording(run, ros_domain, "/camera/gone") as process:
        until(lambda: [*process.evidence.remarks(START_NS / NS)])
    assert [*process.evidence.remarks(START_NS / NS)] == ["/camera/gone: silent since +0.0 s"]
    assert recorded(run) == []


def test_room_of_the_run_is_left_to_it(ros_domain: int, run: Path) -> None:
    with cameras(CAMERAS), recording(run, ros_domain, free=10**18) as process:
        until(lambda: process.evidence.problem)
        time.sleep(1.0)  # what would be recorded comes
    assert process.evidence.problem.startswith("the disk has less than ")
    assert recorded(run) == []


def test_process_that_cannot_be_started_is_named(run: Path) -> None:
    process = EvidenceProcess(0, CAMERAS.topics, 0, ("/nonexistent/program",))
    with closing(Supervisor(process)):
        process.begin_recording(run, START_NS)
        until(lambda: "no process can be started" in process.evidence.problem)
        process.end_recording()
        process.wait_until_ended(20.0)
    assert process.evidence.topics == {}


def test_next_run_has_a_recording_of_its_own(ros_domain: int, run: Path) -> None:
    process = EvidenceProcess(ros_domain, CAMERAS.topics, 0)
    runs = [run, run.with_name("next")]
    with cameras(CAMERAS), closing(Supervisor(process)):
        for folder in runs:
            folder.mkdir()
            process.begin_recording(folder, START_NS)
            until(lambda: count(process) >= 10)
            process.end_recording()
            process.wait_until_ended(20.0)
            assert len(recorded(folder)) == sum(
                topic.recorded for topic in process.evidence.topics.values()
            )


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it goes on
def test_bag_is_finished_when_the_engine_ends(ros_domain: int, run: Path) -> None:
    process = EvidenceProcess(ros_domain, CAMERAS.topics, 0)
    run.mkdir()
    with cameras(CAMERAS), closing(Supervisor(process)):
        process.begin_recording(run, START_NS)
        until(lambda: count(process) >= 10)
    until(lambda: Bag(run, evidence=True).complete)
    assert len(recorded(run)) >= 20
