"""The colours of drawings inside a page, which may be dark: names in place of the colours."""

from __future__ import annotations

import re
from collections.abc import Mapping

from madrob_console.report.markup import Markup
from scoring.figures.colours import BAND, BLUE, GREY, ORANGE, RED
from scoring.figures.phases import TimedPhase

_NAMES: Mapping[str, str] = {
    "#ffffff": "paper",
    "#000000": "ink",
    BAND: "band",
    ORANGE: "orange",
    BLUE: "blue",
    RED: "red",
    GREY: "grey",
    **{
        phase.colour: f"phase-{phase.name.lower()}"
        for phase in TimedPhase
        if phase.colour not in (ORANGE, BLUE)
    },
}
"""As `report.css` calls them."""

_COLOUR = re.compile("|".join(_NAMES))
_NAMESPACE = re.compile(r' xmlns(:xlink)?="[^"]*"')


def themed(drawing: str) -> Markup:
    """A finished drawing as a part of the page, whose colours, light or dark, it has.

    Args:
        drawing: SVG or HTML of ours, with colours in style attributes.
    """
    part = _NAMESPACE.sub("", drawing)
    return Markup(_COLOUR.sub(lambda found: f"var(--{_NAMES[found[0]]})", part))
