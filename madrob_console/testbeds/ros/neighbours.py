"""What other programs of a ROS domain may call, and what they hear of how the console is.

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
from madrob_console.common.names import RemoteService
from madrob_console.testbeds.ros.connection import RosObject, load_message_class, load_module
from madrob_console.testbeds.ros.intake import qos_profile
from madrob_console.testbeds.source import CallAnswer, Diagnosis, LookForAnswer, Outside
from recorder.bag import Qos

DIAGNOSTICS_TOPIC = "/diagnostics"

NEEDED_BY_SERVICES = "std_srvs"
"""The package with the type of the services."""

SERVICES_REMEDY = (
    f"setting `ros.services`: {NEEDED_BY_SERVICES} is not installed: install madrob-console[ros], "
    "or the package ros-jazzy-std-srvs, or allow no service"
)

MOST_UNDER_WAY = 4

TOO_MANY = "Refused: too many calls at once: wait for an answer, then call again"

_PERIOD = 0.02
"""Seconds between two checks for calls."""

_DIAGNOSIS = 1.0
"""Seconds between two diagnostic messages."""

DEPTH = 100
"""Length of a service's call queue in DDS, and of each of its queues of replies."""

_REPLYING = 0.02
"""Seconds of one check after which further replies wait for the next; one may take 0.1 s."""

_ENDED = "the engine has ended: what is shown when it is back tells whether it was done"
_URGENT_FIRST = (RemoteService.ABORT, RemoteService.DECLARE_TIMEOUT, RemoteService.START)


class Replies:
    """A service's queue of replies; answers go before refusals.

    No answer to a call that was carried out is lost. Of too many refusals the oldest are dropped.
    """

    def __init__(self) -> None:
        self._answers: deque[tuple[RosObject, CallAnswer]] = deque()
        self._refusals: deque[RosObject] = deque(maxlen=DEPTH)

    @property
    def answers(self) -> int:
        return len(self._answers)

    def answer(self, caller: RosObject, answer: CallAnswer) -> None:
        self._answers.append((caller, answer))

    def refuse(self, caller: RosObject) -> None:
        self._refusals.append(caller)

    def take_reply(self) -> tuple[RosObject, CallAnswer] | None:
        if self._answers:
            return self._answers.popleft()
        if self._refusals:
            return self._refusals.popleft(), CallAnswer(success=False, message=TOO_MANY)
        return None


class _Served:
    """One service; it refuses calls while `MOST_UNDER_WAY` run."""

    def __init__(self, node: RosObject, which: RemoteService) -> None:
        trigger = load_module(f"{NEEDED_BY_SERVICES}.srv").Trigger
        self._which = which
        self._request, self._response = trigger.Request, trigger.Response
        self._service = node.create_service(
            trigger, f"~/{which}", _never_spun, qos_profile=qos_profile(Qos(), DEPTH)
        )
        self._under_way: list[tuple[RosObject, LookForAnswer]] = []
        self._replies = Replies()

    def take(self, outside: Outside) -> None:
        for _ in range(DEPTH):
            with self._service.handle:
                _, caller = self._service.handle.service_take_request(self._request)
            if caller is None:
                break
            under_way = len(self._under_way)
            if under_way < MOST_UNDER_WAY and under_way + self._replies.answers < DEPTH:
                self._under_way.append((caller, outside.call(self._which)))
            else:
                self._replies.refuse(caller)
        waiting, self._under_way = self._under_way, []
        for caller, look in waiting:
            if (answer := look()) is None:
                self._under_way.append((caller, look))
            else:
                self._replies.answer(caller, answer)

    def reply(self, until: float) -> None:
        """Sends replies until `until`, monotonic s; a caller that has gone gets none."""
        while time.monotonic() < until and (owed := self._replies.take_reply()) is not None:
            caller, answer = owed
            reply = self._response(success=answer.success, message=answer.message)
            with suppress(RuntimeError):
                self._service.send_response(reply, caller)

    def end(self) -> None:
        for caller, look in self._under_way:
            answer = look() or CallAnswer(success=False, message=_ENDED)
            self._replies.answer(caller, answer)
        self.reply(time.monotonic() + _REPLYING)


class Neighbours:
    """Serves the calls of other programs, and publishes `/diagnostics` once a second.

    Nothing waits for an answer. Without the messages of `/diagnostics` nothing is published. Nobody
    spins `node`; the services are `~/<name>`. Without their type it raises MadrobError.
    """

    def __init__(self, node: RosObject, outside: Outside) -> None:
        self._outside = outside
        # who calls and goes before its answer is no news
        warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
        try:
            self._served = tuple(_Served(node, s) for s in _URGENT_FIRST if s in outside.services)
        except ImportError:
            raise MadrobError(SERVICES_REMEDY) from None
        self._clock = node.get_clock()
        self._array: RosObject = None
        self._publisher: RosObject = None
        with suppress(MadrobError):  # `madrob doctor` says it
            self._array = load_message_class("diagnostic_msgs/msg/DiagnosticArray")
            self._status = load_message_class("diagnostic_msgs/msg/DiagnosticStatus")
            self._value = load_message_class("diagnostic_msgs/msg/KeyValue")
            self._publisher = node.create_publisher(
                self._array, DIAGNOSTICS_TOPIC, qos_profile(Qos(), 1)
            )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros neighbours", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        due = 0.0
        while not self._stop.wait(_PERIOD if self._served else _DIAGNOSIS / 4):
            with suppress(RuntimeError):  # a middleware that fails: the source says so
                for served in self._served:
                    served.take(self._outside)
                for served in self._served:
                    served.reply(time.monotonic() + _REPLYING)
            if self._publisher is not None and time.monotonic() >= due:
                due = time.monotonic() + _DIAGNOSIS
                with suppress(RuntimeError):
                    self._publisher.publish(self._message())
        with suppress(RuntimeError):
            for served in self._served:
                served.end()

    def _message(self) -> RosObject:
        array = self._array(status=[self._as_status(d) for d in self._outside.diagnose()])
        array.header.stamp = self._clock.now().to_msg()
        return array

    def _as_status(self, diagnosis: Diagnosis) -> RosObject:
        return self._status(
            level=bytes([diagnosis.level]),
            name=f"madrob: {diagnosis.name}",
            message=diagnosis.message,
            values=[self._value(key=key, value=value) for key, value in diagnosis.values.items()],
        )


def _never_spun(_request: RosObject, response: RosObject) -> RosObject:
    """The callback of an executor; `_Served.take` takes the calls instead."""
    return response
