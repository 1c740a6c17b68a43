"""The rows of the tables of samples, from a scored run and all that its sensors said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TypeAlias

import numpy as np

from madrob_console.archive.run_record import RunLabel
from madrob_console.archive.scored import Scored
from madrob_console.tidy.run_rows import task_cells
from madrob_console.tidy.sample_tables import DOOR, HANDLE, LATCH, PASSAGE, RUN
from madrob_console.tidy.table_files import Cells, Chosen
from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, Side, Strip
from scoring.rulesets import ruleset
from scoring.series import PassageSeries, WholeSeries

SampleRows: TypeAlias = Mapping[str, Mapping[str, Cells]]
"""By table, by column: the cells."""


def sample_rows(name: str, scored: Scored, series: WholeSeries, label: RunLabel) -> SampleRows:
    """The tables of one run.

    Args:
        name: of the run, as the tables call it.
        scored: the run, by the rules of the tables.
        series: all that its sensors said.
        label: whose run it is.
    """
    start, thresholds = scored.result.start, scored.record.thresholds

    def timed(time: Array, cells: Mapping[str, Cells]) -> Mapping[str, Cells]:
        return {
            "run": Chosen(np.zeros(time.size, dtype=np.int8), (name,)),
            "time": time,
            "since_start": time - start,
            **cells,
        }

    rows, passage = series.rows, series.passage
    return {
        RUN.name: _run(name, scored, series, label),
        DOOR.name: timed(rows.joint_state.time, _door(series)),
        HANDLE.name: timed(rows.force_time, {"force": rows.force}),
        PASSAGE.name: timed(passage.time, _passage(passage, thresholds.lintel_height)),
        LATCH.name: timed(series.latch_time, {"engaged": series.latch_engaged}),
    }


def _run(name: str, scored: Scored, series: WholeSeries, label: RunLabel) -> Mapping[str, Cells]:
    setup, result, limits = scored.record.setup, scored.result, scored.record.thresholds
    told = {**asdict(label), "run_number": label.run, **task_cells(setup.condition)}
    return {
        **{column: [cell] for column, cell in told.items()},
        "run": [name],
        "practice": [setup.practice],
        "ruleset": [result.ruleset.value],
        "lock_detection": [result.lock_detection.value],
        "outcome": [result.outcome.value],
        "start": [result.start],
        "stop": [result.stop],
        "duration": [None if result.stop is None else result.stop - result.start],
        "rows_from": [series.rows_from - result.start],
        "rows_until": [series.rows_until - result.start],
        "handle_zero": [result.handle_zero],
        "touch_force": [limits.touch_force],
        "closed_angle": [limits.closed_angle],
        "lintel_height": [limits.lintel_height],
        "present_height": [ruleset(result.ruleset).present_height or limits.present_height],
        "settle_time": [limits.settle_time],
        "largest_gap": [limits.largest_gap],
    }


def _door(series: WholeSeries) -> Mapping[str, Cells]:
    rows, joint = series.rows, series.rows.joint_state
    jerk = np.full(joint.time.size, np.nan)
    jerk[np.searchsorted(joint.time, rows.jerk_time)] = rows.jerk  # of some of these very times
    return {
        "position": joint.position,
        "velocity": joint.velocity,
        "acceleration": joint.acceleration,
        "low_passed_acceleration": rows.low_passed,
        "jerk": jerk,
    }


def _passage(passage: PassageSeries, lintel_height: float) -> Mapping[str, Cells]:
    def of_sensor(places: list[int]) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
        return np.array(places, dtype=np.int8)[passage.sensor]

    sides, strips = list(Side), list(Strip)
    return {
        "side": Chosen(of_sensor([sides.index(s.side) for s in PASSAGE_SENSORS]), tuple(Side)),
        "index": of_sensor([sensor.index for sensor in PASSAGE_SENSORS]),
        "strip": Chosen(of_sensor([strips.index(s.strip) for s in PASSAGE_SENSORS]), tuple(Strip)),
        "element": of_sensor([sensor.element for sensor in PASSAGE_SENSORS]),
        "range": passage.distance,
        "height": lintel_height - passage.distance,
        "present": np.ma.masked_less(passage.present, 0),
        "masked": passage.masked,
    }
