"""`madrob recover`: torn bags to whole ones."""

from __future__ import annotations

import argparse
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.problems import BAD_INPUT, complain
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from recorder.errors import RecorderError
from scoring.imports import imports_kept

if TYPE_CHECKING:
    from recorder.recovery import Recovered


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "recover",
        main,
        "repair recordings that were cut off",
        "Writes a whole bag beside the torn one, which is kept. PATH is a run folder or a bag.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")


def main(arguments: argparse.Namespace) -> int:
    """Repair every path; a bad one is named and does not stop the rest."""
    with imports_kept():
        from recorder.recovery import recover

    bad = 0
    for path in arguments.paths:
        try:
            with _journal_held(path):
                line = _line(path, recover(path))
        except (MadrobError, RecorderError) as error:
            complain(error)
            bad += 1
            continue
        print(terminal_safe(line))
    return BAD_INPUT if bad else 0


@contextmanager
def _journal_held(path: Path) -> Iterator[None]:
    """Keep the engine from going on with the run meanwhile.

    Raises:
        MadrobError: it does so already.
    """
    from madrob_console.archive.folders import JOURNAL_FILE

    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        folder = path if path.is_dir() else Path(os.path.realpath(path)).parent
        journal = os.open(folder / JOURNAL_FILE, flags)
    except OSError:  # a bag of others; or it cannot be read, and neither can the bag
        yield
        return
    try:
        try:
            fcntl.flock(journal, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MadrobError(
                f"{path}: the engine still holds this run; end it and leave it in the console, "
                "or stop the engine, then try again"
            ) from None
        except OSError:
            pass  # not every network disk has locks
        yield
    finally:
        os.close(journal)


def _line(path: Path, recovered: Recovered) -> str:
    count = f"{recovered.messages} messages"
    if not recovered.changed:
        return f"{path}: whole, {count}; nothing was written"
    if recovered.torn is None:
        return f"{path}: whole, {count}; metadata.yaml was written anew; {_scoring(path)}"
    return (
        f"{path}: {count} kept; cut: {', '.join(recovered.cut)} "
        f"({recovered.tail_bytes} bytes at the end); the new file is {recovered.file}, the old one "
        f"is kept as {recovered.torn.name}; {_scoring(path)}"
    )


def _scoring(path: Path) -> str:
    import shlex

    from madrob_console.archive.scored import read_recorded_run

    try:
        read_recorded_run(path)
    except (MadrobError, RecorderError):
        return "there is no run in it to be scored"
    return f"`madrob score {shlex.quote(str(path))}` works"
