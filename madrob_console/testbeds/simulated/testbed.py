"""The simulated testbed: door, sensors, a robot, and how they follow the referee.

It knows no messages and no clock, so that the console's simulated source and a ROS 2 node can
both drive it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from random import Random

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from madrob_console.testbeds.simulated.motion import MotionPlan
from madrob_console.testbeds.simulated.scenarios import plan_run
from madrob_console.testbeds.simulated.sensor_model import (
    Reading,
    Scene,
    SensorModel,
    SensorSettings,
)
from scoring.protocol import Condition, ScoringError, Signal

_NOBODY = Scene()
_SLOWEST_PANEL = 0.5
"""rad/s at which the panel must be able to turn unseen by unmasked sensors."""


class SimulatedTestbed:
    """A testbed in which a robot plays one scenario over and over.

    The n-th run of a `seed` is always the same. Where the panel would pass under sensors that the
    protocol does not mask, it raises MadrobError. `plan` plans a run as `plan_run` does.

    Attributes:
        condition: of later runs; None = each run draws one.
        start_distance: of the robot from the threshold, m; None = the usual one.
    """

    def __init__(
        self,
        scenario: StrEnum = Scenario.NOMINAL,
        seed: int = 0,
        geometry: DoorGeometry | None = None,
        sensors: SensorSettings | None = None,
        plan: Callable[..., MotionPlan] = plan_run,
    ) -> None:
        self.scenario = scenario
        self._plan_run = plan
        self.seed = seed
        self.geometry = geometry or DoorGeometry()
        self.sensors = sensors or SensorSettings()
        self.start_distance: float | None = None
        self.loss = 0.0  # the share of messages that never arrive
        if scenario is Scenario.WORN:
            worn = replace(self.sensors, handle_rest=(5.9, 0.4), door_rest=(-0.004, -0.0005))
            self.sensors = worn  # as on 2020-01-31
            self.loss = 0.002
        if self.geometry.fastest_panel < _SLOWEST_PANEL:
            raise MadrobError(
                "the simulated panel passes under sensors outside of their masks: "
                "correct the simulated door's measures or the masks"
            )
        self.condition: Condition | None = None
        self._model = SensorModel(self.geometry, self.sensors, seed)
        self._repetition = 0
        self.start_ns = 0
        self.plan: MotionPlan | None = None

    @property
    def signals(self) -> tuple[Signal, ...]:
        latch = (Signal.LATCH,) if self.sensors.latch else ()
        return (*(signal for signal in Signal if not signal.optional), *latch)

    def start(self, start_ns: int) -> None:
        """Starts a run at an instant, ns since the epoch; another instant moves it."""
        if self.plan is None:
            self.plan = self._plan_run(
                self.scenario,
                self.condition,
                self.geometry,
                Random(f"{self.seed}/{self._repetition}"),
                self.start_distance,
                latch=self.sensors.latch,
            )
        self.start_ns = start_ns

    def reset(self) -> None:
        """Shuts the door and sends the robot back to its start pose, for the next repetition."""
        if self.plan is not None:
            self._repetition += 1
        self.plan = None

    def scene(self, time_ns: int) -> Scene:
        plan = self.plan
        if plan is None:
            return _NOBODY
        return Scene.of(plan, (time_ns - self.start_ns) / NS)

    def read(self, signal: Signal, time_ns: int) -> Reading:
        return self._model.read(signal, self.scene(time_ns))


class RefereeState(msgspec.Struct, frozen=True):
    """The run state that the referee's console publishes.

    `start_time` is planned or actual, s since the epoch; None before the countdown.
    """

    phase: str
    condition_number: int | None = None
    start_time: float | None = None

    @property
    def condition(self) -> Condition | None:
        number = self.condition_number
        return None if number is None else Condition.from_number(number)

    @property
    def held(self) -> bool:
        """Whether a false start holds the countdown."""
        return self.phase == "countdown" and self.start_time is None


_states = msgspec.json.Decoder(RefereeState)


def parse_state(text: str) -> RefereeState:
    """Parses a message of `/madrob/referee/state`; MadrobError without a `phase`."""
    try:
        state = _states.decode(text)
        _ = state.condition
    except (msgspec.MsgspecError, RecursionError, UnicodeEncodeError, ScoringError):
        shown = text if len(text) < 60 else f"{text[:60]}..."
        raise MadrobError(f"{REFEREE_STATE_TOPIC}: not understood: {shown!r}") from None
    return state
