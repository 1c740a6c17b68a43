"""A child process that answers one question after the other.

One that dies or hangs is replaced.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from madrob_console.common.errors import MadrobError

PAUSES = (0.0, 1.0, 5.0, 30.0)
"""Pauses before the tries to get an answer, s."""

Answer = Callable[[Any], Any]


class Worker:
    """A process that answers questions, a function of one module.

    Args:
        answer: makes the answer, in the process.
        prepare: loads what takes long, in the process, before the first question.
        patience: how long it may take, s; then the process is killed and asked anew.
    """

    def __init__(
        self, answer: Answer, prepare: Callable[[], object], patience: float = 60.0
    ) -> None:
        self._answer = answer
        self._prepare = prepare
        self._patience = patience
        self._thread = ThreadPoolExecutor(1, "worker")
        self._process: SpawnProcess | None = None
        self._pipe: Connection | None = None
        self.problem = ""

    def warm(self) -> None:
        """Start the process, so that the first answer does not wait for it."""
        self._thread.submit(self._running)

    async def ask(self, question: object) -> Any:  # noqa: ANN401  whatever `answer` returns
        """Return the answer to a question.

        MadrobError where none can be had.
        """
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._thread, self._ask, question)

    def _ask(self, question: object) -> object:
        for pause in PAUSES:
            time.sleep(pause)
            try:
                pipe = self._running()
                pipe.send(question)
                if pipe.poll(self._patience):
                    reply = pipe.recv()
                    break
                self.problem = f"it gave no answer for {self._patience:g} s"
            except (EOFError, OSError) as error:
                self.problem = f"its process has ended ({type(error).__name__})"
            self._kill()
        else:
            raise MadrobError(self.problem)
        self.problem = ""
        if isinstance(reply, Exception):
            raise MadrobError(str(reply)) from reply
        return reply

    def _running(self) -> Connection:
        if self._process is not None and self._pipe is not None and self._process.is_alive():
            return self._pipe
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._answer, self._prepare), daemon=True
        )
        self._process.start()
        theirs.close()
        return self._pipe

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()

    def close(self) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)
        self._kill()


def _serve(pipe: Connection, answer: Answer, prepare: Callable[[], object]) -> None:
    """Answer until the engine closes its end."""
    os.nice(5)
    prepare()
    while True:
        try:
            question = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(answer(question))
        except Exception as error:  # noqa: BLE001  the engine shows it
            pipe.send(error)
