"""The engine behind the screens, and what the console proposes at first."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.common.errors import MadrobError
from madrob_console.config.tables import DEFAULT_START_POSES, RunDefaults, StartPoseSetting
from madrob_console.engine.ipc.engine_interface import ON_ITS_WAY, given_up
from madrob_console.engine.requests import Perform, Request, T, TakeOver
from scoring.protocol import BenchmarkType, Condition, Side

if TYPE_CHECKING:
    from madrob_console.engine.ipc.engine_interface import EngineClient
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.referee.acts import Act

NOT_YET = "this screen is not attached to the engine yet"

LOOKING_PERIOD = 2.0
"""Between two searches for the next engine, s."""

LATELY = 1.0
"""What an act brings about may be seen so long after its answer, s."""


OpenClient = Callable[[bool], "EngineClient"]
"""Connects to the engine; `True`: starts it where none runs and this screen may."""

OpenReplay = Callable[[Path, float | None], "EngineClient"]
"""Connects to the replay of a run's folder, at an instant of it, s from its start."""


class EngineLink:
    """An engine client that keeps the last snapshot; `connect` calls `open_client`."""

    def __init__(self, open_client: OpenClient, monotonic: Callable[[], float]) -> None:
        self._open_client = open_client
        self._connecting = threading.Lock()
        self._monotonic = monotonic
        self._client: EngineClient | None = None
        self._live: EngineClient | None = None
        """The testbed's engine, while a replay is shown in its place."""
        self._latest: Snapshot | None = None
        self._moved = 0.0
        self._last_asked: dict[str, float] = {}
        self._looked = -math.inf
        self._looking = False

    def connect(self, *, may_start: bool = True) -> None:
        """Connects to the engine, in place of the one before; call in a thread: may take seconds.

        Raises:
            MadrobError: there is no engine to be had, or it gives no snapshot at all.
        """
        with self._connecting:  # by a key while the next engine is looked for
            before, client = self._live or self._client, self._open_client(may_start)
            self.leave_replay()
            self._latest = client.snapshot()
            self._moved = self._monotonic()
            self._client = client
            if before is not None:
                before.close()

    def show_replay(self, replay: EngineClient) -> None:
        """Show a replay; aborts still go to the testbed's engine.

        Raises:
            MadrobError: the replay gives no snapshot.
        """
        self._latest = replay.snapshot()
        self._live, self._client = self._client, replay
        self._moved = self._monotonic()

    def leave_replay(self) -> bool:
        """Show the testbed's engine again; returns whether a replay was shown."""
        if self._live is None or self._client is None:
            return False
        self._client.close()
        self._client, self._live = self._live, None
        with suppress(MadrobError):  # it has ended: its last snapshot says so
            self._latest = self._client.snapshot()
        self._moved = self._monotonic()
        return True

    def live_snapshot(self) -> Snapshot | None:
        """The latest snapshot of the testbed's engine, also while a replay is shown."""
        if self._live is None:
            return self.snapshot()
        try:
            return self._live.snapshot()
        except MadrobError:
            return None

    async def refusal_of(self, act: Act) -> str | None:
        """Hands in an act; why it did not take effect."""
        try:
            return await self.answer(Perform.of(act))
        except MadrobError as error:
            return str(error)

    def look_for_engine(self, aside: Callable[[Callable[[], None]], object]) -> None:
        """Finds the next engine, and starts none; never waits.

        Searches `aside`, unless a search goes on or ended a moment ago.
        """
        if self._looking or self._monotonic() - self._looked < LOOKING_PERIOD:
            return
        self._looking, self._looked = True, self._monotonic()

        def look() -> None:
            try:
                with suppress(MadrobError):  # there is none yet
                    self.connect(may_start=False)
            finally:
                self._looking = False

        aside(look)

    @property
    def connected(self) -> bool:
        return self._client is not None

    def snapshot(self) -> Snapshot | None:
        """The latest snapshot, also of an engine that is gone or silent; None before the first."""
        if self._client is None or self._latest is None:
            return None
        from madrob_console.engine.snapshot import Pulse

        try:
            latest = self._client.snapshot()
        except MadrobError as error:
            return replace(self._latest, pulse=Pulse(gone=str(error)))
        if latest is not self._latest:
            self._latest, self._moved = latest, self._monotonic()
        silence = int(self._monotonic() - self._moved)
        return replace(latest, pulse=Pulse(server=silence)) if silence else latest

    async def answer(self, request: Request[T]) -> T:
        """Asks the engine without blocking the screens; cancelling gives the request up.

        Raises:
            UnsureError: no answer came, though it may have begun.
            MadrobError: it failed, or there is no engine that answers.
        """
        if self._client is None:
            raise MadrobError(NOT_YET)
        name = str(getattr(request, "name", ""))
        self._last_asked[name] = math.inf
        try:
            client = self._client
            if self._live is not None and isinstance(request, Perform | TakeOver):
                client = self._live  # a replay has no acts: an abort means the testbed's run
            answer = client.begin_request(request)
            if not answer.done():
                patience = request.timeout + ON_ITS_WAY
                try:
                    return await asyncio.wait_for(asyncio.wrap_future(answer), patience)
                except TimeoutError:
                    return given_up(answer)
            return answer.result()
        finally:
            self._last_asked[name] = self._monotonic()

    @property
    def asking(self) -> bool:
        return math.inf in self._last_asked.values()

    def asked_lately(self, *names: str) -> bool:
        """Whether this screen makes, or made a moment ago, one of these acts or commands."""
        now = self._monotonic()
        return any(now - self._last_asked.get(name, -math.inf) < LATELY for name in names)

    def close(self) -> None:
        for client in (self._client, self._live):
            if client is not None:
                client.close()


FIRST_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)
"""Condition 1: what the first run's set-up proposes, for subject 1."""


@dataclass(frozen=True, slots=True)
class ConsoleDefaults:
    """The first run's proposal; later runs start from the one before.

    `best_runs` of a team count in the standings, 0 = all; `hint` is the first message.
    """

    results: Path = Path()
    host: str = ""
    best_runs: int = 0
    hint: str = "F1 lists the keys."
    team: str = ""
    referee: str = ""
    poses: tuple[StartPoseSetting, ...] = DEFAULT_START_POSES
    run: RunDefaults = field(default_factory=RunDefaults)
