"""Measure and say what came out.

    python -m tests.benchmarks [NAME...] [--repeats N] [--json FILE] [--before FILE]

prints a table, each row as it is measured, and writes every single value to a JSON file; with the
one of an earlier go the table tells its values, too. Ends with 1 if a goal is not met or something
could not be measured. A benchmark NAME is a module beside this one with `PACKAGES`
(whose versions matter) and `BENCHMARKS` (functions from a number of repeats to figures).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

from tests.benchmarks.report import (
    Before,
    Figure,
    Report,
    head,
    load_text,
    read_before,
    row,
    this_machine,
)

NAMES = (
    "archive",
    "commands",
    "evidence",
    "live",
    "overload",
    "recording",
    "replay",
    "reports",
    "scoring",
    "terminal",
)
REPEATS = 5

Benchmark = Callable[[int], Iterable[Figure]]


def measure(benchmarks: Sequence[Benchmark], repeats: int) -> Iterator[Figure]:
    """The figures of all benchmarks; one that fails is a figure too, and the others go on."""
    for benchmark in benchmarks:
        told = (benchmark.__doc__ or benchmark.__name__).partition("\n")[0]
        print(f"measuring: {told}", file=sys.stderr, flush=True)
        try:
            yield from benchmark(repeats)
        except Exception as error:  # noqa: BLE001  whatever it is, it belongs into the table
            yield Figure(benchmark.__name__, problem=f"{type(error).__name__}: {error}")


def main(argv: Sequence[str] | None = None) -> int:
    """Measure; the exit code."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # what is installed is compiled
    arguments = _arguments(argv)
    modules = [import_module(f"tests.benchmarks.{name}") for name in arguments.names or NAMES]
    packages = dict.fromkeys(package for module in modules for package in module.PACKAGES)
    benchmarks = [benchmark for module in modules for benchmark in module.BENCHMARKS]
    machine = this_machine(list(packages))
    before: Before = read_before(arguments.before) if arguments.before else {}
    print(f"{machine.text()}\n\n{head()}", flush=True)
    figures, began = [], time.monotonic()
    for figure in measure(benchmarks, arguments.repeats):
        print(row(figure, before.get((figure.name, figure.unit))), flush=True)
        figures.append(figure)
    report = Report(machine, figures, os.getloadavg())
    for figure in figures:
        if figure.problem:
            print(f"FAILED {figure.name}: {figure.problem}")
    minutes = (time.monotonic() - began) / 60
    print(f"\nmeasured in {minutes:.1f} min, load average {load_text(report.load_after)}")
    path: Path = arguments.json or Path(tempfile.mkdtemp(prefix="madrob-"), "benchmarks.json")
    path.write_text(json.dumps(report.document(), indent=2) + "\n")
    print(f"all values: {path}")
    return 0 if report.good else 1


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}; else all")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="of each measurement")
    parser.add_argument("--json", type=Path, default=None, metavar="FILE")
    parser.add_argument(
        "--before", type=Path, default=None, metavar="FILE", help="the JSON of an earlier go"
    )
    arguments = parser.parse_args(argv)
    if unknown := set(arguments.names) - set(NAMES):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}: use {', '.join(NAMES)}")
    if arguments.repeats < 1:
        parser.error("--repeats: use 1 or more")
    return arguments


if __name__ == "__main__":
    sys.exit(main())
