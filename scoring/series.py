"""All that a recording's sensors said, for those who compute on it themselves.

The rows are those behind the result before they are cut, by the code that makes the result.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.evaluate import Assessment, completed_by_settling
from scoring.kinematics import Array, Rows
from scoring.procedure import Ruling
from scoring.protocol import PASSAGE_SENSORS
from scoring.quality import is_reading
from scoring.result import Ending
from scoring.signals import LatchSample, PassageSample, Sample

_PLACES = {sensor: place for place, sensor in enumerate(PASSAGE_SENSORS)}
_UNKNOWN = -1
"""Of a passage sensor that has said nothing yet."""


@dataclass(frozen=True, slots=True, eq=False)
class PassageSeries:
    """What the used passage sensors saw, one row a sensor and sample, as recorded (section 4).

    Attributes:
        time: s since the epoch, increasing for each sensor, shape (n,).
        sensor: its place in `PASSAGE_SENSORS`, shape (n,).
        distance: down from the lintel, m, inf = nothing there, NaN = no reading, shape (n,).
        present: 1 = something is under it as it counts after this reading, 0 = nothing,
            -1 = not known yet, shape (n,).
        masked: whether the panel passes under it, shape (n,).
    """

    time: Array
    sensor: NDArray[np.int8]
    distance: Array
    present: NDArray[np.int8]
    masked: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class WholeSeries:
    """Everything that was measured, from the opening of the recording to its end.

    Attributes:
        rows: of panel and handle, not cut.
        rows_from, rows_until: the rows of the run itself lie between, s since the epoch.
        passage: of the used passage sensors.
        latch_time, latch_engaged: of the latch sensor, s and whether it is engaged, shape (k,).
    """

    rows: Rows
    rows_from: float
    rows_until: float
    passage: PassageSeries
    latch_time: Array
    latch_engaged: NDArray[np.bool_]


class SeriesAssessment(Assessment):
    """An assessment that keeps what passage and latch sensors said, too."""

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
        """All of it, once the recording has been read to its end.

        Args:
            ending: how the run ended.
            rulings: the referee's, in the order in which they were made.
        """
        self._finish()
        ending, _ = self._stopped_by_these_rules(ending, rulings)
        end = self._end(ending)
        if completed_by_settling(ending, self.procedure(rulings, end)):
            end += self._thresholds.settle_time
        whole = not self._ruleset.cut_rows
        return WholeSeries(
            rows=self._rows(self._rest(ending))[2],
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
