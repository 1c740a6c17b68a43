"""`python -m madrob_console.cli.chore_worker HANDLE`: work of low priority.

It does the chores that the engine asks for over the socket with this handle, one after the other.
When the engine has ended, it finishes those it has got.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from madrob_console.cli.output import BAD_INPUT, complain
from madrob_console.common.errors import MadrobError
from madrob_console.engine.runtime.reports import Chore, ChoreKind, ChoreOutcome
from madrob_console.engine.runtime.worker_questions import answer_questions

COMMAND = (sys.executable, "-P", "-m", "madrob_console.cli.chore_worker")
"""Command line that starts a process for such work."""

NICENESS = 10
"""Added to the niceness of the caller: the engine, a run, a screen come first."""

_AGAIN = 0.5  # s

_ENDING = (signal.SIGTERM, signal.SIGALRM)
"""Signals at which the process leaves its work."""


class TerminatedError(BaseException):
    """A run begins: what is under way leaves no half-written file behind."""


def main() -> int:
    os.nice(NICENESS)
    return work(int(sys.argv[1]))


def work(handle: int) -> int:
    """Do what the engine asks for until it ends; the exit code of this process."""
    try:
        try:
            for number in _ENDING:
                signal.signal(number, _end)
            answer_questions(handle, carry_out)
        finally:  # one that comes now is caught below, a later one has nothing to end
            for number in _ENDING:
                signal.signal(number, signal.SIG_IGN)
    except TerminatedError:
        signal.setitimer(signal.ITIMER_REAL, 0)
        return 128 + signal.SIGTERM
    except (OSError, MemoryError) as error:  # it is started again
        print(f"madrob: reports, pages and zips wait: {error!r}", file=sys.stderr)
        return os.EX_TEMPFAIL
    return 0


def carry_out(chore: Chore) -> ChoreOutcome:
    """Do a chore as the command of its name would, with what it prints caught."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code, missing = _code_of(chore)
    output, error = (text.getvalue().strip().rpartition("\n")[2] for text in (out, err))
    return ChoreOutcome(code, output, error, tuple(map(str, missing)))


def _code_of(chore: Chore) -> tuple[int, Sequence[Path]]:
    """Do it; returns its exit code, and the folders of runs that lack a report."""
    try:
        return _done(chore)
    except (MadrobError, OSError, MemoryError) as error:
        complain(str(error) or "no memory: end other programs")
        # the disk, file handles or memory may come back; the run's folder does not
        retried = chore.place.is_dir() and chore.kind is not ChoreKind.MISSING
        return os.EX_TEMPFAIL if retried else BAD_INPUT, ()
    except SystemExit as error:  # of wrong options
        return error.code if isinstance(error.code, int) else BAD_INPUT, ()
    except Exception as error:  # noqa: BLE001  one bug costs one chore
        complain(f"{chore.name}: {error!r}")
        return BAD_INPUT, ()


def _done(chore: Chore) -> tuple[int, Sequence[Path]]:
    from madrob_console.archive.pictures import write_frames
    from madrob_console.cli.main import main as madrob
    from madrob_console.cli.repairing import renew_report, repair_all, without_report
    from madrob_console.pages.related_runs import RelatedRuns

    folder, missing = chore.place, list[Path]()
    match chore.kind:
        case ChoreKind.REPORT | ChoreKind.MISSING:
            renew_report(folder, RelatedRuns())
            return 0, ()
        case ChoreKind.REPAIR:
            problems: Sequence[str] = list(repair_all(folder))
            missing += without_report(folder) if chore.arguments[1:] else ()
        case ChoreKind.PICTURES:
            _, at, output = chore.arguments
            problems = write_frames(folder, at, Path(output))
        case _:
            return madrob([chore.kind.value, *chore.arguments]), ()
    for problem in problems:
        complain(problem)
    return BAD_INPUT if problems else 0, missing


def _end(_number: int, _frame: object) -> None:
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)  # an import may have swallowed it
    raise TerminatedError


if __name__ == "__main__":
    os._exit(main())  # at once: libraries' threads may be at work when a run begins
