"""What a run keeps beside more evidence than disk and processor can take."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from madrob_console.engine.requests import Perform
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.checks import blocking
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from tests.benchmarks.evidence import JPEGS, MANY, RAW
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.wire import ROOT, cpu_time
from tests.madrob_console.camera_peer import Stream, cameras
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import EngineProcess
from tests.watching import until

PACKAGES = ("mcap", "ros-jazzy-rclpy")

LOADS: Mapping[str, Sequence[Stream]] = {
    "no evidence": (),
    "all three streams": (JPEGS, RAW, MANY),
    "ten times as much": (
        Stream(count=40),
        Stream(RAW.kind, "/camera/raw_{}", count=10, size=RAW.size, reliable=True),
    ),
}
WATCHED = 10.0
"""s of a run in which nothing happens but evidence."""

NONE_LOST = Goal(None)
AT_ONCE = Goal(times=1)
ABORT = 0.2
"""Seconds in which abort takes effect."""
MOST = 2
_TESTBED = ("-m", "madrob_console.cli.main", "testbed", "--scenario", "nominal", "--repeat", "0")
# who makes reports would still write into a folder that is being removed
_SETTINGS = '[results]\nreports = false\n[recording]\ntopics = ["/camera/**", "/robot/**"]\n'
_MENDABLE = {
    CheckName.POSE,
    CheckName.HANDLE,
    CheckName.HANDLE_ZERO,
    CheckName.EVIDENCE,
    CheckName.TOPICS,
}
"""What is mended or waived below."""
_domains = count()


@dataclass(frozen=True, slots=True)
class _Run:
    """What became of a run: messages lost of the testbed, s of an abort, % of the evidence lost,
    and the share of a core that the engine took, %.
    """

    lost: float
    abort: float
    evidence_lost: float
    share: float


def beside_a_run(repeats: int) -> Iterator[Figure]:
    """A run of the simulated testbed over ROS, and cameras beside it."""
    for name, streams in LOADS.items():
        runs = [_run(streams) for _ in range(min(repeats, MOST))]
        allowed = [ABORT] * len(runs)
        yield Figure(f"{name}: testbed's messages lost", "", [r.lost for r in runs], NONE_LOST)
        yield Figure(
            f"{name}: abort", "s", [r.abort for r in runs], AT_ONCE, Baseline("allowed", allowed)
        )
        yield Figure(f"{name}: engine", "% of core", [r.share for r in runs])
        yield Figure(f"{name}: evidence lost and told", "%", [r.evidence_lost for r in runs])


def _run(streams: Sequence[Stream]) -> _Run:
    env = {"ROS_DOMAIN_ID": str(160 + next(_domains) % 40)}
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="madrob-"))
        stack.enter_context(_program(env, *_TESTBED))
        engine = stack.enter_context(
            EngineProcess(Path(folder), None, environment=env, settings=_SETTINGS)
        )
        # a run is set up as practice once the testbed has said that it is simulated
        engine.wait_for(
            lambda s: s.simulated is not None and all(t.rate for t in s.topics if not t.optional)
        )
        if streams:
            stack.enter_context(cameras(*streams, env=env))
            wanted = sum(stream.count for stream in streams)
            engine.wait_for(lambda s: s.evidence is not None and s.evidence.topics >= wanted)
        _begin(engine)
        used, began = cpu_time(engine.process.pid), time.monotonic()
        until(lambda: time.monotonic() > began + WATCHED, 2 * WATCHED)
        share = 100 * (cpu_time(engine.process.pid) - used) / (time.monotonic() - began)
        pressed = time.monotonic()
        refused = engine.client.send_request(Perform.of(Abort("enough")))
        abort = time.monotonic() - pressed
        assert refused is None, refused
        document = engine.result()
        shown = engine.snapshot()
        lost = sum((t.lost or 0) + t.dropped for t in shown.topics) + shown.recorder.dropped
        return _Run(lost, abort, _evidence_lost(document["evidence"]), share)


def _evidence_lost(account: Mapping[str, Sequence[Mapping[str, object]]] | None) -> float:
    """Of what was sent, as far as it was told, %."""
    if account is None or not account["topics"]:
        return 0.0
    kept = lost = 0
    for topic in account["topics"]:
        losses = topic["lost"]
        assert isinstance(losses, dict)
        assert isinstance(topic["messages"], int)
        kept += topic["messages"]
        lost += sum(losses.values())
    return 100 * lost / max(1, kept + lost)


def _begin(engine: EngineProcess) -> None:
    """From the set-up to the running phase, whatever is waived for it."""
    engine.act(SetUp(make_setup(countdown=1.0)))
    engine.wait_for(lambda s: {c.name for c in blocking(s.checks)} <= _MENDABLE)
    fresh = engine.snapshot().time
    engine.wait_for(lambda s: s.time > fresh + 1.1)
    engine.wait_for(lambda _: engine.client.send_request(Perform.of(ZeroHandle())) is None)
    engine.act(ConfirmPose())
    for check in blocking(engine.snapshot().checks):
        engine.act(Waive(check.name, "a measurement"))
    engine.act(Start())
    engine.wait_for(lambda s: s.run.phase is Phase.RUNNING)


@contextmanager
def _program(env: Mapping[str, str], *arguments: str) -> Iterator[None]:
    """A Python program, until the end."""
    process = subprocess.Popen(
        [sys.executable, *arguments], cwd=ROOT, env=os.environ | env, stdout=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.kill()
        process.wait()


BENCHMARKS = (beside_a_run,)
