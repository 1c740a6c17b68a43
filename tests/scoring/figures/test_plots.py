from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scoring.figure_table import LARGEST_JERK, EventMark, FigureName, Quantity
from scoring.figures.drawing import MOST_POINTS
from scoring.figures.plots import alternatives_of, figures_of, missing_figures, svg
from scoring.figures.run_drawings import (
    Lane,
    TimedPhase,
    median_phases,
    passage_figure,
    phases_of,
    stretches,
)
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import PASSAGE_SENSORS, Outcome, Side, Step
from scoring.result import Ending, Result, Uncertainty, value_text
from scoring.rows import Rows
from scoring.samples import Sample
from tests.scoring.runs import CONDITION, START, assessment, clear, door, handle, under

Array = NDArray[np.float64]
Scored = tuple[Result, Rows]


def swing(time: float) -> float:
    """Opens from 3 s to 5 s, closes from 7 s to 9 s."""
    if 3 <= time <= 5:
        return 0.5 - 0.5 * math.cos((time - 3) * math.pi / 2)
    if 7 <= time <= 9:
        return 0.5 + 0.5 * math.cos((time - 7) * math.pi / 2)
    return 1.0 if 5 < time < 7 else 0.0


def pull(time: float) -> float:
    return -30.0 if 4 <= time < 4.01 else 12.0 if 2 <= time <= 5 else 0.0


def run(
    angle: Callable[[float], float] | None = swing,
    force: Callable[[float], float] | None = pull,
    outcome: Outcome = Outcome.COMPLETED,
    stop: float | None = 10.0,
) -> Scored:
    samples: list[Sample] = []
    for tick in range(-50, 600):
        time = tick / 50
        samples += [door(time, angle(time))] if angle else []
        samples += [handle(time, force(time))] if force else []
        samples += {250: [under(time, Side.CCW)], 270: [under(time, Side.CW)]}.get(tick, [])
        samples += {275: [clear(time, Side.CCW)], 300: [clear(time, Side.CW)]}.get(tick, [])
    ending = Ending(outcome, "as told", None if stop is None else START + stop)
    return assessment(samples).result(ending)


@pytest.fixture(scope="module")
def nominal() -> Scored:
    return run()


def figures_for(result: Result, rows: Rows) -> dict[FigureName, Figure]:
    return figures_of(result, rows, CONDITION)


def curve(axes: Axes, label: str) -> tuple[Array, Array]:
    (found,) = (line for line in axes.get_lines() if line.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def words(figure: Figure) -> str:
    texts = [*figure.texts]
    for axes in figure.axes:
        texts += [*axes.texts, axes.title, axes._right_title]  # type: ignore[attr-defined]
    return "\n".join(text.get_text() for text in texts)


@pytest.mark.parametrize(
    ("name", "place", "label", "times", "values"),
    [
        (
            FigureName.ACCELERATION,
            0,
            "position, rad",
            lambda rows: rows.joint_state.time,
            lambda rows: rows.joint_state.position,
        ),
        (
            FigureName.ACCELERATION,
            1,
            "acceleration, rad/s²",
            lambda rows: rows.joint_state.time,
            lambda rows: rows.low_passed,
        ),
        (
            FigureName.FORCE,
            0,
            "force, N",
            lambda rows: rows.force_time,
            lambda rows: rows.force,
        ),
    ],
)
def test_a_curve_is_what_the_indicator_was_computed_from(
    nominal: Scored,
    name: FigureName,
    place: int,
    label: str,
    times: Callable[[Rows], Array],
    values: Callable[[Rows], Array],
) -> None:
    result, rows = nominal
    time, drawn = curve(figures_for(result, rows)[name].axes[place], label)
    np.testing.assert_array_equal(time, times(rows) - START)
    np.testing.assert_array_equal(drawn, values(rows))


def test_jerk_is_drawn_clipped_and_whole_below_with_the_mean_that_makes_the_score(
    nominal: Scored,
) -> None:
    result, rows = nominal
    smoothness = result.indicators[IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION].value
    assert smoothness is not None
    for name in (FigureName.JERK, FigureName.JERK_OF_THE_OPENING):
        figure = figures_for(result, rows)[name]
        _, clipped, whole = figure.axes
        for axes in (clipped, whole):
            assert 10 / curve(axes, "mean")[1][0] == pytest.approx(smoothness)
        assert f"the run's mean {10 / smoothness:.3g}" in words(figure)
        assert np.nanmax(curve(whole, "abs jerk, rad/s³")[1]) > LARGEST_JERK
    figure = figures_for(result, rows)[FigureName.JERK]
    _, jerk = curve(figure.axes[1], "abs jerk, rad/s³")
    drawn = np.minimum(np.abs(rows.jerk), LARGEST_JERK)
    np.testing.assert_array_equal(jerk[np.isfinite(jerk)], drawn)
    outside = 100 * np.mean(np.abs(rows.jerk) > LARGEST_JERK)
    assert f"{outside:.1f} % of the samples lie outside" in words(figure)


def test_figures_are_told_in_words_with_their_numbers(nominal: Scored) -> None:
    result, rows = nominal
    told = alternatives_of(result, rows, CONDITION)
    assert set(told) == set(figures_for(result, rows))
    assert "position from 0 to 1 rad" in told[FigureName.ACCELERATION]
    assert "force from -30 to 12 N, largest at 4.00 s" in told[FigureName.FORCE]
    assert "touch at 2.00 s" in told[FigureName.FORCE]
    assert "touch" not in told[FigureName.JERK_OF_THE_CLOSING]


@pytest.mark.parametrize(
    ("name", "indicator"),
    [
        (FigureName.ACCELERATION, IndicatorName.UNSAFETY_OF_DOOR_OPERATION),
        (FigureName.FORCE, IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION),
    ],
)
def test_the_marked_maximum_is_the_indicator(
    name: FigureName, indicator: IndicatorName, nominal: Scored
) -> None:
    result, rows = nominal
    figure = figures_for(result, rows)[name]
    (time,), (value,) = curve(figure.axes[-1], "maximum")
    signal_time, signal = {
        FigureName.ACCELERATION: (rows.joint_state.time, rows.low_passed),
        FigureName.FORCE: (rows.force_time, rows.force),
    }[name]
    assert abs(value) == result.indicators[indicator].value
    assert value == signal[np.flatnonzero(signal_time - START == time)[0]]
    found = result.indicators[indicator]
    assert f"maximum {value_text(abs(value), found.uncertainty)} {unit_text(found.unit)}" in (
        words(figure)
    )
    assert unit_text(found.text) in " ".join(figure.texts[0].get_text().split())


@pytest.mark.parametrize("peak", [0.2, 3.0, 5.2, 6.0, 9.5])
def test_the_words_at_a_maximum_stay_within_their_figure_wherever_it_is(peak: float) -> None:
    result, rows = run(force=lambda time: -199.25 if abs(time - peak) < 0.05 else 0.0)
    figure = figures_for(result, rows)[FigureName.FORCE]
    (maximum,) = (text for text in figure.axes[0].texts if "maximum" in text.get_text())
    extent, sheet = maximum.get_window_extent(), figure.bbox
    assert sheet.x0 <= extent.x0
    assert extent.x1 <= sheet.x1


def test_a_scale_is_four_uncertainties_wide_and_noise_looks_like_noise() -> None:
    shaking = run(force=lambda time: 0.002 * math.sin(90 * time))
    wide = replace(
        shaking[0],
        indicators={
            name: replace(one, uncertainty=Uncertainty(5.0, 10.0)) if one.value is not None else one
            for name, one in shaking[0].indicators.items()
        },
    )
    for result, least in ((shaking[0], 1.0), (wide, 40.0)):
        low, high = figures_for(result, shaking[1])[FigureName.FORCE].axes[0].get_ylim()
        assert high - low >= least


@pytest.mark.parametrize(
    ("name", "begins", "ends"),
    [
        (FigureName.JERK_OF_THE_OPENING, (2, 3.1), (4.6, 6)),
        (FigureName.JERK_OF_THE_CLOSING, (6, 7.4), (8.9, 10)),
    ],
)
def test_figures_three_and_four_show_opening_and_closing_alone(
    nominal: Scored, name: FigureName, begins: tuple[float, float], ends: tuple[float, float]
) -> None:
    first, last = figures_for(*nominal)[name].axes[1].get_xlim()
    assert begins[0] < first < begins[1]
    assert ends[0] < last < ends[1]


def test_events_are_lines_through_every_panel_at_their_times(nominal: Scored) -> None:
    figure = figures_for(*nominal)[FigureName.ACCELERATION]
    assert len(figure.axes) > 1
    for axes in figure.axes:
        times = {str(mark): curve(axes, str(mark))[0][::3] for mark in EventMark}
        for mark, about in ((EventMark.TOUCH, 2.0), (EventMark.OPENING, 3.0)):
            assert times[str(mark)] == pytest.approx([about], abs=0.3)
        assert all(each.size for each in times.values())


def test_curves_are_broken_where_data_are_missing(nominal: Scored) -> None:
    result, rows = nominal
    kept = (rows.force_time < START + 3) | (rows.force_time > START + 6)
    columns = ("force_time", "force")
    holed = replace(rows, **{name: getattr(rows, name)[kept] for name in columns})
    time, force = curve(figures_for(result, holed)[FigureName.FORCE].axes[0], "force, N")
    (gap,) = np.flatnonzero(np.isnan(force))
    assert 3 > time[gap - 1] > 2.9


def test_an_aborted_run_has_no_figures_an_interrupted_one_those_of_its_samples() -> None:
    aborted = run(outcome=Outcome.ABORTED)
    assert figures_for(*aborted) == {}
    missing = missing_figures(*aborted)
    assert set(missing) == set(FigureName)
    assert "invalid" in missing[FigureName.FORCE]
    figures = figures_for(*run(outcome=Outcome.INTERRUPTED, stop=None))
    assert set(figures) == set(FigureName)
    assert figures[FigureName.FORCE].axes[0].get_xlim()[1] == pytest.approx(11.98)


OF_THE_DOOR = [name.number for name in FigureName if Quantity.POSITION in name.spec.panels]


def test_the_figures_of_the_protocol_document_keep_their_numbers() -> None:
    assert [name.number for name in FigureName][:5] == [1, 2, 3, 4, 5]
    assert {1, 2, 3, 4} == set(OF_THE_DOOR) & {1, 2, 3, 4, 5}


@pytest.mark.parametrize(
    ("angle", "force", "missing"),
    [
        (None, None, dict.fromkeys(OF_THE_DOOR, "no door angle") | {5: "no handle force"}),
        (None, pull, dict.fromkeys(OF_THE_DOOR, "no door angle")),
        (swing, None, {5: "no handle force"}),
        (lambda _: 0.0, pull, {3: "never opened", 4: "never opened"}),
        (lambda t: swing(min(t, 6)), pull, {4: "never closed"}),
    ],
)
def test_every_figure_is_there_or_has_a_reason(
    angle: Callable[[float], float] | None,
    force: Callable[[float], float] | None,
    missing: dict[int, str],
) -> None:
    result, rows = run(angle, force, Outcome.TIMEOUT)
    reasons = missing_figures(result, rows)
    assert {name.number for name in reasons} == set(missing)
    assert all(missing[name.number] in reason for name, reason in reasons.items())
    assert set(figures_for(result, rows)) == set(FigureName) - set(reasons)


def test_svg_is_xml_with_readable_text_and_the_same_whatever_the_users_settings(
    nominal: Scored,
) -> None:
    figures = figures_for(*nominal)
    first = {name: svg(figure) for name, figure in figures.items()}
    for name, text in first.items():
        told = "".join(ET.fromstring(text).itertext())
        assert f"Figure {name.number}" in told
        assert [one for one in words(figures[name]).split("\n") if one not in told] == []
        assert not [word for word in ("<script", "dc:date") if word in text]
    with mpl.rc_context({"lines.linewidth": 9, "svg.fonttype": "path", "font.size": 20}):
        before = dict(mpl.rcParams)
        assert {name: svg(figure) for name, figure in figures_for(*nominal).items()} == first
        assert dict(mpl.rcParams) == before


values = arrays(np.float64, st.integers(0, 40), elements=st.floats(allow_nan=True))


@given(values, st.integers(1, 400))
def test_thinning_keeps_order_and_extremes_of_every_curve(part: Array, repeat: int) -> None:
    value = np.tile(part, repeat)
    time = np.arange(value.size, dtype=np.float64)
    found = stretches(time, value, 1.5, MOST_POINTS)
    whole = value[np.isfinite(value)]
    assert bool(found) == bool(whole.size)
    if not found:
        return
    kept_time, kept = (np.concatenate(parts) for parts in zip(*found, strict=True))
    assert kept.size <= MOST_POINTS
    assert np.all(np.diff(kept_time) > 0)
    np.testing.assert_array_equal(value[kept_time.astype(int)], kept)
    assert (kept.min(), kept.max()) == (whole.min(), whole.max())


@pytest.fixture(scope="module")
def shut() -> Scored:
    """A run whose door never opened."""
    return run(lambda _: 0.0, outcome=Outcome.TIMEOUT)


LARGEST = np.finfo(np.float64).max


@settings(max_examples=4)
@example(np.full(30, LARGEST), np.full(30, math.inf))
@example(np.r_[-LARGEST, np.zeros(28), LARGEST], np.r_[math.nan, -math.inf, np.full(28, LARGEST)])
@given(
    arrays(np.float64, 30, elements=st.floats(allow_nan=False, allow_infinity=False)),
    arrays(np.float64, 30, elements=st.floats(allow_nan=True, allow_infinity=True)),
)
def test_no_number_is_too_large_to_be_drawn(
    shut: Scored, force: Array, acceleration: Array
) -> None:
    result, rows = shut
    wild = replace(
        rows,
        force=force,
        force_time=rows.force_time[:30],
        joint_state=rows.joint_state.cut(START, START + 29.5 / 50),
        low_passed=acceleration,
        jerk=force[:5],
        jerk_time=rows.force_time[:5],
    )
    for figure in figures_for(result, wild).values():
        assert "nan" not in svg(figure).lower()


ALL_DONE = {step: 10.0 + step for step in Step}


EACH = dict.fromkeys(TimedPhase, 1.0) | {TimedPhase.OPEN: 2.0}


@pytest.mark.parametrize(
    ("steps", "stop", "phases"),
    [
        (ALL_DONE, 17.0, EACH),  # they add up to the run
        (
            ALL_DONE | {Step.LOCK: ALL_DONE[Step.CLOSE]},  # a door without a latch
            15.0,
            {phase: EACH[phase] for phase in list(TimedPhase)[:4]},
        ),
        ({Step.TOUCH: 13.0}, 310.0, {TimedPhase.TOUCH: 3.0, TimedPhase.REST: 297.0}),
        ({}, None, {}),
    ],
)
def test_phases_are_the_times_between_the_steps_and_what_came_after_the_last(
    steps: dict[Step, float], stop: float | None, phases: dict[TimedPhase, float]
) -> None:
    assert phases_of(steps, 10.0, stop) == phases


def test_the_median_is_of_those_runs_that_ended_a_phase() -> None:
    whole, stuck = (
        {TimedPhase.TOUCH: 1.0, TimedPhase.OPEN: 4.0},
        {TimedPhase.TOUCH: 3.0, TimedPhase.REST: 200.0},
    )
    assert median_phases([whole, stuck]) == {TimedPhase.TOUCH: 2.0, TimedPhase.OPEN: 4.0}
    assert median_phases([]) == {}


@pytest.fixture(scope="module")
def passage() -> Scored:
    """Through the door from 5 to 6 s; open from 3 to 9 s, swinging over the sensors."""
    return run(
        lambda time: max(0.0, min(1.0, time - 3, 9 - time)),
        lambda time: 12.0 if 2 <= time <= 3 else 0.0,
    )


def rounded(lane: Lane) -> list[tuple[float, float]]:
    return [(round(begin, 6), round(end, 6)) for begin, end in lane.spans]


def test_lanes_show_each_sensor_the_occupation_and_the_masks_of_the_events(
    passage: Scored,
) -> None:
    result, rows = passage
    found = passage_figure(result, rows, CONDITION)
    assert found is not None
    occupation, opened, *lanes = found.lanes
    assert (rounded(occupation), rounded(opened)) == ([(5.0, 6.0)], [(3.04, 8.98)])
    seen = {lane.name: rounded(lane) for lane in lanes if lane.spans}
    assert seen == {"ccw_left[1]": [(5.0, 5.5)], "cw_right[1]": [(5.4, 6.0)]}
    assert [words for _, words in found.marks] == ["approach CCW", "leave CW", "stop"]
    assert "occupation: 5.00 to 6.00 s" in found.alternative
    time, angle = rows.joint_state.time - result.start, rows.joint_state.position
    by_name = {f"{s.strip}[{s.element}]": s for s in PASSAGE_SENSORS}
    assert {lane.name for lane in lanes} == set(by_name)
    for lane in lanes:
        sensor = by_name[lane.name]
        masked = [rows.thresholds.masked(sensor.side, sensor.index, one) for one in angle]
        drawn = np.array([any(a <= t < b for a, b in lane.masked) for t in time])
        np.testing.assert_array_equal(drawn, masked)
    assert any(lane.masked for lane in lanes)


def stopped_by_time(*seen: Sample) -> Scored:
    samples = [*seen, *(door(t / 50, 0.0) for t in range(-50, 300))]
    samples.sort(key=lambda sample: sample.time)
    return assessment(samples).result(Ending(Outcome.TIMEOUT, "as told", START + 4))


def test_a_robot_that_stays_under_the_sensors_is_drawn_to_the_end() -> None:
    found = passage_figure(*stopped_by_time(under(1.0, Side.CCW)), CONDITION)
    assert found is not None
    assert [lane.spans for lane in found.lanes if lane.spans] == [((1.0, math.inf),)]
    assert math.isfinite(found.window[1])
    assert "inf" not in found.alternative
    assert passage_figure(*stopped_by_time(), CONDITION) is None  # nothing was under them
