"""`python -m tests.slice.trials NAME ...`: what the slice and today's engine do on this machine.

It needs root, for a disk that hangs, and a ROS domain of its own. Each trial prints one line.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path

from madrob_console.archive.scored import score_recording
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from recorder import Bag
from tests.madrob_console.crowd import crowd
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import NO_REPORTS, EngineProcess
from tests.slice.client import Client
from tests.slice.wire import Role
from tests.stories.disks import mounted

ROOT = Path(__file__).parents[2]
PYTHON = [sys.executable, "-m"]
CAMERAS = json.dumps([{"topic": "/camera/c{}/image/compressed", "count": 4, "rate": 30.0}])
DEAF, WATCHING = 5, 14


@contextmanager
def beside(*arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """A Python module as a process while inside."""
    command = [*PYTHON, *map(str, arguments)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10)
        process.kill()


class Hall:
    """A slice with its testbed, and who asks it."""

    def __init__(self, results: Path, socket: Path, engine: subprocess.Popen[bytes]) -> None:
        self.results = results
        self.socket = socket
        self.engine = engine
        self.client = Client()
        self.number = 0

    async def attach(self) -> None:
        for _ in range(200):
            with suppress(OSError):
                await self.client.attach(self.socket, Role.REFEREE, "a trial")
                await self.client.until(lambda s: all(t.publishers or t.optional for t in s.topics))
                await asyncio.sleep(1.0)  # it says that it is simulated
                return
            await asyncio.sleep(0.1)
        raise TimeoutError("the engine never came")

    async def start(self, limit: float = 600.0) -> None:
        """Set a run up and start it, up to its running phase."""
        self.number += 1
        await self.until_done(
            SetUp(make_setup(run_number=self.number, countdown=1.0, timeout=limit))
        )
        await asyncio.sleep(1.2)
        await self.until_done(ZeroHandle())
        await self.until_done(ConfirmPose())
        await self.client.perform(Waive(CheckName.TOPICS, "faster than a door"))
        if (refused := await self.client.perform(Start())) is not None:
            print(f"a start was refused: {refused}")
            await self.start(limit)
            return
        await self.client.until(lambda s: s.run.phase is Phase.RUNNING)

    async def until_done(self, act: SetUp | ZeroHandle | ConfirmPose | Start) -> None:
        """As a referee who presses again."""
        for _ in range(100):
            refused = await self.client.perform(act)
            if refused is None:
                return
            await asyncio.sleep(0.1)
        raise AssertionError(f"{act.name}: {refused}")

    @property
    def folder(self) -> Path:
        """The newest run."""
        return max(self.results.glob("practice/subject_*"), key=lambda path: path.name)


@asynccontextmanager
async def hall(
    rate: float, times: int = 1, results: Path | None = None, scenario: str = "nominal"
) -> AsyncIterator[Hall]:
    """A testbed over DDS at so many Hz a topic, and the slice.

    Messages counted `times` over.
    """
    folder = Path(tempfile.mkdtemp(prefix="slice-"))
    results = results or folder / "runs"
    socket = folder / "s"
    with (
        beside("tests.slice.testbed", rate, scenario),
        beside("tests.slice", results, socket, "--times", times) as engine,
    ):
        one = Hall(results, socket, engine)
        await one.attach()
        try:
            yield one
        finally:
            one.client.close()
    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def load(bag: Path) -> Iterator[None]:
    """Cameras and a scorer at work."""
    with beside("tests.madrob_console.ros_peer", CAMERAS), beside("tests.slice.busy", bag):
        yield


@asynccontextmanager
async def screens(socket: Path) -> AsyncIterator[None]:
    """Screens that watch, and some that never read."""
    watching = [Client() for _ in range(WATCHING)]
    for one in watching:
        await one.attach(socket, Role.WATCH, "one of many")
    with beside("tests.slice.deaf", socket, DEAF):
        await asyncio.sleep(1.0)
        yield
    for one in watching:
        one.close()


def told(name: str, times: list[float]) -> None:
    """Print what aborts took."""
    middle = statistics.median(times) * 1e3
    print(f"{name}: {len(times)} aborts, median {middle:.1f} ms, longest {max(times) * 1e3:.1f} ms")


async def whole_run() -> None:
    """Go through a run over DDS.

    Live result, `madrob score` and events to the digit.
    """
    async with hall(50.0) as one:
        await one.start()
        state = await one.client.until(lambda s: s.result is not None)
        live = state.result
        shutil.copytree(one.folder, copied := Path(tempfile.mkdtemp()) / one.folder.name)
        (copied / ".journal.lock").unlink(missing_ok=True)
    fresh = score_recording(copied)[0].result.indicators
    again = {name.value: indicator.value for name, indicator in fresh.items()}
    print(f"whole run: live = madrob score: {live == again}; {live}")


async def aborts(count: int, times: int = 1, rate: float = 500.0) -> None:
    """Abort runs, with everything else at work and a disk that hangs in every second one."""
    bag = example()
    with mounted(Path(tempfile.mkdtemp()) / "disk") as disk, load(bag):
        async with hall(rate, times, disk.folder) as one, screens(one.socket):
            took = []
            for number in range(count):
                await one.start()
                with ExitStack() as hanging:
                    if number % 2:
                        hanging.enter_context(disk.hanging())
                    await asyncio.sleep(0.2)
                    begun = time.monotonic()
                    refused = await one.client.perform(Abort("a trial"))
                    took.append(time.monotonic() - begun)
                    print(f"{took[-1] * 1e3:.1f}", end=" ", flush=True)
                assert refused is None, refused
                state = await one.client.until(lambda s: s.result is not None)
                rmtree_in(one.results)
            bags = f"; {'; '.join(state.problems)}" if state.problems else ""
    told(f"slice, {rate * 6 * times:.0f}/s{bags}", took)


def rmtree_in(results: Path) -> None:
    for run in results.glob("practice/subject_*"):
        shutil.rmtree(run, ignore_errors=True)


def aborts_today(count: int, rate: float = 500.0) -> None:
    """Do the same with today's engine."""
    bag = example()
    took = []
    with (
        mounted(Path(tempfile.mkdtemp()) / "disk") as disk,
        load(bag),
        beside("tests.slice.testbed", rate),
        EngineProcess(disk.folder, None, settings=NO_REPORTS) as engine,
        crowd(engine.stem, WATCHING, 0, DEAF),
    ):
        for number in range(count):
            setup = make_setup(run_number=number + 1, countdown=1.0, timeout=600.0)
            try:
                engine.start(setup, waived={CheckName.TOPICS})
            except AssertionError as refused:
                print(f"a start was refused: {refused}")
                continue
            with ExitStack() as hanging:
                if number % 2:
                    hanging.enter_context(disk.hanging())
                time.sleep(0.2)
                begun = time.monotonic()
                engine.act(Abort("a trial"))
                took.append(time.monotonic() - begun)
                print(f"{took[-1] * 1e3:.1f}", end=" ", flush=True)
            engine.wait_for(lambda s: s.result is not None)
            rmtree_in(disk.folder)
    told(f"today, {rate * 6:.0f}/s", took)


async def flood() -> None:
    """Take 30,000/s for 10 s: what is recorded, what is judged live, the abort."""
    async with hall(500.0, 10) as one:
        await one.start()
        await asyncio.sleep(10.0)
        begun = time.monotonic()
        await one.client.perform(Abort("a trial"))
        took = time.monotonic() - begun
        state = await one.client.until(lambda s: s.result is not None)
        seconds = (state.run.stop or 0.0) - (state.run.start or 0.0)
        counts = sum(1 for _ in Bag(one.folder).messages())
    print(
        f"flood: {counts} recorded in {seconds:.1f} s, abort {took * 1e3:.0f} ms, {state.problems}"
    )


async def kill(count: int) -> None:
    """Kill the engine in a run: what the bag lacks."""
    lost = []
    for _ in range(count):
        async with hall(50.0) as one:
            await one.start()
            await asyncio.sleep(3.0)
            folder = one.folder
            one.engine.send_signal(signal.SIGKILL)
            killed = time.time()
            one.engine.wait()
            last = max(message.receive_ns for message in Bag(folder).messages())
            lost.append(killed - last / 1e9)
    print(f"kill -9: {count} times, {min(lost):.2f} to {max(lost):.2f} s lost")


async def hanging_start() -> None:
    """Start on a disk that hangs."""
    with mounted(Path(tempfile.mkdtemp()) / "disk") as disk:
        async with hall(50.0, 1, disk.folder) as one:
            await one.start()
            await one.client.perform(Abort("a trial"))
            await one.client.until(lambda s: s.result is not None)
            one.number += 1
            await one.until_done(SetUp(make_setup(run_number=one.number, countdown=1.0)))
            await asyncio.sleep(1.2)
            await one.until_done(ZeroHandle())
            await one.until_done(ConfirmPose())
            with disk.hanging():
                begun = time.monotonic()
                refused = await one.client.perform(Start())
                took = time.monotonic() - begun
                await asyncio.sleep(3.0)
            await asyncio.sleep(3.0)
            assert one.client.state is not None
            phase = one.client.state.run.phase
    print(f"start on a disk that hangs: {took:.2f} s, {refused!r}; then {phase}")


async def results(*lengths: float) -> None:
    """Time out after so many s: how long after the post-roll the result is there."""
    for length in lengths:
        async with hall(50.0, scenario="no-touch") as one:
            await one.start(length)
            state = await one.client.until(lambda s: s.run.stop is not None)
            state = await one.client.until(lambda s: s.result is not None)
            stop = state.run.stop or 0.0
            took = state.time - stop - 1.0
            print(f"slice, result of {length:.0f} s: {took:.2f} s after the post-roll")


def results_today(*lengths: float) -> None:
    """Do the same with today's engine."""
    for length in lengths:
        with (
            beside("tests.slice.testbed", 50.0, "no-touch"),
            EngineProcess(Path(tempfile.mkdtemp()), None, settings=NO_REPORTS) as engine,
        ):
            engine.start(make_setup(countdown=1.0, timeout=length))
            state = engine.wait_for(lambda s: s.result is not None, length + 60.0)
            stop = state.run.stop or 0.0
            took = state.time - stop - 1.0
            print(f"today, result of {length:.0f} s: {took:.2f} s after the post-roll")


def example() -> Path:
    """A recorded run, for a scorer that is at work."""
    folder = Path(tempfile.mkdtemp())
    subprocess.run(
        [
            *PYTHON,
            "madrob_console.cli.main",
            "run",
            "--testbed=simulated",
            "--speed=0",
            f"--results={folder}",
            "--subject=1",
            "--team-name=A",
            "--practice",
        ],
        cwd=ROOT,
        check=False,
        stdout=subprocess.DEVNULL,
    )
    return next(folder.glob("practice/subject_*"))


def main(names: list[str]) -> None:
    for name in names:
        kind, *numbers = name.split(":")
        values = [float(number) for number in numbers]
        match kind:
            case "whole":
                asyncio.run(whole_run())
            case "aborts":
                asyncio.run(aborts(int(values[0])))
            case "today":
                aborts_today(int(values[0]))
            case "flood":
                asyncio.run(flood())
            case "kill":
                asyncio.run(kill(int(values[0])))
            case "start":
                asyncio.run(hanging_start())
            case "results":
                asyncio.run(results(*values))
            case "results_today":
                results_today(*values)


if __name__ == "__main__":
    os.environ.setdefault("ROS_DOMAIN_ID", "77")
    main(sys.argv[1:])
