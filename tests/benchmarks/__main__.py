"""Measure what the papers claim of speed and size, and say what came out.

    python -m tests.benchmarks [NAME...] [--repeats N]

prints a table, each row as it is measured. Ends with 1 if a goal is not met or something could not
be measured.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence

from tests.benchmarks.commands import help_text
from tests.benchmarks.recording import mcap_writer, take_loop
from tests.benchmarks.report import Figure, Verdict, head, row
from tests.benchmarks.scoring import layouts
from tests.benchmarks.screens import compositor, first_paint, lines, live

REPEATS = 5

Benchmark = Callable[[int], list[Figure]]

CLAIMS: Mapping[str, tuple[str, Benchmark]] = {
    "take_loop": (
        "an executor costs 91 to 231 us a message and loses messages at 30,000 messages/s;",
        take_loop,
    ),
    "mcap_writer": ("0.7 instead of 3.4 us a message", mcap_writer),
    "layouts": ("it halves the time of a rescoring.", layouts),
    "lines": ("11 instead of 103 to 311 kB/s over SSH.", lines),
    "compositor": ("3 instead of 5 kB/s in a run, 8 instead of 15 at 160x50.", compositor),
    "live": ("at most twice the CPU of an app that shows a clock", live),
    "help": ("`--help` takes 2.2 times what starting argparse takes;", help_text),
    "first_paint": ("the first paint does not wait for them.", first_paint),
}
"""What ARCHITECTURE.md says, word for word, and what measures it."""


def measure(claims: Mapping[str, tuple[str, Benchmark]], repeats: int) -> Iterator[Figure]:
    """The figures of all claims; one that fails is a figure too, and the others go on."""
    for name, (claim, benchmark) in claims.items():
        print(f"measuring: {claim}", file=sys.stderr, flush=True)
        try:
            yield from benchmark(repeats)
        except Exception as error:  # noqa: BLE001  whatever it is, it belongs into the table
            yield Figure(name, problem=f"{type(error).__name__}: {error}")


def main(
    argv: Sequence[str] | None = None, claims: Mapping[str, tuple[str, Benchmark]] = CLAIMS
) -> int:
    """Measure; the exit code."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # what is installed is compiled
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(claims)}")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="of each measurement")
    arguments = parser.parse_args(argv)
    if unknown := set(arguments.names) - set(claims):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}: use {', '.join(claims)}")
    wanted = {name: claims[name] for name in arguments.names or claims}
    print(head(), flush=True)
    good = True
    for figure in measure(wanted, arguments.repeats):
        print(row(figure), flush=True)
        good &= figure.verdict is Verdict.MET
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
