"""All that a recording's sensors said, for those who compute on it themselves.

The rows are those behind the result before they are cut, by the code that makes the result.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.assessment import Assessment, completed_by_settling
from scoring.kinematics import Array
from scoring.procedure import Ruling
from scoring.protocol import PASSAGE_SENSORS
from scoring.quality import is_reading
from scoring.result import Ending
from scoring.rows import Rows
from scoring.samples import LatchSample, PassageSample, Sample

_PLACES = {sensor: place for place, sensor in enumerate(PASSAGE_SENSORS)}
_UNKNOWN = -1


@dataclass(frozen=True, slots=True, eq=False)
class PassageSeries:
    """What the used passage sensors saw, one row per sensor and sample, as recorded (section 4).

    Attributes:
        time: s since the epoch, increasing for each sensor; all arrays have shape (n,).
        sensor: index in `PASSAGE_SENSORS`.
        distance: down from the lintel, m, inf = nothing there, NaN = no reading.
        present: after this reading: 1 = something is there, 0 = nothing, -1 = not known yet.
        masked: whether the panel passes under it.
    """

    time: Array
    sensor: NDArray[np.int8]
    distance: Array
    present: NDArray[np.int8]
    masked: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class WholeSeries:
    """Everything that was measured; the run's rows lie in [`rows_from`, `rows_until`], s."""

    rows: Rows
    rows_from: float
    rows_until: float
    passage: PassageSeries
    latch_time: Array
    latch_engaged: NDArray[np.bool_]


class SeriesAssessment(Assessment):
    """An assessment that also keeps the data of passage and latch sensors."""

    def _prepare(self) -> None:
        super()._prepare()
        self._time, self._distance = array("d"), array("d")
        self._sensor, self._present, self._masked = array("b"), array("b"), array("b")
        self._latch_time, self._latch_engaged = array("d"), array("b")

        self._scoring.on_passage = self._keep

    def _admit(self, sample: Sample) -> None:
        super()._admit(sample)
        if isinstance(sample, LatchSample):
            self._latch_time.append(sample.time)
            self._latch_engaged.append(sample.engaged)

    def _keep(self, sample: PassageSample, angle: float) -> None:
        for sensor, present in self._scoring.under(sample.strip):
            read = is_reading(sample, sensor.element)
            self._time.append(sample.time)
            self._sensor.append(_PLACES[sensor])
            self._distance.append(sample.ranges[sensor.element] if read else math.nan)
            self._present.append(_UNKNOWN if present is None else present)
            self._masked.append(self._thresholds.masked(sensor.side, sensor.index, angle))

    def series(self, ending: Ending, rulings: tuple[Ruling, ...]) -> WholeSeries:
        """Call it once the recording has been read to its end."""
        self._finish()
        end = self._end(ending)
        if completed_by_settling(ending, self.procedure(rulings, end)):
            end += self._thresholds.settle_time
        whole = not self._ruleset.cut_rows
        return WholeSeries(
            rows=self._rows()[2],
            rows_from=-math.inf if whole else self.start,
            rows_until=math.inf if whole else end,
            passage=PassageSeries(
                np.array(self._time, dtype=np.float64),
                np.array(self._sensor, dtype=np.int8),
                np.array(self._distance, dtype=np.float64),
                np.array(self._present, dtype=np.int8),
                np.array(self._masked, dtype=np.bool_),
            ),
            latch_time=np.array(self._latch_time, dtype=np.float64),
            latch_engaged=np.array(self._latch_engaged, dtype=np.bool_),
        )
