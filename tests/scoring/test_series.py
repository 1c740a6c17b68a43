"""What is kept of a recording for those who compute on it themselves."""

from __future__ import annotations

import math

import numpy as np

from scoring.protocol import PASSAGE_SENSORS, Outcome, Side, Thresholds
from scoring.result import Ending
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset
from scoring.samples import DoorSample, PassageSample, Sample
from scoring.series import PassageSeries, SeriesAssessment
from tests.scoring.runs import CONDITION, START, door, latch, passage_through, sensor, under

PLACE = PASSAGE_SENSORS.index(sensor(Side.CW, 2))


def passage(samples: list[Sample], rules: Ruleset = PROTOCOL) -> PassageSeries:
    found = SeriesAssessment(CONDITION, START, ruleset=rules)
    for sample in samples:
        found.feed(sample)
    return found.series(Ending(Outcome.TIMEOUT, "", START + 1), ()).passage


def of(series: PassageSeries, place: int = PLACE) -> tuple[list[float], list[int], list[bool]]:
    rows = series.sensor == place
    return (
        series.distance[rows].tolist(),
        series.present[rows].tolist(),
        series.masked[rows].tolist(),
    )


def looked(time: float, distance: float) -> PassageSample:
    place = sensor(Side.CW, 2)
    ranges = [2.0] * 4
    ranges[place.element] = distance
    return PassageSample(START + time, START + time, place.strip, tuple(ranges), 0.0, 2.5)


def test_what_is_no_reading_is_empty_and_changes_no_state() -> None:
    series = passage([looked(0, math.nan), looked(1, math.inf), looked(2, 0.8), looked(3, 9.0)])
    distances, present, _ = of(series)
    np.testing.assert_array_equal(distances, [math.nan, math.inf, 0.8, math.nan])
    assert present == [-1, 0, 1, 1]


def test_a_masked_sensor_keeps_its_state_by_the_protocol_and_is_clear_by_the_published_rules() -> (
    None
):
    samples: list[Sample] = [
        looked(0, 0.8),
        door(0.5, -0.2),
        looked(1, 2.0),
        door(1.5, -0.6),
        looked(2, 2.0),
    ]
    assert Thresholds().masked(Side.CW, 2, -0.2)
    distances, present, masked = of(passage(samples))
    assert distances == [0.8, 2.0, 2.0]
    assert present == [1, 1, 0]
    assert masked == [False, True, False]
    assert of(passage([samples[0], samples[1], looked(1, 0.8)], EUROBENCH_2020))[1] == [1, 0]


def test_stamps_are_those_that_count() -> None:
    late = DoorSample(START - 0.1, START + 0.1, 0.1)  # backward
    found = SeriesAssessment(CONDITION, START)
    once = under(1, Side.CW)
    samples: list[Sample] = [door(0, 0.0), late, once, once, latch(2, True)]
    for sample in samples:
        found.feed(sample)
    series = found.series(Ending(Outcome.TIMEOUT, "", START + 1), ())
    assert series.rows.joint_state.time.tolist() == [START]
    strip = sensor(Side.CW, 2).strip
    assert series.passage.time.tolist() == [START + 1] * sum(
        one.strip is strip for one in PASSAGE_SENSORS
    )
    assert (series.latch_time.tolist(), series.latch_engaged.tolist()) == ([START + 2], [True])


def test_rows_that_count_end_with_the_settle_time_and_are_all_by_the_published_rules() -> None:
    for rules, expected in (
        (PROTOCOL, (START, START + 7.0)),
        (EUROBENCH_2020, (-math.inf, math.inf)),
    ):
        found = SeriesAssessment(CONDITION, START, ruleset=rules)
        for sample in passage_through():
            found.feed(sample)
        series = found.series(Ending(Outcome.COMPLETED, "", START + 6.0), ())
        assert (series.rows_from, series.rows_until) == expected
