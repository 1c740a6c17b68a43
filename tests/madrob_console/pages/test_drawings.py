"""What pages draw: phases of a run, its passage sensors, values of many runs."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes

from madrob_console.archive.scored import Scored, score_opened
from madrob_console.pages.phases import TimedPhase, median_phases, phases_of
from madrob_console.pages.report_figures import passage_figure
from madrob_console.pages.site_drawings import FAILED, value_plots
from madrob_console.pages.templates import TEMPLATES
from madrob_console.referee.run_summary import RunSummary
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName
from scoring.protocol import PASSAGE_SENSORS, EventName, Outcome, Side, Step
from scoring.result import Uncertainty
from tests.madrob_console.recorded_runs import recorded
from tests.madrob_console.run_folders import summary

DRAWINGS = TEMPLATES.get_template("drawings.html").module

TIME, LEVEL = IndicatorName.EXECUTION_TIME, IndicatorName.CAPABILITY_LEVEL


def drawn(name: str, *of: object) -> str:
    svg = str(getattr(DRAWINGS, name)(*of))
    ET.fromstring(svg)
    return svg


@pytest.fixture(scope="module")
def scored() -> Scored:
    """A whole run through the door, from side CCW to side CW."""
    return score_opened(recorded(Scenario.NOMINAL))


def bars(axes: Axes) -> dict[str, list[tuple[float, float]]]:
    """From and to of the bars beside each name, s since the start."""
    names = [label.get_text() for label in axes.get_yticklabels()]
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for one in axes.collections:
        for path in () if one.get_hatch() else one.get_paths():
            box = path.get_extents()
            found[names[round((box.y0 + box.y1) / 2)]].append((box.x0, box.x1))
    return found


def test_each_passage_sensor_has_a_lane_below_the_occupation(scored: Scored) -> None:
    result, rows = scored.result, scored.rows
    found = bars(passage_figure(scored).axes[0])
    times = {event.event: event.since_start for event in result.events}
    passed = times[EventName.approaches(Side.CCW)], times[EventName.moves_to(Side.CW)]
    assert found.pop("occupation") == [pytest.approx(passed)]
    assert [name.partition("_")[0] for name in found] == ["ccw"] * 5 + ["cw"] * 5
    assert any(found.values())
    for sensor in PASSAGE_SENSORS:
        spans = np.array(rows.occupied.get(sensor, ())).reshape(-1, 2) - result.start
        drawn = np.array(found[f"{sensor.strip}[{sensor.element}]"]).reshape(-1, 2)
        np.testing.assert_allclose(drawn, spans, atol=1e-6)


def test_a_sensor_is_hatched_while_the_panel_passes_under_it(scored: Scored) -> None:
    rows = scored.rows
    axes = passage_figure(scored).axes[0]
    hatched = [one for one in axes.collections if one.get_hatch()]
    in_order = sorted(PASSAGE_SENSORS, key=lambda sensor: sensor.side is Side.CW)
    time = rows.joint_state.time - scored.result.start
    assert any(one.get_paths() for one in hatched)
    for sensor, one in zip(in_order, hatched, strict=True):
        boxes = [path.get_extents() for path in one.get_paths()]
        drawn = [any(box.x0 <= t <= box.x1 for box in boxes) for t in time]
        angles = rows.joint_state.position
        assert drawn == [
            rows.thresholds.masked(sensor.side, sensor.index, angle) for angle in angles
        ]


def test_a_robot_that_stays_under_a_sensor_is_drawn_to_the_end(scored: Scored) -> None:
    stays = {PASSAGE_SENSORS[0]: ((scored.result.start + 1.0, math.inf),)}
    no_door = scored.rows.joint_state.cut(0.0, 0.0)
    rows = replace(scored.rows, occupied=stays, joint_state=no_door)
    figure = passage_figure(replace(scored, rows=rows))
    ((begin, end),) = bars(figure.axes[0])["cw_right[3]"]
    assert (begin, end) == pytest.approx((1.0, figure.axes[0].get_xlim()[1]))


ALL_DONE = {step: float(step) for step in Step}
EACH = dict.fromkeys(TimedPhase, 1.0) | {TimedPhase.OPEN: 2.0}  # unlocking is no phase


@pytest.mark.parametrize(
    ("steps", "stop", "phases"),
    [
        (ALL_DONE, 7.0, EACH),
        (  # a door without a latch
            ALL_DONE | {Step.LOCK: ALL_DONE[Step.CLOSE]},
            5.0,
            {phase: EACH[phase] for phase in list(TimedPhase)[:4]},
        ),
        ({Step.TOUCH: 3.0}, 300.0, {TimedPhase.TOUCH: 3.0, TimedPhase.REST: 297.0}),
        ({Step.TOUCH: 3.0}, None, {TimedPhase.TOUCH: 3.0}),
    ],
)
def test_phases_are_the_times_between_the_steps(
    steps: dict[Step, float], stop: float | None, phases: dict[TimedPhase, float]
) -> None:
    assert phases_of(steps, stop) == phases


def test_the_median_is_of_those_runs_that_ended_a_phase() -> None:
    whole = {TimedPhase.TOUCH: 1.0, TimedPhase.OPEN: 4.0}
    stuck = {TimedPhase.TOUCH: 3.0}
    assert median_phases([whole, stuck]) == {TimedPhase.TOUCH: 2.0, TimedPhase.OPEN: 4.0}


FORCE = IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION


def valued(name: IndicatorName, *values: float, **fields: object) -> list[RunSummary]:
    return [
        summary(1, 7, n, hour=n, values={name: value}, **fields) for n, value in enumerate(values)
    ]


def plotted(found: list[RunSummary]) -> str:
    (plot,) = value_plots({"1 Delft": found})
    return drawn("rows_of_values", plot.rows, plot.scale, plot.spoken)


def ticks_of(svg: str) -> list[float]:
    return [float(tick) for tick in re.findall(r">([0-9.]+)</text>", svg)]


def test_a_value_of_a_failed_run_does_not_stretch_the_scale_and_stands_at_its_edge() -> None:
    failed = valued(FORCE, 539.5, outcome=Outcome.TIMEOUT)
    edge = plotted([*valued(FORCE, 3.0, 3.5, 4.0, 4.5, 5.0), *failed])
    assert f'<text x="100.0%" y="14" text-anchor="middle">{FAILED}' in edge
    assert max(ticks_of(edge)) <= 6
    assert min(ticks_of(plotted(failed))) > 400  # alone it leads


@given(
    st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=5),
    st.floats(1e-6, 1e6) | st.none(),
)
def test_a_scale_has_all_values_with_their_uncertainties_and_is_four_of_them_wide(
    values: list[float], expanded: float | None
) -> None:
    known = {} if expanded is None else {FORCE: Uncertainty(expanded / 2, expanded)}
    found = valued(FORCE, *values, uncertainties=known)
    spread = expanded or 0.0
    for scale in (plot.scale for plot in value_plots({"1": found})):
        slack = 1e-9 * max(map(abs, (scale.low, scale.high)))
        assert scale.low - slack <= min(values) - spread
        assert scale.high + slack >= max(values) + spread
        assert scale.high - scale.low >= 4 * spread - slack


def test_levels_are_drawn_from_0_to_6_whatever_they_are() -> None:
    for levels in ((6,), (1, 2), (0, 6)):
        found = valued(LEVEL, *levels)
        assert ticks_of(plotted(found)) == [0, 1, 2, 3, 4, 5, 6]


def test_of_very_many_runs_the_latest_are_drawn_and_all_are_counted() -> None:
    many = valued(TIME, *range(1, 500))
    (plot,) = value_plots({"1": many})
    assert plot.rows[0].completed == 499
    assert plot.rows[0].points[-1].value == 499
    assert len(plot.rows[0].points) < 200
