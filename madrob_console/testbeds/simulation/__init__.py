"""The simulated testbed: a model, not random numbers.

`SimulatedTestbed` is the door to it; `Truth` is what a run's events and steps truly are. Bodies
do not collide: where a robot's way and the panel's swing meet, neither gives way.
"""

from madrob_console.testbeds.simulation.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulation.plan import MotionPlan, Scenario
from madrob_console.testbeds.simulation.scenarios import RobotSettings, plan_run
from madrob_console.testbeds.simulation.sensors import SensorSettings
from madrob_console.testbeds.simulation.testbed import SimulatedTestbed
from madrob_console.testbeds.simulation.truth import Truth, truth_of

__all__ = [
    "DoorGeometry",
    "MotionPlan",
    "RobotBody",
    "RobotSettings",
    "Scenario",
    "SensorSettings",
    "SimulatedTestbed",
    "Truth",
    "plan_run",
    "truth_of",
]
