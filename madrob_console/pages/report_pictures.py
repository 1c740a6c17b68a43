"""Figures and camera pictures of a report, and what they mean."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache

from madrob_console.archive.scored import Scored
from madrob_console.pages.camera_pictures import PASSAGE
from madrob_console.pages.markup import NOTHING, Content, Markup, element, escaped, section, themed
from scoring.figures.plots import alternatives_of, figures_of, missing_figures, svg
from scoring.figures.run_drawings import LANE, PassageFigure, passage_figure, passage_svg
from scoring.indicator_table import FigureName, IndicatorName, Quantity

_GREY = (
    "Within the grey band around 0 rad the door counts as closed. Red: what makes the indicator. "
    "All times are in s from the start of the run; the data are in the csv files."
)

_LANES = (
    "Blue: the sensor counts as occupied. Hatched: the panel passes under it, so that it keeps "
    "the state that it had. The robot occupies the door from the first rise of any sensor to the "
    "last fall of all, if it came on its starting side and left on the other one."
)

_REFERENCE = re.compile(r'(\bid="|url\(#|xlink:href="#)')


@lru_cache(maxsize=64)  # drawing takes most of a report's time, and a site draws the same ones
def figures(scored: Scored) -> Markup:
    result, rows, condition = scored.result, scored.rows, scored.record.setup.condition
    drawn = figures_of(result, rows, condition)
    missing = missing_figures(result, rows)
    if not drawn:
        return section("Figures", element("p", f"None: {_reasons(missing)}."), name="figures")
    spoken = alternatives_of(result, rows, condition)

    def cells() -> Iterator[Markup]:
        for name, figure in drawn.items():
            picture = inline(svg(figure), name.number, spoken[name])
            caption = element("figcaption", name.spec.caption, _handle(scored, name))
            yield element("figure", picture, caption, id=_anchor(name))

    sensors = _passage(scored)
    lacking = [
        _missing(f"Figure {name.number} is missing: {reason}.", _anchor(name))
        for name, reason in missing.items()
    ]
    if sensors is None:
        lacking.append(_missing("No passage sensor saw anything after the start.", PASSAGE))
    # what is missing has a place, too, behind what is there: an even number leaves no hole
    pictures = element("div", cells(), sensors or NOTHING, lacking, class_="figures")
    return section("Figures", element("p", _GREY), pictures, name="figures")


def _missing(words: str, name: str) -> Markup:
    return element("p", words, class_="missing", id=name)


def _anchor(name: FigureName) -> str:
    return f"figure-{name.number}"


def _passage(scored: Scored) -> Markup | None:
    found = passage_figure(scored.result, scored.rows, scored.record.setup.condition)
    if found is None:
        return None
    occupied = scored.result.indicators[IndicatorName.DOOR_OCCUPATION_TIME]
    return element(
        "figure",
        element("p", element("b", f"Passage sensors   door occupation time {occupied.text}")),
        element("div", _names(found), themed(passage_svg(found)), class_="lanes"),
        element("figcaption", _LANES),
        id=PASSAGE,
    )


def inline(document: str, number: int, alternative: str) -> Markup:
    """An SVG document as a part of a page; the figure's `number` makes its ids unique."""
    picture = document[document.index("<svg") :]
    picture = _REFERENCE.sub(rf"\g<1>f{number}-", picture)
    picture = picture.replace("xlink:href=", "href=")
    spoken = escaped(alternative)
    return themed(picture.replace("<svg", f'<svg role="img" aria-label="{spoken}"', 1))


def _handle(scored: Scored, name: FigureName) -> Content:
    """Background of the force: the handle's zero and the band within which nobody touches."""
    if Quantity.FORCE not in name.spec.panels:
        return ()
    zero, half = scored.result.handle_zero, scored.rows.thresholds.touch_force
    return (
        f" Dashed: the handle at rest, zeroed at {zero:.2f} N; beyond the grey band, {half:.2f} N "
        "to either side, it counts as touched."
    )


def _names(found: PassageFigure) -> Markup:
    names = [element("span", lane.name) for lane in found.lanes]
    style = f"padding-top: {found.head:g}px; line-height: {LANE}px"
    return element("div", names, class_="names", style=style)


def _reasons(missing: Mapping[FigureName, str]) -> str:
    return "; ".join(dict.fromkeys(missing.values()))
