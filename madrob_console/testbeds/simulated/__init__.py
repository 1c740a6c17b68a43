"""The simulated testbed: a model, not random numbers.

`SimulatedTestbed` is the door to it. Bodies do not collide: where a robot's way and the panel's
swing meet, neither gives way.
"""

from madrob_console.common.names import Scenario
from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulated.motion import MotionPlan
from madrob_console.testbeds.simulated.scenarios import plan_run
from madrob_console.testbeds.simulated.sensor_model import SensorSettings
from madrob_console.testbeds.simulated.testbed import SimulatedTestbed

__all__ = [
    "DoorGeometry",
    "MotionPlan",
    "RobotBody",
    "Scenario",
    "SensorSettings",
    "SimulatedTestbed",
    "plan_run",
]
