"""Who connects is attended, as far as there are file handles for it.

asyncio's own server answers a want of file handles by hundreds of thousands of lines in the log and
a processor that is never idle, and it leaves none for a recording.
"""

from __future__ import annotations

import asyncio
import resource
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress

from madrob_console.engine.process.troubles import Troubles

WANTED_HANDLES = 4096
"""File handles that an engine asks for, if it may; 1024 are usual, most of a testbed needs 200."""

MOST_SCREENS = 500
"""So many screens are attached at most, and half as many as there are file handles."""

SPARE = 32
"""So many more may be on their way in, or belong to a referee."""

_PAUSE = 0.2
"""Whoever connects waits so long for another try, s."""

_PARTING = 0.5
"""A screen that is let go has so long to read the last word, s."""

Attend = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


def raise_handles() -> None:
    """Have as many file handles as an engine may want, as far as the user may."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = WANTED_HANDLES if hard == resource.RLIM_INFINITY else min(hard, WANTED_HANDLES)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))


def most_screens() -> int:
    """How many screens may be attached, so that the engine has handles left for its own files."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_SCREENS if soft == resource.RLIM_INFINITY else min(soft // 2, MOST_SCREENS)


class Acceptor:
    """Accepts connections until it is closed. What comes when there is no room waits.

    Args:
        listening: the socket; closed at the end.
        attend: what attends to a connection, in a task of its own.
        most: connections at a time.
        troubles: is told what goes wrong with one.
    """

    def __init__(
        self, listening: socket.socket, attend: Attend, most: int, troubles: Troubles
    ) -> None:
        listening.setblocking(False)
        self._listening = listening
        self._attend = attend
        self._most = most
        self._troubles = troubles
        self._attending: set[asyncio.Task[None]] = set()
        self._task = asyncio.create_task(self._accept())

    async def _accept(self) -> None:
        try:
            while True:
                if len(self._attending) >= self._most:
                    await asyncio.wait(self._attending, return_when=asyncio.FIRST_COMPLETED)
                try:
                    await self._accept_one()
                except OSError as error:
                    self._troubles.tell("new screens must wait", error)
                    await asyncio.sleep(_PAUSE)
        finally:
            self._listening.close()

    async def _accept_one(self) -> None:
        loop = asyncio.get_running_loop()
        connection, _ = await loop.sock_accept(self._listening)
        reader = asyncio.StreamReader(loop=loop)
        protocol = asyncio.StreamReaderProtocol(reader, loop=loop)
        try:
            transport, _ = await loop.connect_accepted_socket(lambda: protocol, connection)
        except BaseException:
            connection.close()
            raise
        writer = asyncio.StreamWriter(transport, protocol, reader, loop)
        task = asyncio.create_task(self._attended(reader, writer))
        self._attending.add(task)
        task.add_done_callback(self._attending.discard)

    async def _attended(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._attend(reader, writer)
        except Exception as error:  # noqa: BLE001 - one screen's trouble is no other's
            self._troubles.tell("a screen was let go", error)
        finally:
            writer.close()
            with suppress(OSError, TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), _PARTING)
            writer.transport.abort()

    def close(self) -> None:
        """Accept no more; who is attended to stays."""
        self._task.cancel()

    async def wait(self, patience: float) -> None:
        """After `close`: wait at most so long until nobody is attended to any more, s."""
        await asyncio.wait({self._task, *self._attending}, timeout=patience)
