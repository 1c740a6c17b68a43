from __future__ import annotations

from dataclasses import replace

import pytest
from rich.cells import cell_len

from madrob_console.engine.shown.curves import Curves
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.ui.cells.axes import Window
from madrob_console.ui.cells.lines import Line
from madrob_console.ui.cells.plot import ASCII, BRAILLE, Ink
from madrob_console.ui.panes.figure import FIGURES, Sheet
from scoring.figure_table import Quantity
from scoring.indicator_table import IndicatorName
from scoring.protocol import EventName
from scoring.result import Indicator, Uncertainty
from tests.madrob_console.ui.figure_data import CURVES, finished

WHOLE = Window(0.0, 15.0)


def drawn(
    number: int = 0,
    snapshot: Snapshot | None = None,
    *,
    curves: Curves = CURVES,
    window: Window = WHOLE,
    size: tuple[int, int] = (78, 19),
    ink: Ink = BRAILLE,
) -> list[str]:
    sheet = Sheet(number, curves, snapshot or finished().snapshot(), window)
    return [text(line) for line in sheet.lines(*size, ink)]


def text(line: Line) -> str:
    return "".join(span.text for span in line)


@pytest.mark.parametrize("number", range(len(FIGURES)))
@pytest.mark.parametrize("size", [(58, 13), (78, 17), (78, 19), (116, 29), (158, 43)])
@pytest.mark.parametrize("ink", [BRAILLE, ASCII])
def test_a_figure_fills_the_rows_that_there_are(
    number: int, size: tuple[int, int], ink: Ink
) -> None:
    rows = drawn(number, size=size, ink=ink)
    assert len(rows) == size[1]
    if size[0] >= 78:  # in fewer cells, words end with an ellipsis
        assert max(map(cell_len, rows)) <= size[0]
        assert ink is BRAILLE or all(row.isascii() for row in rows)


@pytest.mark.parametrize(
    ("number", "title", "finding", "heading"),
    [
        (
            0,
            "figure 1 of {all}: position and low-passed acceleration",
            "protocol: unsafety of door operation 1.8750 rad/s^2 = the maximum",
            "low-passed acceleration, rad/s^2   max abs 0.6800 at 3.75 s",
        ),
        (
            1,
            "figure 2 of {all}: position and jerk clipped at 2 rad/s^3",
            "protocol: smoothness of door actuation 0.0625 s^3/rad = 10/mean abs jerk",
            "abs jerk, rad/s^3 (clipped at 2)   max 12.5000 at 3.75 s",
        ),
        (
            2,
            "figure 3 of {all}: handle force",
            "protocol: roughness of door actuation 14.7500 N = the maximum",
            "force, N (as recorded)   max abs 18.1000 at 3.75 s",
        ),
    ],
)
def test_a_figure_says_which_it_is_of_which_run_and_what_it_explains(
    number: int, title: str, finding: str, heading: str
) -> None:
    rows = drawn(number)
    assert rows[0].startswith(title.format(all=len(FIGURES)))
    assert rows[0].endswith("0.00 to 15.00 s, all")
    run = "run 1 of subject 1 Door Bots, condition 1: No Force, pull, from CCW to CW"
    assert rows[1] == run
    assert rows[2] == finding
    assert heading in rows
    assert rows[-2] == "t touch 2.25  o opening 3.22  x crossing 8.97  c closing 13.86  s"


def test_an_indicator_without_a_value_gives_its_reason() -> None:
    engine = finished()
    assert engine.result is not None
    missing = {name: Indicator.missing(name, "door never opened") for name in IndicatorName}
    engine.result = replace(engine.result, indicators=missing)
    rows = drawn(
        1,
        engine.snapshot(),
        curves=replace(CURVES, stretches={**CURVES.stretches, Quantity.JERK: ()}),
    )
    assert rows[2] == "protocol: smoothness of door actuation none: door never opened"
    assert "abs jerk, rad/s^3   no data" in rows


def test_a_maximum_out_of_sight_is_still_told() -> None:
    rows = drawn(0, window=Window(8.0, 12.0))
    assert rows[0].endswith("8.00 to 12.00 s, part")
    heading = "low-passed acceleration, rad/s^2   max abs 0.6800 at 3.75 s, not in this part"
    assert heading in rows
    assert not any(BRAILLE.top in row for row in rows)


def test_a_way_back_to_the_starting_side_is_no_crossing() -> None:
    events = ((9.0, EventName.MOVES_TO_CCW), (13.0, EventName.DOOR_CLOSES))
    rows = drawn(curves=replace(CURVES, events=events))
    assert rows[-2] == "c closing 13.00  s"


def test_a_door_that_bounces_keeps_the_legend_short() -> None:
    events = tuple((float(t), EventName.DOOR_CLOSES) for t in range(3, 13))
    rows = drawn(curves=replace(CURVES, events=events))
    assert rows[-2] == "c closing 3.00 .. (10) .. 12.00  s"


def test_the_finding_has_uncertainty_and_doubt() -> None:
    engine = finished()
    assert engine.result is not None
    name = IndicatorName.UNSAFETY_OF_DOOR_OPERATION
    known = Indicator(1.875, "rad/s^2", None, Uncertainty(0.02, 0.04), ("a sample stepped",))
    engine.result = replace(engine.result, indicators={**engine.result.indicators, name: known})
    rows = drawn(0, engine.snapshot())
    assert any("unsafety of door operation 1.88? +- 0.04 rad/s^2 = the maximum" in r for r in rows)
