"""What the screens send and take, in a pty, beside Textual as it comes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.benchmarks.commands import MADROB, ROOT
from tests.benchmarks.report import Figure
from tests.terminal import Terminal

STARTING = 60.0  # s
SETTLING, SAMPLE = 1.0, 10.0  # s; CPU time counts in steps of 0.01 s
MOST = 3
"""Repeats of what takes half a minute."""

BARE = (sys.executable, "-m", "tests.benchmarks.bare_app")
WIDGETS = (*BARE, "--widgets")
OURS = (sys.executable, "-m", "tests.madrob_console.ui.inline_engine", "--running")
TEXTUAL_S = """
import runpy, sys
sys.modules["madrob_console.ui.cells.compositor"] = None
runpy.run_module("tests.madrob_console.ui.inline_engine", run_name="__main__")
"""
"""Our screens by Textual's compositor."""
OTHER_COMPOSITOR = (sys.executable, "-c", TEXTUAL_S, "--running")
Size = tuple[int, int]
SMALL, USUAL, LARGE = (80, 24), (120, 36), (160, 50)
LIVE, CLOCK = b"referee (sensor)", b"clock"
"""What only the live pane says, and what the bare app says."""


class Wire(Terminal):
    """A terminal that takes what comes and does not draw it."""

    def __init__(
        self, argv: Sequence[str], env: dict[str, str] | None = None, size: Size = SMALL
    ) -> None:
        self.began = time.monotonic()
        super().__init__(argv, *size, env, ROOT)

    def arrival(self, text: bytes) -> float:
        """How long after the launch `text` is written, s."""
        while text not in self.output:
            assert time.monotonic() < self.began + STARTING, bytes(self.output[-500:])
            self.read_for(0.01)
        return time.monotonic() - self.began

    def read_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._read(left)


def _costs(
    programs: Sequence[Sequence[str]], repeats: int, size: Size = SMALL
) -> list[tuple[list[float], ...]]:
    """Of each program kB/s on the line, and the share of a core, %; they take turns."""
    costs: list[tuple[list[float], ...]] = [([], []) for _ in programs]
    for _ in range(min(repeats, MOST)):
        for argv, (kilobytes, shares) in zip(programs, costs, strict=True):
            with Wire(argv, size=size) as wire:
                wire.arrival(LIVE if argv in (OURS, OTHER_COMPOSITOR) else CLOCK)
                wire.read_for(SETTLING)
                written, used, began = len(wire.output), _cpu_time(wire.pid), time.monotonic()
                wire.read_for(SAMPLE)
                elapsed = time.monotonic() - began
                kilobytes.append((len(wire.output) - written) / 1000 / elapsed)
                shares.append(100 * (_cpu_time(wire.pid) - used) / elapsed)
    return costs


def _cpu_time(pid: int) -> float:
    """Of all threads of a process, user and system, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def lines(repeats: int) -> list[Figure]:
    """A live run, beside an app of as many widgets of Textual that show moving numbers."""
    (ours, _), (widgets, _) = _costs((OURS, WIDGETS), repeats)
    return [Figure("a live run over SSH", "kB/s", ours, "widgets", widgets, 0.15)]


def compositor(repeats: int) -> list[Figure]:
    """A live run by our compositor and by Textual's, in a small terminal and in a large one."""
    figures = []
    for size in (SMALL, LARGE):
        (ours, cpu), (others, other_cpu) = _costs((OURS, OTHER_COMPOSITOR), repeats, size)
        figures += [
            Figure(f"changed cells, {size}", "kB/s", ours, "Textual's compositor", others, 0.8),
            Figure(f"changed cells, {size}", "% core", cpu, "Textual's compositor", other_cpu, 1.0),
        ]
    return figures


def live(repeats: int) -> list[Figure]:
    """A live run with the course of door and handle, beside the least that Textual can do."""
    figures = []
    for size in (SMALL, USUAL, LARGE):
        (_, ours), (_, bare) = _costs((OURS, BARE), repeats, size)
        figures.append(Figure(f"a live run, {size}", "% core", ours, "bare app", bare, 2.0))
    return figures


def first_paint(repeats: int) -> list[Figure]:
    """From the command to the screen with its footer, beside the least that Textual can do."""
    ours, bare = [], []
    for _ in range(1 + repeats):
        with _console() as wire:
            ours.append(wire.arrival(b"F10"))
        with Wire(BARE) as wire:
            bare.append(wire.arrival(CLOCK))
    # the first time files come into memory and are compiled
    return [Figure("launch to the first paint", "s", ours[1:], "bare app", bare[1:], 1.7)]


@contextmanager
def _console() -> Iterator[Wire]:
    """The console on a simulated testbed; its engine ends with it."""
    with tempfile.TemporaryDirectory(prefix="madrob-", ignore_cleanup_errors=True) as folder:
        env = {"XDG_STATE_HOME": folder}
        own = ("--results", str(Path(folder, "results")))
        try:
            with Wire((*MADROB, "console", "--testbed", "simulated", *own), env) as wire:
                yield wire
        finally:
            stop = (*MADROB, "engine", "stop", "--force", *own)
            subprocess.run(stop, env=os.environ | env, cwd=ROOT, capture_output=True, check=False)
