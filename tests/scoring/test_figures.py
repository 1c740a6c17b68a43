"""The figures of the protocol document, as a reader of a run sees them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scoring.figure_table import LARGEST_JERK, FigureName
from scoring.figures import figures_of, missing_figures, svg
from scoring.protocol import Outcome, Side
from scoring.result import Ending, Result
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
    assert figure.get_suptitle().startswith("Figure 5: roughness of door actuation\n30?")


def test_jerk_is_cut_off_and_its_mean_told(nominal: Scored) -> None:
    result, rows = nominal
    figure = figures_for(result, rows)[FigureName.JERK]
    assert figure.axes[1].get_ylim() == (0.0, 1.02 * LARGEST_JERK)
    assert legend(figure)[0].startswith(f"mean {np.abs(rows.jerk).mean():.3g}")


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


def test_a_door_that_stays_open_again_shows_its_closing_before() -> None:
    figures = figures_for(*run(lambda time: swing(min(time, 9.5)) + (time > 9.6)))
    first, last = figures[FigureName.JERK_OF_THE_CLOSING].axes[1].get_xlim()
    assert 6 < first < last < 9.7


def test_events_are_lines_through_every_panel(nominal: Scored) -> None:
    figure = figures_for(*nominal)[FigureName.ACCELERATION]
    assert {"touch", "opening", "crossing", "closing"} < {*legend(figure)}
    lines = [{line.get_label(): line for line in axes.get_lines()} for axes in figure.axes]
    assert [np.asarray(of["touch"].get_xdata())[0] for of in lines] == pytest.approx([2.0, 2.0])


def test_curves_are_broken_where_data_are_missing(nominal: Scored) -> None:
    result, rows = nominal
    kept = (rows.force_time < START + 3) | (rows.force_time > START + 6)
    holed = replace(rows, force_time=rows.force_time[kept], force=rows.force[kept])
    time, force = curve(figures_for(result, holed)[FigureName.FORCE].axes[0], "force")
    (gap,) = np.flatnonzero(np.isnan(force))
    assert 3 > time[gap - 1] > 2.9


OF_THE_DOOR = dict.fromkeys(range(1, 5), "no door angle")


@pytest.mark.parametrize(
    ("recorded", "missing"),
    [
        (run(None, None, Outcome.TIMEOUT), OF_THE_DOOR | {5: "no handle force"}),
        (run(None), OF_THE_DOOR),
        (run(force=None), {5: "no handle force"}),
        (run(lambda _: 0.0), {3: "never opened", 4: "never opened"}),
        (run(lambda time: swing(min(time, 6))), {4: "never closed"}),
        (run(outcome=Outcome.ABORTED), dict.fromkeys(range(1, 6), "invalid")),
        (run(outcome=Outcome.INTERRUPTED, stop=None), {}),
    ],
)
def test_every_figure_is_there_or_has_a_reason(recorded: Scored, missing: dict[int, str]) -> None:
    reasons = missing_figures(*recorded)
    assert {name.number for name in reasons} == set(missing)
    assert all(missing[name.number] in reason for name, reason in reasons.items())
    assert set(figures_for(*recorded)) == set(FigureName) - set(reasons)


def test_svg_is_text_and_the_same_for_every_user(nominal: Scored) -> None:
    first = {name: svg(figure) for name, figure in figures_for(*nominal).items()}
    assert [f"Figure {n + 1}" in text for n, text in enumerate(first.values())] == [True] * 5
    with mpl.rc_context({"lines.linewidth": 9, "svg.fonttype": "path", "font.size": 20}):
        before = dict(mpl.rcParams)
        assert {name: svg(figure) for name, figure in figures_for(*nominal).items()} == first
        assert dict(mpl.rcParams) == before


def test_a_long_run_makes_no_large_file(nominal: Scored) -> None:
    result, rows = nominal
    time = result.start + np.arange(0.0, 300.0, 0.01)
    noise = np.random.default_rng(1).normal(size=time.size)
    figures = figures_for(result, replace(rows, force_time=time, force=noise))
    assert len(svg(figures[FigureName.FORCE])) < 100_000


LARGEST = np.finfo(np.float64).max


@pytest.mark.parametrize(
    ("force", "acceleration"),
    [
        (np.full(30, LARGEST), np.full(30, math.inf)),
        (
            np.r_[-LARGEST, np.zeros(28), LARGEST],
            np.r_[math.nan, -math.inf, np.full(28, LARGEST)],
        ),
        (np.zeros(30), np.full(30, math.nan)),
    ],
)
def test_no_number_is_too_large_to_be_drawn(force: Array, acceleration: Array) -> None:
    result, rows = run(lambda _: 0.0, outcome=Outcome.TIMEOUT)
    wild = replace(
        rows,
        force=force,
        force_time=rows.force_time[:30],
        joint_state=rows.joint_state.cut(START, START + 29.5 / 50),
        low_passed=acceleration,
        jerk=force[:5],
        jerk_time=rows.force_time[:5],
    )
    figures = figures_for(result, wild)
    documents = [svg(figures[name]) for name in FigureName if name in figures]
    assert not any("nan" in document.lower() for document in documents)
    assert len({ET.fromstring(document).tag for document in documents}) == 1
