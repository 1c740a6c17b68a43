"""`madrob recover`: torn bags to whole ones."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.command_line import command
from madrob_console.cli.output import BAD_INPUT, Complaints
from madrob_console.cli.progress import counted_off
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from recorder import RecorderError

if TYPE_CHECKING:
    from madrob_console.archive.run_paths import RunPath
    from recorder.recovery import Recovered


@command(
    "recover",
    "repair recordings that were cut off, and their results",
    "Writes a whole bag beside the torn one, which is kept. The result of a run folder is made "
    "again if a power cut left it out of date. A damaged one becomes what it was, else the next "
    "version. Where the recording lacks messages of it, nothing is made again.",
    options=(options.PATHS,),
    examples=("madrob recover my_run", "madrob recover ~/madrob_runs"),
)
def recover(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.run_paths import all_runs_at

    runs = all_runs_at(arguments.paths)
    with Complaints() as bad:
        for run in counted_off(runs, "recordings"):
            try:
                _recover(run)
            except (MadrobError, RecorderError) as error:
                bad.add_complaint(error, run.name)
    return BAD_INPUT if bad.count else 0


def _recover(run: RunPath) -> None:
    from madrob_console.archive.folders import RESULT_FILE
    from madrob_console.cli.repairing import repair_run
    from recorder.recovery import recover as recover_recording

    run.demand_recording()
    with _journal_held(run.path):
        recovered = recover_recording(run.path)
    line = _line(run.path, recovered)  # a run that is held would be taken for one going on
    try:
        if repair_run(run.path, restore=True):
            line += "; its result was made again from journal and recording"
        elif recovered.cut and (run.path / RESULT_FILE).exists():
            line += "; its result stays as it was issued"
    finally:
        print(terminal_safe(line))


@contextmanager
def _journal_held(path: Path) -> Iterator[None]:
    """Keep the engine from resuming the run while inside."""
    from madrob_console.archive.folders import JOURNAL_FILE
    from madrob_console.archive.unfinished_runs import is_held
    from madrob_console.common.file_locks import Hold
    from madrob_console.referee.journal import HOLD_FILE

    busy = MadrobError(
        f"{path}: the engine still holds this run; end it and leave it in the console, "
        "or stop the engine, then try again"
    )
    folder = path if path.is_dir() else Path(os.path.realpath(path)).parent
    if is_held(folder / JOURNAL_FILE):
        raise busy
    with ExitStack() as stack:
        try:
            if (folder / JOURNAL_FILE).is_file():
                stack.enter_context(Hold(folder / HOLD_FILE))
        except BlockingIOError:
            raise busy from None
        except OSError:
            pass  # it cannot be written, and neither can the bag
        yield


def _line(path: Path, recovered: Recovered) -> str:
    count = f"{recovered.messages} messages"
    if recovered.cut:
        state = (
            f"{count} kept; {_cut(recovered)}; the new file is {recovered.file}"
            f"{_old_one(recovered)}; {_scoring(path)}"
        )
    elif recovered.metadata is not None:
        state = f"whole, {count}; metadata.yaml was written anew; {_scoring(path)}"
    else:
        state = f"whole, {count}; nothing was written"
    return f"{path}: {state}"


def _old_one(recovered: Recovered) -> str:
    torn = recovered.torn
    return "" if torn is None else f", the old one is kept as {torn.name}"


def _cut(recovered: Recovered) -> str:
    return f"cut: {', '.join(recovered.cut)}"


def _scoring(path: Path) -> str:
    import shlex

    from madrob_console.archive.scored import read_recorded_run

    try:
        read_recorded_run(path)
    except (MadrobError, RecorderError):
        return "there is no run in it to be scored"
    return f"`madrob score {shlex.quote(str(path))}` works"
