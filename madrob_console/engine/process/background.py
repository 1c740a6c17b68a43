"""Work that may wait: in processes of low priority, beside the engine."""

from __future__ import annotations

import pickle
import subprocess
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import IO

PERIOD = 0.1
"""A process gives way to a run within this time, s."""

_PATIENCE = 2.0  # with a process that was told to end, s


@dataclass(frozen=True, slots=True)
class Finished:
    """What became of a chore.

    Attributes:
        code: the exit code of its process; None where none could be started.
        said: the last line that it printed.
        complained: the last line that it printed as an error.
    """

    code: int | None
    said: str
    complained: str


@dataclass(frozen=True, slots=True)
class _Chore:
    name: str
    arguments: tuple[str, ...]
    done: Callable[[Finished], None]
    given: object


class Background:
    """Does one chore after the other, none while a run goes on.

    A chore that a run cuts short is done again after the run. What has the same name as a chore
    that has not begun takes its place. Nobody waits: everything happens in a thread of its own,
    which sleeps while there is nothing to do.

    Args:
        command: the program that does the chores; their arguments come behind it.
        busy: whether a run goes on; may be asked from any thread.
    """

    def __init__(self, command: Sequence[str], busy: Callable[[], bool]) -> None:
        self._command = tuple(command)
        self._busy = busy
        self._changed = threading.Condition()
        self._waiting: dict[str, _Chore] = {}
        self._working = False
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="background", daemon=True)
        self._thread.start()

    def ask(
        self,
        name: str,
        arguments: Sequence[str],
        done: Callable[[Finished], None],
        given: object = None,
    ) -> None:
        """Ask for a chore.

        Args:
            name: what it is about.
            arguments: of the command.
            done: called with its outcome, in the thread of the chores.
            given: comes to the process pickled, on its standard input; None = nothing.
        """
        with self._changed:
            self._waiting[name] = _Chore(name, tuple(arguments), done, given)
            self._changed.notify_all()

    def wait(self, patience: float) -> bool:
        """Wait at most `patience` s; returns whether everything is done."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and not self._working, patience)

    def close(self, patience: float) -> None:
        """Take no account of runs any more, and wait at most `patience` s for what is asked for.

        What is not ready by then gets ready by itself.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(patience)
        with self._changed:
            left = tuple(self._waiting.values())
            self._waiting.clear()
        for chore in left:
            with suppress(OSError):  # this program is at its end: nobody is there to be told
                self._start(chore, subprocess.DEVNULL, subprocess.DEVNULL)

    # ------------------------------------------------------------------ the thread

    def _work(self) -> None:
        while (chore := self._next()) is not None:
            finished = self._do(chore)
            if finished is not None:
                chore.done(finished)
            with self._changed:
                if finished is None:
                    self._waiting.setdefault(chore.name, chore)
                self._working = False
                self._changed.notify_all()

    def _next(self) -> _Chore | None:
        """Wait for something to do and for the end of a run; None when there is no more."""
        with self._changed:
            while True:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return None
                if not self._must_wait():
                    self._working = True
                    return self._waiting.pop(next(iter(self._waiting)))
                self._changed.wait(PERIOD)

    def _must_wait(self) -> bool:
        return self._busy() and not self._closing

    def _do(self, chore: _Chore) -> Finished | None:
        """Do a chore; None when a run came in between."""
        with TemporaryFile() as out, TemporaryFile() as err:
            try:
                process = self._start(chore, out, err)
            except OSError as error:
                return Finished(None, "", f"no process could be started ({error.strerror})")
            while True:
                try:
                    code = process.wait(PERIOD)
                except subprocess.TimeoutExpired:
                    if self._must_wait():
                        _end(process)
                        return None
                    continue
                return Finished(code, _last_line(out), _last_line(err))

    def _start(
        self, chore: _Chore, out: IO[bytes] | int, err: IO[bytes] | int
    ) -> subprocess.Popen[bytes]:
        with TemporaryFile() as given:
            if chore.given is not None:
                pickle.dump(chore.given, given)
                given.seek(0)
            return subprocess.Popen(
                [*self._command, *chore.arguments],
                stdin=given,
                stdout=out,
                stderr=err,
                start_new_session=True,  # no hang-up and no Ctrl+C of a terminal reaches it
            )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _last_line(file: IO[bytes]) -> str:
    file.seek(0)
    lines = file.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""
