"""`madrob table`: what there is of runs, as tables for programs."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.archive.table_columns import (
    RUN_TABLES,
    SAMPLE_TABLES,
    TidyTable,
    column_lines,
    rows_of,
)
from madrob_console.cli import option_values, options
from madrob_console.cli.batch import each_run
from madrob_console.cli.chosen_runs import demand_results
from madrob_console.cli.command_line import Argument, MadrobCommand, TellAction, command
from madrob_console.cli.output import BAD_INPUT, Complaints, name_twins
from madrob_console.cli.parsing import as_path
from madrob_console.cli.progress import counted_off
from madrob_console.cli.safe_stream import put_bytes
from madrob_console.common.names import terminal_safe
from scoring.indicator_table import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.run_paths import RunPath
    from madrob_console.archive.table_rows import Sink

_SAMPLES = """\
From the opening of a recording to its end, before it is cut to the run, by the code that makes \
the result. PATH is a bag, a run folder or a folder with runs at any depth. Each run gets these \
files, called like its folder: RUN_run.csv, RUN_door.csv and so on.
"""


_RUNS = """\
Of the stored results (result.json) of all runs, at any depth below PATH, each run once. Exit \
code 2 when a result is missing or cannot be used; the rest is there.
"""

_STDOUT = Path("-")


def _columns(*tables: TidyTable) -> Argument:
    return Argument(
        "--columns",
        action=TellAction,
        const=lambda: "\n".join(column_lines(tables)),
        nargs=0,
        help="tell the columns, their units and meaning, and end",
    )


def _of_runs(table: TidyTable) -> MadrobCommand:
    return MadrobCommand(
        table.name,
        table.row,
        "\n".join([_RUNS, *column_lines([table])]),
        (
            _columns(table),
            *options.COLLECTION,
            Argument(
                "--output",
                type=as_path,
                default=_STDOUT,
                metavar="FILE",
                help="the file; standard output if not given, or -",
            ),
            options.SETTINGS,
        ),
        (f"madrob table {table.name} ~/madrob_runs --output {table.name}.csv",),
        partial(_runs, table=table),
    )


def _runs(arguments: argparse.Namespace, table: TidyTable) -> int:
    from madrob_console.archive.run_paths import RunPath
    from madrob_console.archive.stored_runs import stored_run
    from madrob_console.archive.table_rows import TableWriter
    from madrob_console.common.files import whole_file

    output: Path = arguments.output
    to_terminal = output == _STDOUT
    settings = option_values.settings_of(arguments)
    demand_results(arguments, settings)
    listed_runs = option_values.collection(arguments, settings)
    wanted = arguments.competition
    with ExitStack() as stack:
        bad = stack.enter_context(Complaints())
        bad.add_each(listed_runs.unlisted)
        file: Sink = _StandardOutput() if to_terminal else stack.enter_context(whole_file(output))
        writer = stack.enter_context(closing(TableWriter(file, table)))
        rows_are_seen = to_terminal and sys.stdout.isatty()  # a bar among them would spoil them
        for listed in listed_runs.runs if rows_are_seen else counted_off(listed_runs.runs, "runs"):
            run = RunPath(listed_runs.root / listed.folder)
            if not listed.twin and wanted in (None, listed.competition):
                with bad.complaining(run.name):
                    writer.write_rows(rows_of(table, stored_run(run)))
    name_twins([(listed.folder, listed.twin) for listed in listed_runs.runs if listed.twin])
    if not to_terminal:
        print(terminal_safe(str(output)))
    return BAD_INPUT if bad.count else 0


class _StandardOutput:
    def write(self, data: bytes, /) -> None:
        put_bytes(data)


@command(
    "samples",
    "all that the sensors of a run said, and what the indicators are made of",
    "\n".join([_SAMPLES, *column_lines(SAMPLE_TABLES)]),
    options=(
        _columns(*SAMPLE_TABLES),
        options.PATHS,
        Argument(
            "--output",
            type=as_path,
            required=True,
            metavar="FOLDER",
            help="folder for the tables; made if there is none",
        ),
        options.choice("--ruleset", RulesetName, "the rules; those of the run if not given"),
        options.JOBS,
    ),
    examples=(
        "madrob table samples my_run --output tables",
        "madrob table samples ~/madrob_runs --output tables",
    ),
)
def _samples(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.run_paths import all_runs_at

    output: Path = arguments.output
    runs = all_runs_at(arguments.paths)
    chosen = {run.own_name: run for run in reversed(runs)}  # the first of each name
    write = partial(write_samples, output=output, rules=arguments.ruleset)
    to_write = [run for run in runs if chosen[run.own_name] is run]
    with Complaints() as bad, closing(each_run(arguments, write, to_write, bad)) as written:
        for run in runs:
            if (first := chosen[run.own_name]) is not run:
                words = f"{run.name}: is called like {first.name}: give it another --output"
                bad.add_complaint(words, run.name)
        for _, files in written:
            for path in files or ():
                print(terminal_safe(str(path)), flush=True)
    return BAD_INPUT if bad.count else 0


table = MadrobCommand(
    "table",
    "runs as tables for programs: csv",
    options=(_columns(*RUN_TABLES, *SAMPLE_TABLES),),
    examples=(
        "madrob table runs ~/madrob_runs > runs.csv",
        "madrob table indicators hall_a hall_b --output all.csv",
        "madrob table --columns",
    ),
    parts=(*map(_of_runs, RUN_TABLES), _samples),
)


def write_samples(run: RunPath, *, output: Path, rules: RulesetName | None) -> list[Path]:
    """Write the tables of one run, which alone is in memory; MadrobError if it cannot be."""
    from madrob_console.archive.table_rows import SampledRun, write_table
    from madrob_console.common.files import make_folder

    sampled = SampledRun.of(run, rules)
    make_folder(output, "choose another --output")
    files = [output / f"{run.own_name}_{table.name}.csv" for table in SAMPLE_TABLES]
    for path, table in zip(files, SAMPLE_TABLES, strict=True):
        write_table(path, table, sampled.columns_of(table))
    return files
