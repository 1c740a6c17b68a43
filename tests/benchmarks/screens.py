"""What the screens send and take, in a pty, beside Textual as it comes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.benchmarks.commands import MADROB, ROOT
from tests.benchmarks.engine import RATES, TIMEOUT
from tests.benchmarks.processes import cpu_time, hall
from tests.benchmarks.report import Figure
from tests.madrob_console.engine.drive import make_setup
from tests.terminal import Terminal

STARTING = 60.0  # s
SETTLING, SAMPLE, READING = 1.0, 3.0, 0.5  # s
MOST = 3
"""Repeats of what takes seconds."""

BARE = (sys.executable, "-m", "tests.benchmarks.bare_app")
WIDGETS = (*BARE, "--widgets")
Size = tuple[int, int]
SMALL, USUAL = (80, 24), (120, 36)
LIVE, CLOCK, FOOTER = b"referee (sensor)", b"clock", b"F10"
"""What our live pane, the bare app and each of our screens say."""
PANES = (("\x1b[11~", b"this page; also"), ("\x1b[12~", b"Opening side"))
"""Keys of two panes, and what only that pane says; the last is shown first."""
CONSOLE, PLAIN, STOCK = "console", "bare app", "widgets"


class Wire(Terminal):
    """A terminal that takes what comes and does not draw it."""

    def __init__(
        self, argv: Sequence[str], env: dict[str, str] | None = None, size: Size = SMALL
    ) -> None:
        self.began = time.monotonic()
        super().__init__(argv, *size, env, ROOT)

    def arrival(self, text: bytes, since: int = 0) -> float:
        """How long after the launch `text` is written; not before that byte, s."""
        while self.output.find(text, since) < 0:
            assert time.monotonic() < self.began + STARTING, bytes(self.output[-500:])
            self._read(0.01)
        return time.monotonic() - self.began

    def reply(self, pressed: str, text: bytes) -> float:
        """How long after a key `text` is written, s."""
        written, self.began = len(self.output), time.monotonic()
        self.send(pressed)
        return self.arrival(text, written)

    def read_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._read(left)


def live(repeats: int) -> list[Figure]:
    """Screens of a run, beside apps of Textual; all at once.

    The apps: many widgets with clocks, a clock.
    """
    programs = {
        CONSOLE: (MADROB, LIVE),
        STOCK: (WIDGETS, CLOCK),
        PLAIN: (BARE, CLOCK),
    }
    with ExitStack() as stack:
        engine, domain = stack.enter_context(hall(RATES[0]))
        engine.start(make_setup(timeout=TIMEOUT))
        watch = ("watch", "--testbed", "ros", f"--results={engine.results}")
        wires = {}
        for name, (argv, text) in programs.items():
            ours = watch if text is LIVE else ()
            wires[name] = stack.enter_context(
                Wire((*argv, *ours), {"ROS_DOMAIN_ID": str(domain)}, size=USUAL)
            )
            wires[name].arrival(text)
        sent, shares = _costs(wires, min(repeats, MOST))
    name = f"screen of a run, {USUAL[0]}x{USUAL[1]}"
    return [
        Figure(name, unit, values[CONSOLE], other, values[other], goal)
        for unit, values, other, goal in (
            ("kB/s", sent, STOCK, 0.4),
            ("% core", shares, STOCK, 0.8),
            ("% core", shares, PLAIN, 3.5),
        )
    ]


def _costs(
    wires: Mapping[str, Wire], repeats: int
) -> tuple[Mapping[str, list[float]], Mapping[str, list[float]]]:
    """Of each program kB/s on the line, and the share of a core, %, several times."""
    sent, shares = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for sample in range(1 + repeats):
        written = {name: len(wire.output) for name, wire in wires.items()}
        used = {name: cpu_time(wire.pid) for name, wire in wires.items()}
        began, seconds = time.monotonic(), SAMPLE if sample else SETTLING
        while time.monotonic() < began + seconds:
            for wire in wires.values():
                wire.read_for(0.005)
        for name, wire in wires.items() if sample else ():
            elapsed = time.monotonic() - began
            sent[name].append((len(wire.output) - written[name]) / 1000 / elapsed)
            shares[name].append(100 * (cpu_time(wire.pid) - used[name]) / elapsed)
    return sent, shares


def key(repeats: int) -> list[Figure]:
    """From a key until its change is drawn, beside apps of Textual; in turns."""
    took = defaultdict[str, list[float]](list)
    with _console() as console, Wire(BARE) as bare, Wire(WIDGETS) as widgets:
        wires = {CONSOLE: console, PLAIN: bare, STOCK: widgets}
        for name, wire in wires.items():
            wire.arrival(PANES[-1][1] if name is CONSOLE else CLOCK)
        for number in range(2 + repeats):
            pressed, shown = PANES[number % 2]
            for name, wire in wires.items():
                wire.read_for(READING)  # what is typed sooner may be left out
                ours = name is CONSOLE
                took[name].append(
                    wire.reply(pressed, shown) if ours else wire.reply("k", b"key %d" % number)
                )
    times = {name: [1000 * each for each in values[2:]] for name, values in took.items()}
    return [
        Figure("a key until it is drawn", "ms", times[CONSOLE], other, times[other], goal)
        for other, goal in ((PLAIN, 12.0), (STOCK, 1.9))
    ]


def first_paint(repeats: int) -> list[Figure]:
    """From the command to the screen with its footer, beside apps of Textual; in turns."""
    took = defaultdict[str, list[float]](list)
    for _ in range(1 + repeats):
        with _console() as wire:
            took[CONSOLE].append(wire.arrival(FOOTER))
        for name, argv in ((PLAIN, BARE), (STOCK, WIDGETS)):
            with Wire(argv) as wire:
                took[name].append(wire.arrival(CLOCK))
    # the first time files come into memory and are compiled
    return [
        Figure("launch to the first paint", "s", took[CONSOLE][1:], other, took[other][1:], goal)
        for other, goal in ((PLAIN, 1.7), (STOCK, 2.1))
    ]


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
