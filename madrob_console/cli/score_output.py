"""`madrob score --output`: the tables of results that are made now, for programs."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.shards import Shard
from madrob_console.cli.problems import BAD_INPUT, Complaints, name_twins
from madrob_console.cli.progress import Tell, progress
from madrob_console.cli.sharing import lost_words, shared
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.tidy.run_tables import RUN_TABLES, UNREADABLE
from madrob_console.tidy.tidy_table import TableFormat
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.tidy.run_rows import Row, RowWriter

_ALL = (*RUN_TABLES, UNREADABLE)


class FreshRows(NamedTuple):
    """What the tables have of one run.

    Attributes:
        rows: by the name of the table.
        run_id: which run it is; empty = not known.
        problem: why it cannot be scored, on one line; None = it can.
    """

    rows: Mapping[str, Sequence[Row]]
    run_id: str = ""
    problem: str | None = None


def fresh_rows(run: RunPath, *, rules: tuple[RulesetName | None, ...]) -> FreshRows:
    """Score a run for the tables. Never raises: one bad run must not stop the others.

    Args:
        run: which one.
        rules: the rulesets, each once; None = that of the run.
    """
    from madrob_console.archive.stored_runs import fresh_runs
    from madrob_console.tidy.run_rows import rows_of

    try:
        scored = fresh_runs(run, rules)
        rows = {
            table.name: [row for one in scored for row in rows_of(table, one)]
            for table in RUN_TABLES
        }
        return FreshRows(rows, scored[0].label.run_id)
    except MadrobError as error:
        return FreshRows({}, problem=str(error))
    except Exception as error:  # noqa: BLE001  # a fault of ours must not stop the others either
        return FreshRows({}, problem=f"{run.name}: cannot be scored ({error!r}): please report it")


def write_tables(
    arguments: argparse.Namespace, runs: Sequence[RunPath], rules: tuple[RulesetName | None, ...]
) -> int:
    """Write the tables of all runs, whole or not at all; one that cannot be read has its row.

    Raises:
        MadrobError: the folder is there already, or the disk refuses.
    """
    from madrob_console.files.whole import new_folder, whole_file
    from madrob_console.tidy.run_rows import RowWriter
    from madrob_console.tidy.table_files import TableWriter, check_writable

    kind = arguments.format or TableFormat.CSV
    check_writable(kind)
    folder = _folder(arguments.output.absolute(), arguments.shard)
    with ExitStack() as stack:
        bad = stack.enter_context(Complaints())
        tell = stack.enter_context(progress("runs"))
        part = stack.enter_context(new_folder(folder))
        writers = {}
        for table in _ALL:
            file = stack.enter_context(whole_file(part / f"{table.name}.{kind}"))
            writer = RowWriter(TableWriter(file, table, kind), table)
            writers[table.name] = stack.enter_context(closing(writer))
        work = partial(fresh_rows, rules=rules)
        made = stack.enter_context(closing(shared(arguments, work, runs, _lost)))
        _write(runs, made, writers, bad, tell)
    print(terminal_safe(f"{folder}: {len(runs)} runs, {bad.count} of them cannot be read"))
    return BAD_INPUT if bad.count else 0


def _folder(output: Path, shard: Shard | None) -> Path:
    """Where the tables go; no two shards of a division to the same place.

    Raises:
        MadrobError: there are tables of another division.
    """
    if shard is None:
        return output
    others = sorted(path.name for path in output.glob("shard_*_of_*"))
    if alien := [name for name in others if not name.endswith(f"_of_{shard.count}")]:
        raise MadrobError(
            f"{output / alien[0]}: is a share of another division, runs would be there twice; "
            "move it away or choose another folder"
        )
    return output / shard.folder_name


def _write(
    runs: Sequence[RunPath],
    made: Iterable[FreshRows],
    writers: Mapping[str, RowWriter],
    bad: Complaints,
    tell: Tell,
) -> None:
    """The rows of all runs, each run once, one after the other."""
    from madrob_console.archive.stored_runs import Counted

    counted = Counted.of(runs).places
    twins: list[tuple[str, str]] = []
    tell(0, len(runs))
    for number, (run, one) in enumerate(zip(runs, made, strict=True), start=1):
        tell(number, len(runs))
        if one.problem is not None:
            bad.add(one.problem, run.name)
            reason = one.problem.removeprefix(f"{run.name}: ")
            writers[UNREADABLE.name].add([{"place": run.name, "reason": reason}])
        elif one.run_id and (place := counted.setdefault(one.run_id, run.name)) != run.name:
            twins.append((run.name, place))
        else:
            for table in RUN_TABLES:
                writers[table.name].add(one.rows[table.name])
    name_twins(twins)


def _lost(run: RunPath, why: str) -> FreshRows:
    return FreshRows({}, problem=lost_words(run, why))
