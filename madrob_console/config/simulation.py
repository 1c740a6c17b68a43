"""The simulated testbed's tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta
from msgspec.structs import asdict

from madrob_console.config.tables import SettingsTable, within

if TYPE_CHECKING:
    from madrob_console.testbeds.simulated.geometry import DoorGeometry
    from madrob_console.testbeds.simulated.scenarios import RobotSettings
    from madrob_console.testbeds.simulated.sensor_model import SensorSettings
    from scoring.protocol import Thresholds


class SimulatedDoor(SettingsTable, frozen=True):
    """[simulated.door]: doorway, panel and sensor places. Lengths in m.

    The lintel's height is `lintel_height` of [thresholds].
    """

    doorway_width: Annotated[float, within(0.5, 5, "m between the jambs")] = 1.0
    panel_length: Annotated[float, within(0.5, 5, "m")] = 0.98
    panel_thickness: Annotated[float, within(0.005, 0.2, "m")] = 0.04
    panel_height: Annotated[float, within(0.5, 10, "m")] = 1.95
    sensor_distance: Annotated[float, within(0.02, 2, "m from the wall")] = 0.175
    sensor_spacing: Annotated[float, within(0.01, 1, "m between neighbours")] = 0.125
    beam_radius: Annotated[float, within(0, 0.2, "m")] = 0.02
    hinge_left: Annotated[bool, Meta(description="seen by who looks towards CCW")] = True
    encoder_counts: Annotated[int, Meta(ge=36, le=10**7, description="a turn")] = 3600

    def geometry(self, thresholds: Thresholds) -> DoorGeometry:
        """The doorway as the simulation takes it."""
        from madrob_console.testbeds.simulated.geometry import DoorGeometry

        return DoorGeometry(
            **asdict(self), lintel_height=thresholds.lintel_height, thresholds=thresholds
        )


class SimulatedSensors(SettingsTable, frozen=True):
    """[simulated.sensors]: how the sensors behave."""

    rate: Annotated[float, within(1, 1000, "Hz, each topic")] = 50.0
    jitter: Annotated[float, within(0, 0.1, "s, standard deviation of the stamps")] = 0.0008
    handle_offset: Annotated[float, within(-200, 200, "N at rest")] = 5.9
    handle_noise: Annotated[float, within(0, 100, "N, standard deviation")] = 0.05
    range_noise: Annotated[float, within(0, 1, "m, standard deviation")] = 0.003
    latch: Annotated[bool, Meta(description="whether there is a latch sensor")] = False

    def settings(self) -> SensorSettings:
        """The sensors as the simulation takes them."""
        from madrob_console.testbeds.simulated.sensor_model import SensorSettings

        return SensorSettings(**asdict(self))


class SimulatedRobot(SettingsTable, frozen=True):
    """[simulated.robot]: a box that moves along the doorway's axis."""

    length: Annotated[float, within(0.05, 5, "m along the axis")] = 0.5
    width: Annotated[float, within(0.05, 5, "m across it")] = 0.5
    height: Annotated[float, within(0.05, 5, "m")] = 1.2
    shift: Annotated[float, within(-2, 2, "m from the middle, away from the hinge")] = 0.22
    reaction: Annotated[float, within(0, 600, "s from the start until it sets out")] = 0.5
    start_distance: (
        Annotated[float, within(0.1, 20, "m from the threshold; found out when not set")] | None
    ) = None

    def settings(self) -> RobotSettings:
        """The robot as the simulation takes it."""
        from madrob_console.testbeds.simulated.geometry import RobotBody
        from madrob_console.testbeds.simulated.scenarios import RobotSettings

        body = RobotBody(self.length, self.width, self.height, self.shift)
        return RobotSettings(body, self.reaction, self.start_distance)


class Simulated(SettingsTable, frozen=True):
    """[simulated]: the simulated testbed."""

    door: SimulatedDoor = SimulatedDoor()
    sensors: SimulatedSensors = SimulatedSensors()
    robot: SimulatedRobot = SimulatedRobot()
