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

from scoring.figure_table import LARGEST_JERK, FigureName, Quantity
from scoring.figures import MOST_POINTS, figures_of, missing_figures, svg
from scoring.protocol import PASSAGE_SENSORS, Outcome, Side
from scoring.result import Ending, Result
from scoring.rows import Rows
from scoring.run_drawings import (
    Lane,
    passage_figure,
    stretches,
)
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


def curve(axes: Axes, name: str) -> tuple[Array, Array]:
    (found,) = (line for line in axes.get_lines() if line.get_gid() == name)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_curve_is_what_the_indicator_was_computed_from(nominal: Scored) -> None:
    result, rows = nominal
    figure = figures_for(result, rows)[FigureName.FORCE]
    time, force = curve(figure.axes[0], "force")
    np.testing.assert_array_equal(force, rows.force)
    np.testing.assert_allclose(time, rows.force_time - result.start)
    assert legend(figure)[0] == "maximum, 4.00 s"
    assert "30?" in figure.get_suptitle()


def test_jerk_is_clipped_and_its_mean_told(nominal: Scored) -> None:
    result, rows = nominal
    figure = figures_for(result, rows)[FigureName.JERK]
    axes = figure.axes[1]
    assert axes.get_ylim() == (0.0, 1.02 * LARGEST_JERK)
    mean = np.abs(rows.jerk).mean()
    assert legend(figure)[0].startswith(f"mean {mean:.3g}")


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


def test_events_are_lines_through_every_panel(nominal: Scored) -> None:
    figure = figures_for(*nominal)[FigureName.ACCELERATION]
    assert {"touch", "opening", "crossing", "closing"} < {*legend(figure)}
    for axes in figure.axes:
        drawn = {lines.get_label(): lines for lines in axes.collections}
        assert np.asarray(drawn["touch"].get_paths()[0].vertices)[0, 0] == pytest.approx(2.0)


def test_curves_are_broken_where_data_are_missing(nominal: Scored) -> None:
    result, rows = nominal
    kept = (rows.force_time < START + 3) | (rows.force_time > START + 6)
    columns = ("force_time", "force")
    holed = replace(rows, **{name: getattr(rows, name)[kept] for name in columns})
    time, force = curve(figures_for(result, holed)[FigureName.FORCE].axes[0], "force")
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


def test_svg_is_text_and_the_same_for_every_user(nominal: Scored) -> None:
    first = {name: svg(figure) for name, figure in figures_for(*nominal).items()}
    for name, text in first.items():
        assert f"Figure {name.number}" in "".join(ET.fromstring(text).itertext())
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
