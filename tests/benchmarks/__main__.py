"""Measure what a user waits for and what a machine pays.

    python -m tests.benchmarks [NAME...] [--repeats N]

prints a table in Markdown, each row as it is measured, and last what machine it was. Ends with 1 if
a goal is not met or something could not be measured.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from tests.benchmarks.archive import lists, run_scored
from tests.benchmarks.engine import abort, engine_cpu
from tests.benchmarks.recording import arrived
from tests.benchmarks.report import Figure, Verdict, head, machine, row
from tests.benchmarks.results import results
from tests.benchmarks.screens import first_paint, key, live

REPEATS = 5

Benchmark = Callable[[int], Iterable[Figure]]

BENCHMARKS: Mapping[str, Benchmark] = {
    "first_paint": first_paint,
    "key": key,
    "live": live,
    "abort": abort,
    "results": results,
    "engine": engine_cpu,
    "arrived": arrived,
    "run_scored": run_scored,
    "lists": lists,
}


def measure(benchmarks: Mapping[str, Benchmark], repeats: int) -> Iterator[Figure]:
    """The figures of all benchmarks; one that fails is a figure too, and the others go on."""
    for name, benchmark in benchmarks.items():
        began = time.monotonic()
        try:
            yield from benchmark(repeats)
        except Exception as error:  # noqa: BLE001  whatever it is, it belongs into the table
            yield Figure(name, problem=f"{type(error).__name__}: {error}")
        print(f"{name} took {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)


def main(
    argv: Sequence[str] | None = None, benchmarks: Mapping[str, Benchmark] = BENCHMARKS
) -> int:
    """Measure; the exit code."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # what is installed is compiled
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(benchmarks)}")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="of each measurement, at most")
    arguments = parser.parse_args(argv)
    if unknown := set(arguments.names) - set(benchmarks):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}: use {', '.join(benchmarks)}")
    wanted = {name: benchmarks[name] for name in arguments.names or benchmarks}
    print(head(), flush=True)
    good = True
    for figure in measure(wanted, arguments.repeats):
        print(row(figure), flush=True)
        good &= figure.verdict is Verdict.MET
    print(f"\n{machine()}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
