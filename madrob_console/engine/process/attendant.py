"""Answers other programs of a testbed, which are no screens: what they call, what they hear."""

from __future__ import annotations

import time
from concurrent.futures import CancelledError, Future
from typing import TYPE_CHECKING

from madrob_console.engine.shown.client import given_up
from madrob_console.engine.shown.diagnoses import diagnoses, failure
from madrob_console.engine.shown.requests import NO_ANSWER, Perform
from madrob_console.errors import MadrobError
from madrob_console.kinds import RemoteService
from madrob_console.referee.acts import Abort, Act, DeclareTimeout, Start
from madrob_console.referee.journal import Origin
from madrob_console.testbeds.outside import CallAnswer, Diagnosis, LookForAnswer

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from madrob_console.engine.process.local import LocalEngine

_WHY = "called over ROS"

_ACTS: dict[RemoteService, Act] = {
    RemoteService.START: Start(),
    RemoteService.ABORT: Abort(_WHY),
    RemoteService.DECLARE_TIMEOUT: DeclareTimeout(_WHY),
}
"""What is called is an act like any other: same checks, same refusals, same lane."""


class Attendant:
    """Has calls carried out as acts of the origin `remote`. From any thread; nothing waits.

    Args:
        engine: of the testbed.
        services: what may be called.
        rate: what its topics should have, Hz.
    """

    def __init__(
        self, engine: LocalEngine, services: Collection[RemoteService], rate: float
    ) -> None:
        self.services = services
        self._engine = engine
        self._rate = rate

    def call(self, service: RemoteService) -> LookForAnswer:
        """Have an act done; it is answered in time, whatever core and disk do."""
        act = _ACTS[service]
        request = Perform.of(act)
        answer = self._engine.begin(request, origin=Origin.REMOTE)
        ends = time.monotonic() + request.timeout

        def look() -> CallAnswer | None:
            if answer.done():
                return _answered(act, answer)
            if time.monotonic() < ends:
                return None
            return CallAnswer(success=False, message=f"{act.name}: {given_up(answer)}")

        return look

    def diagnose(self) -> Sequence[Diagnosis]:
        """How everything is now, as the screens say it."""
        try:
            return diagnoses(self._engine.snapshot(), self._rate)
        except MadrobError as error:
            return (failure(str(error)),)


def _answered(act: Act, answer: Future[str | None]) -> CallAnswer:
    """What became of an act, as a referee reads it."""
    try:
        refused = answer.result(0)
    except CancelledError:
        refused = NO_ANSWER
    except MadrobError as error:
        refused = str(error)
    if refused is None:
        return CallAnswer(success=True, message=f"Done: {act.done}")
    return CallAnswer(success=False, message=f"Refused: {act.name}: {refused}")
