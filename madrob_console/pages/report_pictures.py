"""Figures of a report, and what they mean."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from markupsafe import Markup, escape

from madrob_console.archive.scored import Scored
from madrob_console.common.names import terminal_safe
from madrob_console.pages.drawings import Scale, rows_of_words
from madrob_console.pages.templates import render
from scoring.figure_table import FigureName, Quantity
from scoring.indicator_table import IndicatorName
from scoring.run_drawings import (
    BAND,
    BLUE,
    GREY,
    ORANGE,
    RED,
    PassageFigure,
    passage_figure,
)

NO_MATPLOTLIB = "they need matplotlib: install madrob-console with its extra `report`"

_REFERENCE = re.compile(r'(\bid="|url\(#|xlink:href="#)')


@lru_cache(maxsize=64)  # drawing takes most of a report's time, and a site draws the same ones
def figures(scored: Scored) -> Markup:
    result, rows, condition = scored.result, scored.rows, scored.record.setup.condition
    drawn: Mapping[FigureName, Markup] = {}
    try:
        from scoring.figures import figures_of, heading, missing_figures, svg
    except ModuleNotFoundError:
        missing: Mapping[FigureName, str] = dict.fromkeys(FigureName, NO_MATPLOTLIB)
    else:
        drawn = {
            name: inline(svg(figure), name.number, heading(result, name))
            for name, figure in figures_of(result, rows, condition).items()
        }
        missing = missing_figures(result, rows)
    passage = passage_figure(result, rows, condition) if drawn else None
    return render(
        "figures.html",
        result=result,
        drawn=drawn.items(),
        missing=missing,
        reasons="; ".join(dict.fromkeys(missing.values())),
        passage=passage,
        **({} if passage is None else _passage(passage)),
        occupied=result.indicators[IndicatorName.DOOR_OCCUPATION_TIME].text if passage else "",
        touch_force=rows.thresholds.touch_force,
        shows_force=lambda name: Quantity.FORCE in name.spec.panels,
    )


def _passage(passage: PassageFigure) -> dict[str, object]:
    scale = Scale(*passage.window)
    rows = rows_of_words(passage.marks, scale)
    return {"scale": scale, "word_rows": rows, "head": 14 * (max(rows, default=-1) + 1) + 4}


def inline(document: str, number: int, alternative: str) -> Markup:
    """An SVG document as a part of a page; the figure's `number` makes its ids unique."""
    picture = document[document.index("<svg") :]
    picture = _REFERENCE.sub(rf"\g<1>f{number}-", picture)
    picture = picture.replace("xlink:href=", "href=")
    spoken = escape(terminal_safe(alternative))
    return themed(picture.replace("<svg", f'<svg role="img" aria-label="{spoken}"', 1))


_NAMES: Mapping[str, str] = {
    "#ffffff": "paper",
    "#000000": "ink",
    BAND: "band",
    ORANGE: "orange",
    BLUE: "blue",
    RED: "red",
    GREY: "grey",
}
"""As `report.css` calls them."""

_COLOUR = re.compile("|".join(_NAMES))
_NAMESPACE = re.compile(r' xmlns(:xlink)?="[^"]*"')


def themed(figure: str) -> Markup:
    """A figure as a part of a page, with the page's colours, which may be dark."""
    part = _NAMESPACE.sub("", figure)
    return Markup(_COLOUR.sub(lambda match: f"var(--{_NAMES[match[0]]})", part))
