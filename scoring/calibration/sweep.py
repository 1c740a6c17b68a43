"""A recording in which the door is swept: what each passage sensor read at which door angle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.protocol import PASSAGE_SENSORS, PassageSensor, Signal, Strip
from scoring.quality import is_reading
from scoring.samples import DoorSample, PassageSample, Sample
from scoring.stamps import StampGuard

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """What one passage sensor read.

    Attributes:
        angle: of the panel at each reading, rad, positive = on the sensor's side.
        distance: m down from the lintel; +inf = nothing there, -inf = something too close.
        lost: samples without a reading.
    """

    angle: Numbers
    distance: Numbers
    lost: int


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One or several recordings of a swept door.

    Attributes:
        door: every door angle, rad.
        door_lost: samples of the door without an angle.
        sensors: the ten used ones.
    """

    door: Numbers
    door_lost: int
    sensors: Mapping[PassageSensor, Swept]

    @classmethod
    def together(cls, sweeps: Iterable[Sweep]) -> Sweep:
        """Several recordings as one."""
        found = tuple(sweeps)
        return cls(
            np.concatenate([sweep.door for sweep in found]),
            sum(sweep.door_lost for sweep in found),
            {
                sensor: Swept(
                    np.concatenate([sweep.sensors[sensor].angle for sweep in found]),
                    np.concatenate([sweep.sensors[sensor].distance for sweep in found]),
                    sum(sweep.sensors[sensor].lost for sweep in found),
                )
                for sensor in PASSAGE_SENSORS
            },
        )


class SweepLog:
    """Collects the samples of one recording, in the order of the bag; stamps must increase.

    Args:
        largest_gap: between door angles, s; a reading within a longer gap is not used.
    """

    def __init__(self, largest_gap: float) -> None:
        self._largest_gap = largest_gap
        self._guards = {signal: StampGuard() for signal in Signal}
        self._door: list[tuple[float, float]] = []
        self._door_lost = 0
        self._strips: dict[Strip, list[tuple[float, tuple[float, ...]]]] = {s: [] for s in Strip}

    def feed(self, sample: Sample) -> None:
        """Take the next sample; handle and latch do not matter."""
        admitted = self._guards[sample.signal].admit(sample)
        match admitted:
            case DoorSample():
                if math.isfinite(admitted.angle):
                    self._door.append((admitted.time, admitted.angle))
                else:
                    self._door_lost += 1
            case PassageSample():
                row = tuple(
                    admitted.ranges[i] if is_reading(admitted, i) else math.nan for i in range(4)
                )
                self._strips[admitted.strip].append((admitted.time, row))

    def sweep(self) -> Sweep:
        """What was collected."""
        door = np.array(self._door, dtype=np.float64).reshape(-1, 2)
        sensors = {sensor: self._swept(sensor, door) for sensor in PASSAGE_SENSORS}
        return Sweep(door[:, 1], self._door_lost, sensors)

    def _swept(self, sensor: PassageSensor, door: Numbers) -> Swept:
        rows = self._strips[sensor.strip]
        time = np.array([time for time, _ in rows], dtype=np.float64)
        distance = np.array([row[sensor.element] for _, row in rows], dtype=np.float64)
        read = ~np.isnan(distance)
        angle = sensor.side.sign * _angle_at(time, door, self._largest_gap)
        used = read & ~np.isnan(angle)
        return Swept(angle[used], distance[used], int(np.count_nonzero(~read)))


def _angle_at(time: Numbers, door: Numbers, largest_gap: float) -> Numbers:
    """The door angle at each time, rad; NaN before, after and in gaps."""
    if len(door) < 2:
        return np.full(len(time), np.nan)
    stamps, angles = door[:, 0], door[:, 1]
    after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    outside = (time < stamps[0]) | (time > stamps[-1])
    gap = stamps[after] - stamps[after - 1] > largest_gap
    return np.where(outside | gap, np.nan, np.interp(time, stamps, angles))
