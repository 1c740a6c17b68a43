"""What recording cameras and many topics costs, beside a bare writer, the disk alone and rclpy."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import count, cycle, islice
from pathlib import Path
from typing import Self

from mcap.writer import Writer

from madrob_console.engine.evidence_client import EvidencePlace
from madrob_console.engine.evidence_process import EvidenceProcess
from madrob_console.engine.evidence_status import ListenFor
from madrob_console.engine.evidence_worker import TELL_PERIOD
from madrob_console.engine.supervisor import Supervisor
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.evidence_choice import EvidenceChoice
from recorder.bag import RawMessage, Topic
from recorder.mcap_writer import CHUNK_BYTES
from recorder.reader import read_bag
from recorder.writer import BagWriter
from tests.benchmarks import receiver
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.wire import cpu_time
from tests.madrob_console.camera_peer import Kind, Stream, cameras, messages
from tests.watching import until

PACKAGES = ("mcap", "ros-jazzy-rclpy", "zstandard")

JPEGS = Stream(count=4)
RAW = Stream(Kind.RAW, "/camera/raw", size=2_000_000)
MANY = Stream(Kind.POSE, "/robot/part_{}", count=100, rate=100)
STREAMS = {
    "4 x 30 Hz x 200 kB JPEG": JPEGS,
    "1 x 30 Hz x 2 MB raw": RAW,
    "100 x 100 Hz small": MANY,
}
DURATION = 10.0
"""What comes in so many seconds is written as fast as it can be."""

SENDING = 5.0
"""Over DDS they are sent for so long, s."""
PATIENCE = 60.0  # s
MOST = 2
"""Repeats over DDS: each takes half a minute."""
_domains = count()

CHEAP = Goal(times=1.5)
NO_DEARER = Goal(times=1)
FAST = Goal(times=0.8, at_least=True)
FLAT = Goal(times=1.05)
_TYPES = MessageTypes()


@dataclass(frozen=True, slots=True)
class _Run:
    """What writing took: CPU a message in us, MB/s, and memory in MB now and then."""

    cost: float
    speed: float
    memory: Sequence[float] = ()


def written(repeats: int) -> list[Figure]:
    """The recorder, a loop of `mcap.Writer` and the disk alone, each as fast as it can."""
    figures: list[Figure] = []
    for name, stream in STREAMS.items():
        topics, sent = _content(stream)
        runs: dict[Callable[..., _Run], list[_Run]] = {_ours: [], _bare: [], _disk: []}
        for _ in range(repeats):
            for write, done in runs.items():
                with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
                    done.append(write(Path(folder), topics, sent))
        figures += _figures(name, runs[_ours], runs[_bare], runs[_disk])
    return figures


def _figures(
    name: str, ours: Sequence[_Run], bare: Sequence[_Run], disk: Sequence[_Run]
) -> list[Figure]:
    halves = [(run.memory[: len(run.memory) // 2], run.memory) for run in ours]
    first, all_of_it = [max(early) for early, _ in halves], [max(late) for _, late in halves]
    speeds = [run.speed for run in ours]
    writer, alone = "mcap.Writer", "the disk alone"
    return [
        Figure(
            f"{name}: CPU a message",
            "us",
            [run.cost for run in ours],
            CHEAP,
            Baseline(writer, [run.cost for run in bare]),
        ),
        Figure(
            f"{name}: written", "MB/s", speeds, FAST, Baseline(writer, [run.speed for run in bare])
        ),
        Figure(
            f"{name}: of the disk",
            "MB/s",
            speeds,
            None,
            Baseline(alone, [run.speed for run in disk]),
        ),
        Figure(
            f"{name}: memory at most", "MB", all_of_it, FLAT, Baseline("in the first half", first)
        ),
    ]


def _content(stream: Stream) -> tuple[list[Topic], list[RawMessage]]:
    """The topics of a stream, and what comes of it."""
    kind = stream.kind.type
    topics = [Topic(name, kind, _TYPES.definition(kind)) for name in stream.topics]
    data = {name: cycle(messages(stream, name)) for name in stream.topics}
    step = 1e9 / stream.rate / stream.count
    number_of_all = round(DURATION * stream.rate * stream.count)
    return topics, [
        RawMessage(name, kind, next(data[name]), round(number * step), round(number * step))
        for number, name in enumerate(islice(cycle(stream.topics), number_of_all))
    ]


def _ours(folder: Path, topics: Sequence[Topic], sent: Sequence[RawMessage]) -> _Run:
    """Through the recorder's queue and thread, on the disk five times a second."""
    memory: list[float] = []
    with _Watch(sent) as watch, BagWriter(folder / "bag", topics, {}, block_when_full=True) as bag:
        batch = max(1, len(sent) // 100)
        for start in range(0, len(sent), batch):
            bag.put_all(sent[start : start + batch])
            memory.append(_memory())
    return watch.run(memory)


def _bare(folder: Path, topics: Sequence[Topic], sent: Sequence[RawMessage]) -> _Run:
    """What one writes first, with the same chunks; on the disk at the end."""
    with _Watch(sent) as watch, (folder / "bare.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start(profile="ros2")
        schema = writer.register_schema(topics[0].type, "ros2msg", topics[0].definition.encode())
        channels = {t.name: writer.register_channel(t.name, "cdr", schema) for t in topics}
        for number, message in enumerate(sent):
            writer.add_message(
                channels[message.topic],
                message.receive_ns,
                message.data,
                message.publish_ns,
                number,
            )
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        os.fdatasync(file.fileno())
    return watch.run()


def _disk(folder: Path, _topics: Sequence[Topic], sent: Sequence[RawMessage]) -> _Run:
    """The bytes alone, in blocks as large as the chunks are."""
    rest = sum(len(message.data) for message in sent)
    block = os.urandom(CHUNK_BYTES)
    with _Watch(sent) as watch, (folder / "bytes").open("wb", buffering=0) as file:
        while rest > 0:
            rest -= file.write(block[:rest])
        os.fdatasync(file.fileno())
    return watch.run()


class _Watch:
    """CPU time and time between beginning and end."""

    def __init__(self, sent: Sequence[RawMessage]) -> None:
        self._messages = len(sent)
        self._bytes = sum(len(message.data) for message in sent)

    def __enter__(self) -> Self:
        os.sync()  # what others wrote before is not ours to wait for
        self._began = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = time.perf_counter(), time.process_time()

    def run(self, memory: Sequence[float] = ()) -> _Run:
        """What was measured."""
        elapsed, used = (end - begin for begin, end in zip(self._began, self._ended, strict=True))
        return _Run(1e6 * used / self._messages, self._bytes / 1e6 / elapsed, memory)


def _memory() -> float:
    """Of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def over_dds(repeats: int) -> list[Figure]:
    """The process that records evidence, fed from another one, beside callbacks of rclpy."""
    figures: list[Figure] = []
    for name, stream in STREAMS.items():
        runs: dict[Callable[[Stream], _Recorded], list[_Recorded]] = {_evidence: [], _rclpy: []}
        for _ in range(min(repeats, MOST)):
            for record, done in runs.items():
                done.append(record(replace(stream, reliable=True)))
        (ours, theirs), beside = runs.values(), "rclpy executor"
        figures += [
            Figure(
                f"{name} over DDS: CPU a message",
                "us",
                [one.cost for one in ours],
                NO_DEARER,
                Baseline(beside, [one.cost for one in theirs]),
            ),
            Figure(
                f"{name} over DDS: lost",
                "%",
                [one.lost for one in ours],
                None,
                Baseline(beside, [one.lost for one in theirs]),
            ),
        ]
    return figures


@dataclass(frozen=True, slots=True)
class _Recorded:
    """What recording over DDS took: CPU a message in us, and messages lost in %."""

    cost: float
    lost: float


def _sent(sender: subprocess.Popen[str]) -> int:
    return sum(json.loads(sender.communicate(timeout=PATIENCE)[0])["sent"].values())


def _rclpy(stream: Stream) -> _Recorded:
    """Callbacks that hand serialised messages to `mcap.Writer`."""
    env = os.environ | {"ROS_DOMAIN_ID": str(_domain())}
    wanted = round(stream.count * stream.rate * SENDING)
    with (
        tempfile.TemporaryDirectory(prefix="madrob-") as folder,
        cameras(stream, seconds=SENDING, wait=PATIENCE, env=env) as sender,
    ):
        got, cost = receiver.record("rclpy", folder, wanted, stream.kind.type, stream.topics, env)
        return _Recorded(cost, 100 * max(0.0, 1 - got / min(_sent(sender), wanted)))


def _evidence(stream: Stream) -> _Recorded:
    """As the engine has evidence recorded, beside the recording of a run."""
    domain = _domain()
    listen = ListenFor(domain, EvidenceChoice(topics=("/camera/**", "/robot/**")), (), ())
    with (
        tempfile.TemporaryDirectory(prefix="madrob-") as folder,
        BagWriter(Path(folder, "bag"), [], {}) as bag,
        closing(EvidenceProcess(listen)) as process,
        closing(Supervisor(process)),
        cameras(
            stream, seconds=SENDING, wait=PATIENCE, env={"ROS_DOMAIN_ID": str(domain)}
        ) as sender,
    ):
        now, monotonic = time.time_ns(), time.monotonic_ns()
        process.begin_recording(EvidencePlace(str(bag.folder), now, monotonic, 10**10, 0))
        first = until(lambda: _messages(process), PATIENCE)
        assert process.pid is not None
        before = cpu_time(process.pid)
        sent = _sent(sender)
        settled = until(lambda: _settled(process), PATIENCE)
        used = cpu_time(process.pid) - before
        process.end_recording()
        until(lambda: not (process.status.recording or process.status.finishing), PATIENCE)
        got = sum(1 for _ in read_bag(bag.folder, evidence=True).messages())
        return _Recorded(1e6 * used / (settled - first), 100 * (1 - got / sent))


def _messages(process: EvidenceProcess) -> int:
    return sum(topic.messages for topic in process.status.recorded)


def _settled(process: EvidenceProcess) -> int:
    """Messages recorded, once no more come; else 0."""
    before = _messages(process)
    time.sleep(2 * TELL_PERIOD)
    return before if before == _messages(process) else 0


def _domain() -> int:
    return 200 + next(_domains) % 30


BENCHMARKS = (written, over_dds)
