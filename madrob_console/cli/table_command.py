"""`madrob table`: what there is of runs, as tables for programs."""

from __future__ import annotations

import argparse
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.cli import options
from madrob_console.cli.problems import BAD_INPUT, Complaints
from madrob_console.cli.progress import progress
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.tidy.sample_tables import SAMPLE_TABLES
from madrob_console.tidy.tidy_table import TableFormat, column_lines
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.run_paths import RunPath

_SAMPLES = """\
From the opening of a recording to its end, before it is cut to the run, by the code that makes \
the result. PATH is a bag, a run folder or a results folder. Each run gets these files, called \
like its folder: RUN_run.csv, RUN_door.csv and so on.
"""


class _Written(NamedTuple):
    """What came of one run: its files, or why there are none."""

    files: tuple[Path, ...] = ()
    problem: str | None = None


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "table",
        None,
        "runs as tables for programs, csv or Parquet",
        examples=("madrob table samples --help",),
    )
    parts = parser.add_subparsers(metavar="WHAT")
    samples = options.command(
        parts,
        "samples",
        _samples,
        "all that the sensors of a run said, and what the indicators are made of",
        "\n".join([_SAMPLES, *column_lines(SAMPLE_TABLES)]),
        (
            "madrob table samples my_run --output tables",
            "madrob table samples ~/madrob_runs --output tables --format parquet",
        ),
    )
    samples.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    samples.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="folder for the tables; made if there is none",
    )
    options.add_choice(
        samples,
        "--format",
        TableFormat,
        TableFormat.CSV,
        "of the files; parquet needs the extra `tables`",
    )
    options.add_choice(
        samples, "--ruleset", RulesetName, None, "the rules; those of the run if not given"
    )
    options.add_jobs(samples, "read")


def _samples(arguments: argparse.Namespace) -> int:
    """Write the tables of every run at the paths; a bad one is named and does not stop the rest."""
    from madrob_console.archive.run_paths import runs_at
    from madrob_console.cli.batch import in_order
    from madrob_console.tidy.table_files import check_writable

    output: Path = arguments.output
    check_writable(arguments.format)
    runs = [run for path in arguments.paths for run in runs_at(path)]
    chosen = {run.own_name: run for run in reversed(runs)}  # the first of each name
    write = partial(write_samples, output=output, rules=arguments.ruleset, kind=arguments.format)
    to_write = [run for run in runs if chosen[run.own_name] is run]
    with (
        closing(in_order(write, to_write, arguments.jobs, arguments.backend)) as results,
        progress("runs") as tell,
        Complaints() as bad,
    ):
        tell(0, len(runs))
        for number, run in enumerate(runs, start=1):
            if (first := chosen[run.own_name]) is not run:
                bad.add(
                    f"{run.name}: is called like {first.name}: give it another --output", run.name
                )
            else:
                written = next(results)
                if written.problem is not None:
                    bad.add(written.problem, run.name)
                for path in written.files:
                    print(terminal_safe(str(path)), flush=True)
            tell(number, len(runs))
    return BAD_INPUT if bad.count else 0


def write_samples(
    run: RunPath, *, output: Path, rules: RulesetName | None, kind: TableFormat
) -> _Written:
    """Write the tables of one run. Never raises: one bad run must not stop the others.

    Args:
        run: which one; no more than one is in memory.
        output: folder for the tables.
        rules: the ruleset; None = that of the run.
        kind: of the files.
    """
    from madrob_console.archive.scored import score_with_series
    from madrob_console.tidy.sample_rows import sample_rows
    from madrob_console.tidy.table_files import write_table

    if run.prefix:
        return _Written(problem=f"{run.name}: files without a recording: give the run's bag")
    try:
        rows = sample_rows(run.own_name, *score_with_series(run.path, rules))
        output.mkdir(parents=True, exist_ok=True)
        files = []
        for table in SAMPLE_TABLES:
            path = output / f"{run.own_name}_{table.name}.{kind}"
            write_table(path, table, rows[table.name], kind)
            files.append(path)
        return _Written(tuple(files))
    except MadrobError as error:
        return _Written(problem=str(error))
    except OSError as error:
        return _Written(
            problem=f"{output}: cannot be made ({error.strerror}): choose another --output"
        )
    except Exception as error:  # noqa: BLE001  # a fault of ours must not stop the others either
        return _Written(problem=f"{run.name}: no tables ({error!r}): please report it")
