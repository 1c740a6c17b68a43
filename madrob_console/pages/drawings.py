"""Drawings in a page that may be dark: names of the page's colours in place of colours."""

from __future__ import annotations

import re
from collections.abc import Mapping

from markupsafe import Markup

from scoring.figures.run_drawings import BAND, BLUE, GREY, ORANGE, RED
from scoring.figures.team_drawings import TimedPhase

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
    """A drawing of ours (SVG or HTML) with its style colours replaced by the page's."""
    part = _NAMESPACE.sub("", drawing)
    return Markup(_COLOUR.sub(lambda found: f"var(--{_NAMES[found[0]]})", part))
