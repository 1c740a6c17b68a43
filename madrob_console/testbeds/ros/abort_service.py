"""The abort that other programs of a ROS domain may call.

A thread of its own serves them: neither what they send nor who does not listen holds up what comes
from the testbed, or the engine.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections import deque
from contextlib import suppress

from madrob_console.common.errors import MadrobError
from madrob_console.testbeds.ros.connection import RosObject, load_module
from madrob_console.testbeds.ros.subscriptions import qos_profile
from madrob_console.testbeds.source import BeginAbort, CallAnswer, LookForAnswer
from recorder.bag import Qos

SERVICE_PACKAGE = "std_srvs"
"""The package with the type of the service."""

SERVICE_REMEDY = (
    f"setting `ros.abort`: {SERVICE_PACKAGE} is not installed: install madrob-console[ros], "
    "or the package ros-jazzy-std-srvs, or leave the setting out"
)

_PERIOD = 0.02
"""Seconds between two checks for calls."""

DEPTH = 100
"""Length of the call queue in DDS, and the most refusals that wait to be sent."""

_REPLYING = 0.02
"""Seconds of one check after which further replies wait for the next; one may take 0.1 s."""

_ENDED = "the engine has ended: what is shown when it is back tells whether it was done"


class AbortService:
    """The service `~/abort` of the type `std_srvs/srv/Trigger`.

    Calls that wait together share one abort. Those that come while it is under way share the next.
    Nobody spins `node`. MadrobError without the type.
    """

    def __init__(self, node: RosObject, begin_abort: BeginAbort) -> None:
        # who calls and goes before its answer is no news
        warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
        try:
            trigger = load_module(f"{SERVICE_PACKAGE}.srv").Trigger
        except ImportError:
            raise MadrobError(SERVICE_REMEDY) from None
        self._begin_abort = begin_abort
        self._request, self._response = trigger.Request, trigger.Response
        self._service = node.create_service(
            trigger, "~/abort", _never_spun, qos_profile=qos_profile(Qos(), DEPTH)
        )
        self._callers: list[RosObject] = []
        self._under_way: LookForAnswer | None = None
        self._replies: deque[tuple[RosObject, CallAnswer]] = deque()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros abort", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(_PERIOD):
            with suppress(RuntimeError):  # a middleware that fails: the source says so
                self._take_calls()
                self._send_replies()
        with suppress(RuntimeError):
            if self._under_way is not None:
                self._answer(self._under_way() or CallAnswer(success=False, message=_ENDED))
            self._send_replies()

    def _take_calls(self) -> None:
        if self._under_way is None:
            while len(self._callers) < DEPTH and (caller := self._next_caller()) is not None:
                self._callers.append(caller)
            if self._callers:
                self._under_way = self._begin_abort()
        if self._under_way is not None and (answer := self._under_way()) is not None:
            self._answer(answer)

    def _next_caller(self) -> RosObject | None:
        with self._service.handle:
            return self._service.handle.service_take_request(self._request)[1]

    def _answer(self, answer: CallAnswer) -> None:
        """Queue the answers: successes first, and refusals only as long as there is room."""
        owed = [(caller, answer) for caller in self._callers]
        self._callers, self._under_way = [], None
        if answer.success:
            self._replies.extendleft(owed)
        else:
            self._replies.extend(owed[: max(0, DEPTH - len(self._replies))])

    def _send_replies(self) -> None:
        """A caller that has gone gets none."""
        ends = time.monotonic() + _REPLYING
        while self._replies and time.monotonic() < ends:
            caller, answer = self._replies.popleft()
            reply = self._response(success=answer.success, message=answer.message)
            with suppress(RuntimeError):
                self._service.send_response(reply, caller)


def _never_spun(_request: RosObject, response: RosObject) -> RosObject:
    """The callback of an executor; `AbortService` takes the calls itself."""
    return response
