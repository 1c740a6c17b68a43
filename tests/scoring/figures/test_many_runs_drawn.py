"""Drawings of many runs: what leads the scale, what has a box, what is joined."""

from __future__ import annotations

import re

from scoring.figures.box_plots import FEWEST_FOR_A_BOX, BoxRow, box_plot
from scoring.figures.day_curves import DayPoint, day_curve
from scoring.figures.value_scale import FAILED, shown_values

FIVE = (3.0, 3.5, 4.0, 4.5, 5.0)


def test_a_value_of_a_failed_run_does_not_stretch_the_scale_and_stands_at_its_edge() -> None:
    drawn = box_plot([BoxRow(FIVE, (539.5,))], "")
    assert f'<text x="100%" y="14" text-anchor="middle">{FAILED}' in drawn
    ticks = [float(found) for found in re.findall(r">([0-9.]+)</text>", drawn)]
    assert max(ticks) <= 6
    stretched = box_plot([BoxRow(FIVE, (539.5,))], "", all_shown=True)
    assert ">400<" in stretched


def test_few_values_are_points_and_no_box() -> None:
    few = box_plot([BoxRow(FIVE[: FEWEST_FOR_A_BOX - 1])], "")
    assert (few.count("<circle"), few.count("<rect")) == (4, 0)
    many = box_plot([BoxRow(FIVE)], "")
    assert (many.count("<circle"), many.count("<rect")) == (5, 1)
    assert 'x1="50%" x2="50%"' in many  # the median


def test_where_nobody_completed_the_failed_ones_make_the_scale() -> None:
    assert shown_values([], [1.0, 2.0]) == shown_values([1.0, 2.0])
    assert shown_values([7.0])[0] < 7.0 < shown_values([7.0])[1]


def test_runs_are_joined_within_a_condition_and_failed_ones_never() -> None:
    points = [
        DayPoint(0.0, 1.0, 7, completed=True),
        DayPoint(1.0, 2.0, 7, completed=True),
        DayPoint(2.0, 1.5, 12, completed=True),
        DayPoint(3.0, 99.0, 7, completed=False),
    ]
    drawn = day_curve(points, [(0.0, "08:00")], (0.0, 3.0), "all of it")
    joined = drawn.partition('stroke-width: 1">')[2].partition("</g>")[0]
    assert joined.count("<line") == 1
    assert (drawn.count("<circle"), drawn.count(FAILED)) == (3, 1)
    assert 'aria-label="all of it"' in drawn
    assert ">08:00<" in drawn
