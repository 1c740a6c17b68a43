"""The figures of a run inside a page. Loads matplotlib: import it where a page is made."""

from __future__ import annotations

import re
from collections.abc import Mapping

from madrob_console.archive.scored import Scored
from madrob_console.report.markup import Markup, element, escaped, section
from scoring.figure_table import FigureName
from scoring.figures.plots import figures_of, missing_figures, svg

_GREY = "In the grey band the door counts as closed."

_REFERENCE = re.compile(r'(\bid="|url\(#|xlink:href="#)')


def figures(scored: Scored) -> Markup:
    """The figures that the run has, and the reasons for those that it has not."""
    drawn = figures_of(scored.result, scored.rows, scored.record.setup.condition)
    missing = missing_figures(scored.result, scored.rows)
    if not drawn:
        return section("Figures", element("p", f"None: {_reasons(missing)}."))
    pictures = [
        element("figure", inline(svg(figure), name), element("figcaption", name.spec.caption))
        for name, figure in drawn.items()
    ]
    lacking = [
        element("p", f"Figure {name.number} is missing: {reason}.")
        for name, reason in missing.items()
    ]
    return section(
        "Figures", element("p", _GREY), element("div", pictures, class_="figures"), lacking
    )


def inline(document: str, name: FigureName) -> Markup:
    """An SVG document as a part of a page, whose ids are no other figure's."""
    picture = document[document.index("<svg") :]
    picture = re.sub(r' xmlns(:xlink)?="[^"]*"', "", picture)
    picture = _REFERENCE.sub(rf"\g<1>f{name.number}-", picture)
    picture = picture.replace("xlink:href=", "href=")
    alternative = escaped(f"Figure {name.number}: {name.spec.caption}")
    return Markup(picture.replace("<svg", f'<svg role="img" aria-label="{alternative}"', 1))


def _reasons(missing: Mapping[FigureName, str]) -> str:
    return "; ".join(dict.fromkeys(missing.values()))
