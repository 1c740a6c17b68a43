"""What the screens cost and how soon they answer, in a pty, beside a bare Textual app.

Ours and the bare app take turns, so that what else the machine does hits both.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from random import Random
from statistics import median

from tests.benchmarks.console import console, start_run
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.wire import SETTLING, SMALL, STARTED, STARTING, Cost, Size, Wire
from tests.readme_console import ENTER

PACKAGES = ("textual",)

BARE = [sys.executable, "-m", "tests.benchmarks.bare_app"]
STOCK = [sys.executable, "-m", "tests.benchmarks.stock_app"]
FAKE = [sys.executable, "-m", "tests.madrob_console.ui.fake_engine"]
SIMULATED = ("--testbed", "simulated")

LARGE = 160, 50
LIVE_BYTES = {SMALL: Goal(times=3), LARGE: Goal(times=2)}
IDLE_BYTES = Goal(times=1.5)
LIVE_SHARE = Goal(times=2)
ANSWER = Goal(times=25)
PANE = Goal(times=1.2)
OUTLIER = Goal(times=2)
"""The slowest key beside the median of them all."""
FIRST_PAINT = Goal(times=1.7)
ENGINE_ATTACHED = Goal(times=7.5)
MOST = 3
"""Repeats of what takes half a minute."""

LEAST_KEYS = 50
GAPS = 0.12, 0.35  # s between two keys, drawn anew so that they meet every phase of the redrawing

FORM, FOOTER, CHECKS, LIVE = b"Opening side", b"F10", b"Checks", b"ruling (sensors)"
"""What only the set-up form, the footer, the list of checks and the live pane say."""
CLOCK = b"clock"
F2, F3 = "\x1bOQ", "\x1bOR"
PANE_KEYS = (
    ("F2, the set-up", F2, FORM),
    ("F3, the live pane", F3, LIVE),
    ("?, the help", "?", b"F9 declares a timeout"),
    ("?, back", "?", LIVE),
)
"""Keys that change the pane, and what comes."""
STOCK_TEXTS = (b"check 5 passed", b"view 11", b"this page", b"view 11")
"""The same of the app with textual's own widgets."""
PARTS = (("bytes", "kB/s"), ("CPU", "% core"), ("CPU with the engine", "% core"))
"""What the parts of a cost are called."""


def screens(repeats: int) -> list[Figure]:
    """Bytes and CPU of the screens alone, with an engine that only moves."""
    live, bare = defaultdict[Size, list[Cost]](list), defaultdict[Size, list[Cost]](list)
    idle: list[Cost] = []
    for _ in range(min(repeats, MOST)):
        for size in LIVE_BYTES:
            live[size].append(_cost([*FAKE, "--running"], LIVE, size))
            bare[size].append(bare_cost(size))
        idle.append(_cost(FAKE, CHECKS, SMALL))
    figures: list[Figure] = []
    for size, goal in LIVE_BYTES.items():
        figures += _figures(f"live run, {_text(size)}", live[size], (goal, LIVE_SHARE), bare[size])
    name = f"idle set-up, {_text(SMALL)}"
    return [*figures, *_figures(name, idle, (IDLE_BYTES, None), bare[SMALL])]


def simulated_runs(repeats: int) -> list[Figure]:
    """Bytes and CPU of the whole console in a simulated run."""
    live, idle, bare = (defaultdict[Size, list[Cost]](list) for _ in range(3))
    for _ in range(min(repeats, MOST)):
        for size in LIVE_BYTES:
            bare[size].append(bare_cost(size))
            with console(SIMULATED, size, blind=False) as wire:
                wire.wait_for("2 of 9 in the way", timeout=STARTING)
                idle[size].append(wire.cost())
                start_run(wire)
                live[size].append(wire.cost())
    figures: list[Figure] = []
    for size, goal in LIVE_BYTES.items():
        live_goals, idle_goals = (goal, LIVE_SHARE, None), (IDLE_BYTES, None, None)
        figures += _figures(f"simulated run, {_text(size)}", live[size], live_goals, bare[size])
        figures += _figures(f"idle before it, {_text(size)}", idle[size], idle_goals, bare[size])
    return figures


def answers(repeats: int) -> list[Figure]:
    """From a key to the first bytes that only it explains."""
    rounds = max(4, -(-LEAST_KEYS // (repeats * len(PANE_KEYS))))
    ours = defaultdict[str, list[float]](list)
    bare: list[float] = []
    stock: list[float] = []
    for repeat in range(repeats):
        random = Random(repeat)
        with Wire([*FAKE, "--running"]) as wire:
            wire.arrival(LIVE)
            wire.read_for(SETTLING)
            for name, key, text in PANE_KEYS * rounds:
                ours[name].append(_answer(wire, key, text, random))
        with Wire(BARE) as wire:
            wire.arrival(CLOCK)
            wire.read_for(SETTLING)
            counts = (b"keys %d." % n for n in range(1, len(PANE_KEYS) * rounds + 1))
            bare += [_answer(wire, "k", count, random) for count in counts]
        with Wire(STOCK) as wire:
            wire.arrival(STOCK_TEXTS[-1])
            wire.read_for(SETTLING)
            texts = list(zip(PANE_KEYS, STOCK_TEXTS, strict=True)) * rounds
            stock += [_answer(wire, key, text, random) for (_, key, _), text in texts]
    beside = Baseline("bare app", bare)
    every = [value for values in ours.values() for value in values]
    as_many, usual = Baseline("stock app", stock), Baseline("the median", [median(every)])
    return [
        Figure(f"a key answers ({len(every)} keys)", "ms", every, ANSWER, beside),
        Figure("a key changes the screen, as many widgets", "ms", every, PANE, as_many),
        Figure("the slowest key", "ms", [max(every)], OUTLIER, usual),
        *(Figure(f"  {name}", "ms", values, ANSWER, beside) for name, values in ours.items()),
    ]


def launch(repeats: int) -> list[Figure]:
    """From the command to the screen and to the first key that is obeyed."""
    marks = {
        "launch to the screen with its footer": (FOOTER, FIRST_PAINT),
        "launch to the set-up form": (FORM, None),
        "launch to the checks (engine attached)": (CHECKS, ENGINE_ATTACHED),
    }
    ours = defaultdict[str, list[float]](list)
    bare: list[float] = []
    obeyed: list[float] = []
    with console(SIMULATED) as wire:
        wire.arrival(CHECKS)  # once before: files are in memory and compiled
    for _ in range(repeats):
        with console(SIMULATED) as wire:
            began = wire.arrival(STARTED)
            for name, (mark, _goal) in marks.items():
                ours[name].append(wire.arrival(mark) - began)
            wire.send(ENTER)
            obeyed.append(wire.arrival(b"is set up") - began)
        with Wire(BARE) as wire:
            began = wire.arrival(STARTED)
            bare.append(wire.arrival(CLOCK) - began)
    baseline = Baseline("bare app", bare)
    return [
        *(Figure(name, "s", ours[name], goal, baseline) for name, (_, goal) in marks.items()),
        Figure("launch to the first Enter obeyed", "s", obeyed, None, baseline),
    ]


BENCHMARKS = (screens, simulated_runs, answers, launch)


def bare_cost(size: Size) -> Cost:
    """What the bare app takes."""
    return _cost(BARE, CLOCK, size)


def _cost(argv: Sequence[str], mark: bytes, size: Size) -> Cost:
    with Wire(argv, size) as wire:
        wire.arrival(mark)
        return wire.cost()


def _answer(wire: Wire, key: str, text: bytes, random: Random) -> float:
    """Milliseconds from a key to what it brings."""
    wire.read_for(random.uniform(*GAPS))
    since, began = len(wire.output), time.monotonic()
    wire.send(key)
    return 1000 * (wire.arrival(text, since) - began)


def _figures(
    name: str, costs: Sequence[Cost], goals: Sequence[Goal | None], bare: Sequence[Cost]
) -> Iterator[Figure]:
    """The parts of a cost for which there is a goal or None."""
    for part, ((what, unit), goal) in enumerate(zip(PARTS, goals, strict=False)):
        beside = Baseline("bare app", [cost[part] for cost in bare])
        yield Figure(f"{name}: {what}", unit, [cost[part] for cost in costs], goal, beside)


def _text(size: Size) -> str:
    return "{}x{}".format(*size)
