"""A machine that is too busy, or whose disk stalls, changes no event and drops no message."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.referee.acts import SetUp, ZeroHandle
from madrob_console.referee.journal import read_journal
from recorder.reader import read_bag
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.small_disk import disk_image

SAMPLE = 0.025
STALL = 5.0
SETTLE = 1.0


@contextmanager
def busy_cores() -> Iterator[None]:
    """Two programs of the same priority as the engine's on every core."""
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(2 * (os.cpu_count() or 1))
    ]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run_through(
    results: Path, trouble: AbstractContextManager[None], lasting: float | None = None
) -> dict[str, Any]:
    """The result of a run in which there is trouble, from its start to its end or for a while."""
    with EngineProcess(results, "nominal") as engine:
        engine.start(make_setup(countdown=1.0))
        with trouble:
            if lasting is None:
                engine.result()
            else:
                time.sleep(lasting)
        document = engine.result()
        shown, folder = engine.snapshot(), engine.folder
    assert (shown.recorder.dropped, shown.faults) == (0, ())
    assert (document["outcome"], document["quality"]["remarks"]) == ("completed", [])
    assert read_bag(folder).complete
    rescored = msgspec.json.encode(next(score(folder)).result)
    assert msgspec.json.decode(rescored)["events"] == document["events"]
    return document


def events(document: dict[str, Any]) -> dict[str, float]:
    return {event["event"]: event["since_start"] for event in document["events"]}


def stop_seen_after(results: Path) -> float:
    """How long after the stop it was decided, the settle time left out, s."""
    (folder,) = results.glob("practice/subject_*")
    lines, _ = read_journal(folder / "journal.jsonl")
    (line,) = (line for line in lines if line.what == "run stops")
    return line.time - float(line.details["time"]) - SETTLE


def test_an_engine_that_was_held_up_takes_no_topic_for_silent(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(2.5)
    drive.clock.sleep(1.5)  # in which the disk did not answer, or others had the processor
    held_up = drive.engine.snapshot()
    assert held_up.faults == ()
    assert held_up.door.angle is not None
    assert drive.engine.perform(ZeroHandle()) is None
    drive.wait(0.1)
    drive.source.close()
    drive.wait(0.8)
    assert "stale, silent for" in drive.engine.snapshot().faults[0]


@pytest.mark.slow
def test_busy_cores_change_no_event_and_drop_nothing(tmp_path: Path) -> None:
    quiet = events(run_through(tmp_path / "quiet", nullcontext()))
    busy = events(run_through(tmp_path / "busy", busy_cores()))
    assert busy.keys() == quiet.keys()
    worst = max(abs(busy[name] - quiet[name]) for name in quiet)
    late = stop_seen_after(tmp_path / "busy")
    print(
        f"\n{2 * (os.cpu_count() or 1)} busy loops on {os.cpu_count()} cores: 0 dropped, events "
        f"differ by {1000 * worst:.1f} ms, the stop was seen after {1000 * late:.0f} ms"
    )
    assert worst <= SAMPLE
    assert late < 1.0


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
def test_a_disk_that_stalls_for_seconds_changes_no_event_and_drops_nothing(tmp_path: Path) -> None:
    quiet = events(run_through(tmp_path / "quiet", nullcontext()))
    with disk_image(tmp_path / "disk") as disk:
        stalled = events(run_through(disk.folder / "results", disk.stalled(), STALL))
    assert stalled.keys() == quiet.keys()
    worst = max(abs(stalled[name] - quiet[name]) for name in quiet)
    print(f"\ndisk stalled for {STALL:g} s: 0 dropped, events differ by {1000 * worst:.1f} ms")
    assert worst <= SAMPLE
