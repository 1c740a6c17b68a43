"""The engine behind the screens, and what the console proposes at first."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.common.errors import MadrobError
from madrob_console.config.tables import DEFAULT_START_POSES, RunDefaults, StartPoseSetting
from madrob_console.engine.wire import ON_ITS_WAY, given_up
from scoring.protocol import BenchmarkType, Condition, Side

if TYPE_CHECKING:
    from madrob_console.engine.requests import Request, T
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.engine.wire import EngineClient

NOT_YET = "this screen is not attached to the engine yet"

LOOKING_PERIOD = 2.0
"""Between two looks for the next engine, s."""

LATELY = 1.0
"""What an act brings about may be seen so long after its answer, s."""


class EngineLink:
    """An engine client that keeps the last snapshot.

    Args:
        open_client: makes the client; called by `connect`.
        monotonic: a clock for the engine's silence, s.
    """

    def __init__(
        self, open_client: Callable[[], EngineClient], monotonic: Callable[[], float]
    ) -> None:
        self._open_client = open_client
        self._monotonic = monotonic
        self._client: EngineClient | None = None
        self._latest: Snapshot | None = None
        self._moved = 0.0
        self._asked: dict[str, float] = {}

    def connect(self) -> None:
        """Connect to the engine, in place of the one before; may take seconds: in a thread.

        Raises:
            MadrobError: there is no engine to be had, or it gives no snapshot at all.
        """
        before, client = self._client, self._open_client()
        self._latest = client.snapshot()
        self._moved = self._monotonic()
        self._client = client
        if before is not None:
            before.close()

    @property
    def connected(self) -> bool:
        """Whether there is an engine."""
        return self._client is not None

    def snapshot(self) -> Snapshot | None:
        """The latest snapshot, or the last one that the engine gave; None before the first.

        Of an engine that has gone, or is silent, only the screen itself can tell.
        """
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

    def ask(self, request: Request[T]) -> T:
        """Have a request carried out; may take as long as its timeout.

        Raises:
            MadrobError: it failed, or there is no engine that answers.
        """
        if self._client is None:
            raise MadrobError(NOT_YET)
        return self._client.ask(request)

    async def answer(self, request: Request[T]) -> T:
        """The same, while the screens go on; who is cancelled gives the request up.

        Raises:
            UnsureError: no answer came, though it may have begun.
            MadrobError: it failed, or there is no engine that answers.
        """
        if self._client is None:
            raise MadrobError(NOT_YET)
        name = str(getattr(request, "name", ""))
        self._asked[name] = math.inf
        try:
            answer = self._client.begin(request)
            if not answer.done():
                patience = request.timeout + ON_ITS_WAY
                try:
                    return await asyncio.wait_for(asyncio.wrap_future(answer), patience)
                except TimeoutError:
                    raise given_up(answer) from None
            return answer.result()
        finally:
            self._asked[name] = self._monotonic()

    @property
    def asking(self) -> bool:
        """Whether something is asked and not answered yet."""
        return math.inf in self._asked.values()

    def asked_lately(self, *names: str) -> bool:
        """Whether this screen asks, or asked a moment ago, for one of these acts or commands."""
        now = self._monotonic()
        return any(now - self._asked.get(name, -math.inf) < LATELY for name in names)

    def close(self) -> None:
        """Let the engine go."""
        if self._client is not None:
            self._client.close()


class EngineSearch:
    """Finds the next engine after one has ended, for a screen at whose keyboard nobody sits.

    Args:
        link: to the engine.
        monotonic: a clock, s.
        aside: has something done in a thread.
    """

    def __init__(
        self,
        link: EngineLink,
        monotonic: Callable[[], float],
        aside: Callable[[Callable[[], None]], object],
    ) -> None:
        self._link = link
        self._monotonic = monotonic
        self._aside = aside
        self._looked = -math.inf
        self._looking = False

    def look(self) -> None:
        """Look for one, unless that was done a moment ago or goes on; never waits."""
        if self._looking or self._monotonic() - self._looked < LOOKING_PERIOD:
            return
        self._looking, self._looked = True, self._monotonic()
        self._aside(self._connect)

    def _connect(self) -> None:
        try:
            with suppress(MadrobError):  # there is none yet
                self._link.connect()
        finally:
            self._looking = False


# What the console proposes before the referee has typed anything.


FIRST_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)
"""Condition 1: what the first run's set-up proposes, for subject 1."""


@dataclass(frozen=True, slots=True)
class ConsoleDefaults:
    """The first run's proposal; later runs start from the one before.

    Attributes:
        competition: its name, for the top line.
        results: the folder in which the runs are stored.
        host: name of the machine, for the top line.
        best_runs: as many of a team's runs count in the standings; 0 = all.
        hint: what the first message says.
        team, referee: who.
        poses: start poses to choose from.
        run: timeout, countdown, ruleset and what decides step 6.
    """

    competition: str = ""
    results: Path = Path()
    host: str = ""
    best_runs: int = 0
    hint: str = "F1 lists the keys."
    team: str = ""
    referee: str = ""
    poses: tuple[StartPoseSetting, ...] = DEFAULT_START_POSES
    run: RunDefaults = field(default_factory=RunDefaults)
