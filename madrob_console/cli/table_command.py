"""`madrob table`: what there is of runs, as tables for programs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack, closing, nullcontext
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.cli import options
from madrob_console.cli.output import BAD_INPUT, Complaints, name_twins, progress, put_bytes
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.export.table_columns import (
    RUN_TABLES,
    SAMPLE_TABLES,
    TableFormat,
    TidyTable,
    column_lines,
)
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from typing_extensions import Buffer

    from madrob_console.archive.folders import RunPath

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


class _Written(NamedTuple):
    files: tuple[Path, ...] = ()
    problem: str | None = None


def add_command(commands: options.Commands) -> None:
    parser = options.command(
        commands,
        "table",
        None,
        "runs as tables for programs: csv, NDJSON or Parquet",
        examples=(
            "madrob table runs ~/madrob_runs > runs.csv",
            "madrob table indicators hall_a hall_b --format parquet --output all.parquet",
            "madrob table --columns",
        ),
    )
    _add_columns(parser, (*RUN_TABLES, *SAMPLE_TABLES))
    parts = parser.add_subparsers(metavar="WHAT")
    for table in RUN_TABLES:
        _add_runs(parts, table)
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
    _add_columns(samples, SAMPLE_TABLES)
    samples.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    samples.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="folder for the tables; made if there is none",
    )
    options.add_format(samples)
    options.add_choice(
        samples, "--ruleset", RulesetName, None, "the rules; those of the run if not given"
    )
    options.add_jobs(samples, "read")


def _add_runs(parts: options.Commands, table: TidyTable) -> None:
    parser = options.command(
        parts,
        table.name,
        partial(_runs, table=table),
        table.row,
        "\n".join([_RUNS, *column_lines([table])]),
        (f"madrob table {table.name} ~/madrob_runs --output {table.name}.csv",),
    )
    _add_columns(parser, (table,))
    options.add_run_paths(parser)
    parser.add_argument(
        "--output",
        type=Path,
        default=_STDOUT,
        metavar="FILE",
        help="the file; standard output if not given, or -",
    )
    options.add_format(parser)
    options.add_settings(parser)


class _TellColumns(argparse.Action):
    """Prints the columns of the tables in `const`; no path is needed, as for `--help`."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        _namespace: argparse.Namespace,
        _values: object,
        _option_string: str | None = None,
    ) -> None:
        print("\n".join(column_lines(self.const)))
        parser.exit()


def _add_columns(parser: argparse.ArgumentParser, tables: Sequence[TidyTable]) -> None:
    parser.add_argument(
        "--columns",
        action=_TellColumns,
        nargs=0,
        const=tables,
        help="tell the columns, their units and meaning, and end",
    )


def _runs(arguments: argparse.Namespace, table: TidyTable) -> int:
    from madrob_console.archive.folders import listed_at
    from madrob_console.common.files import whole_file
    from madrob_console.config import load_settings
    from madrob_console.export.read_runs import ReadRuns
    from madrob_console.export.rows import TableWriter, check_writable

    output: Path = arguments.output
    to_terminal = output == _STDOUT
    if to_terminal and arguments.format is TableFormat.PARQUET:
        raise MadrobError("Parquet is no text: name a file with --output")
    check_writable(arguments.format)
    paths = options.run_paths(arguments, load_settings(arguments.settings))
    for path in paths:
        if not path.exists():  # before it takes the place of a table that is there
            raise MadrobError(f"{path}: no such folder; name a folder with runs")
    with ExitStack() as stack:
        bad = stack.enter_context(Complaints())
        read = ReadRuns(table, stack.enter_context(TemporaryFile()))
        with progress("runs") as tell:
            runs = list(listed_at(paths))
            for number, (run, problem) in enumerate(zip(runs, read.add_runs(runs), strict=True)):
                tell(number, len(runs))
                if problem is not None:
                    bad.add_complaint(problem, run.run.name)
        chosen = read.chosen(arguments.testbed_name, arguments.competition)
        target = nullcontext(_StandardOutput()) if to_terminal else whole_file(output)
        file = stack.enter_context(target)
        writer = stack.enter_context(closing(TableWriter(file, table, arguments.format)))
        for rows in chosen:
            writer.write_rows(rows)
    name_twins(read.twins)
    if not to_terminal:
        print(terminal_safe(str(output)))
    return BAD_INPUT if bad.count else 0


class _StandardOutput(BytesIO):
    def write(self, data: Buffer, /) -> int:
        put_bytes(bytes(data))
        return len(bytes(data))


def _samples(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.folders import all_runs_at
    from madrob_console.cli.sharing import in_order
    from madrob_console.export.rows import check_writable

    output: Path = arguments.output
    check_writable(arguments.format)
    runs = all_runs_at(arguments.paths)
    chosen = {run.own_name: run for run in reversed(runs)}  # the first of each name
    write = partial(write_samples, output=output, rules=arguments.ruleset, kind=arguments.format)
    to_write = [run for run in runs if chosen[run.own_name] is run]
    with (
        closing(in_order(write, to_write, _lost, arguments.jobs)) as results,
        progress("runs") as tell,
        Complaints() as bad,
    ):
        tell(0, len(runs))
        for number, run in enumerate(runs, start=1):
            if (first := chosen[run.own_name]) is not run:
                bad.add_complaint(
                    f"{run.name}: is called like {first.name}: give it another --output", run.name
                )
            else:
                written = next(results)
                if written.problem is not None:
                    bad.add_complaint(written.problem, run.name)
                for path in written.files:
                    print(terminal_safe(str(path)), flush=True)
            tell(number, len(runs))
    return BAD_INPUT if bad.count else 0


def _lost(run: RunPath, why: str) -> _Written:
    return _Written(problem=f"{run.name}: its samples are not written: {why}")


def write_samples(
    run: RunPath, *, output: Path, rules: RulesetName | None, kind: TableFormat
) -> _Written:
    """Write the tables of one run, which alone is in memory; never raises."""
    from madrob_console.archive.scored import score_with_series
    from madrob_console.export.rows import SampledRun, write_table

    if run.prefix:
        return _Written(problem=f"{run.name}: files without a recording: give the run's bag")
    try:
        scored, series = score_with_series(run.path, rules)
        sampled = SampledRun(run.own_name, scored, series, scored.record.label(run.path))
        output.mkdir(parents=True, exist_ok=True)
        files = []
        for table in SAMPLE_TABLES:
            path = output / f"{run.own_name}_{table.name}.{kind}"
            write_table(path, table, sampled.columns_of(table), kind)
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
