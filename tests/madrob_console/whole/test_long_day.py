"""A day of runs in one engine: memory, threads and file handles stay as they are."""

from __future__ import annotations

import gc
import os
import random
import shutil
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from madrob_console.archive.scored import OpenedRun, Scored
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.course import Course
from madrob_console.engine.live.recording import Recording
from madrob_console.engine.live.scorer import EarlierRun, RenderedResult
from madrob_console.engine.process.remote import RemoteEngine
from madrob_console.engine.shown.requests import Role
from madrob_console.referee.acts import (
    Abort,
    DeclareTimeout,
    MarkIncident,
    Reissue,
    Rule,
)
from madrob_console.referee.journal import Journal
from madrob_console.referee.on_record import IncidentKind
from madrob_console.testbeds.simulated import Scenario
from recorder.writer import BagWriter
from scoring.evaluate import Assessment
from scoring.protocol import Condition, Step
from tests.madrob_console.engine.drive import Drive, make_setup, signed
from tests.madrob_console.engine_process import EngineProcess

PAGE = os.sysconf("SC_PAGE_SIZE")
MEMORY_GROWTH = 4_000_000
OF_A_RUN = (
    *(Engine, Recording, BagWriter, Journal, Course, Assessment),
    *(Scored, OpenedRun, RenderedResult, EarlierRun),
)


@dataclass(frozen=True)
class Usage:
    """What a process holds."""

    memory: int
    threads: int
    handles: int

    @classmethod
    def of(cls, pid: int | str = "self") -> Usage:
        process = Path("/proc") / str(pid)
        return cls(
            memory=int((process / "statm").read_text().split()[1]) * PAGE,
            threads=len(list((process / "task").iterdir())),
            handles=len(list((process / "fd").iterdir())),
        )


def live_objects() -> Counter[str]:
    gc.collect()
    found = (type(o) for o in gc.get_objects() if isinstance(o, OF_A_RUN))
    return Counter(kind.__name__ for kind in found)


class Day:
    """One engine, and a referee who does something else in every run."""

    def __init__(self, results: Path) -> None:
        self.drive = Drive(results, Scenario.RANDOM)
        self.rng = random.Random(13)
        self.runs = 0
        self.began = self.drive.engine.now()
        self._kept: Path | None = None

    @property
    def hours(self) -> float:
        return (self.drive.engine.now() - self.began) / 3600

    def one_run(self) -> None:
        drive, engine = self.drive, self.drive.engine
        number, condition = self.runs // 20 + 1, Condition.from_number(self.runs % 20 + 1)
        setup = make_setup(condition, run_number=number, timeout=self.rng.uniform(20.0, 60.0))
        self.runs += 1
        drive.start(setup)
        self._in_the_middle()
        while engine.scored is None:
            drive.wait(0.1)
            engine.snapshot()  # as often as screens look
        drive.act(Rule(Step.CROSS, confirmed=True, reason="seen"))
        drive.act(signed(engine.snapshot()))
        assert engine.result_problem is None
        assert engine.folder is not None
        folder = engine.folder
        self._afterwards(folder)
        drive.wait(self.rng.uniform(1.0, 5.0))

    def _in_the_middle(self) -> None:
        drive = self.drive
        match self.runs % 8:
            case 3:
                drive.act(MarkIncident(IncidentKind.COLLISION, "door frame"))
            case 5:
                drive.wait(4.0)
                drive.act(Abort("enough"))
            case 7:
                drive.wait(6.0)
                drive.act(DeclareTimeout("gave up"))

    def _afterwards(self, folder: Path) -> None:
        """Look at the run before now and then; keep the disk small."""
        if self.runs % 5 == 0 and self._kept is not None:
            assert self.drive.open(self._kept) is None
            self.drive.act(Reissue("appeal granted"))
        if self._kept is not None:
            shutil.rmtree(self._kept)
        self._kept = folder


@pytest.mark.slow
def test_memory_threads_and_handles_stay_flat_over_a_day_of_runs(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """1200 runs are ten hours."""
    count = max(20, request.config.getoption("--runs"))
    day = Day(tmp_path / "results")
    usage, objects = [], []
    before = live_objects()
    threads = threading.active_count()
    for _ in range(count):
        day.one_run()
        assert threading.active_count() == threads
        usage.append(Usage.of())
        if day.runs in (count // 2, count):
            objects.append(live_objects() - before)
    first, second = usage[count // 4 : count // 2], usage[count // 2 :]
    grown = max(u.memory for u in second) - max(u.memory for u in first)
    print(
        f"\n{count} runs, {day.hours:.1f} simulated hours: {megabytes(usage[count // 4])} after "
        f"{count // 4} runs, {megabytes(usage[-1])} at the end; {held(usage)}; live objects "
        f"{dict(objects[-1])}"
    )
    assert grown < MEMORY_GROWTH
    assert {u.threads for u in second} <= {u.threads for u in first}
    assert {u.handles for u in second} <= {u.handles for u in first}
    assert objects[0] == objects[1]
    assert max(objects[1].values()) <= 2
    day.drive.engine.close()


def megabytes(usage: Usage) -> str:
    return f"{usage.memory / 1e6:.1f} MB"


def held(usage: list[Usage]) -> str:
    threads, handles = {u.threads for u in usage}, {u.handles for u in usage}
    return f"threads {sorted(threads)}, file handles {sorted(handles)}"


@pytest.mark.slow
def test_screens_that_come_and_go_leave_nothing_behind(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    count = 5 * max(20, request.config.getoption("--runs"))
    usage = []
    with EngineProcess(tmp_path / "results", "nominal") as engine:
        time.sleep(5.0)  # it loads what scoring needs
        for number in range(count):
            screen = RemoteEngine(engine.socket, Role.WATCH, f"screen {number}")
            screen.snapshot()
            screen.close()
            usage.append(Usage.of(engine.process.pid))
        time.sleep(1.0)
        usage.append(Usage.of(engine.process.pid))
    first, last = usage[count // 4], usage[-1]
    print(
        f"\n{count} screens came and went: {megabytes(first)} after {count // 4}, "
        f"{megabytes(last)} at the end; {held(usage)}"
    )
    assert last.memory - first.memory < MEMORY_GROWTH
    assert last.handles <= first.handles
    assert last.threads <= first.threads
