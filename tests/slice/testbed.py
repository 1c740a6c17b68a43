"""`python -m tests.slice.testbed RATE`: a simulated testbed over DDS, so many Hz a topic."""

from __future__ import annotations

import sys

from madrob_console.testbeds.simulated import Scenario, SensorSettings, SimulatedTestbed
from madrob_console.testbeds.simulated_node import serve_testbed

if __name__ == "__main__":
    rate = float(sys.argv[1])
    scenario = Scenario(sys.argv[2]) if sys.argv[2:] else Scenario.NOMINAL
    testbed = SimulatedTestbed(scenario, sensors=SensorSettings(rate=rate))
    serve_testbed(testbed, None, 0, say=print)
