"""The figures of a report, in the colours of its page; importing this loads matplotlib."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from madrob_console.archive.scored import Scored
from madrob_console.common.names import terminal_safe
from scoring.figures import (
    BAND,
    BLUE,
    GREY,
    ORANGE,
    RED,
    draw_events,
    draw_frame,
    figures_of,
    look,
    svg,
)
from scoring.indicator_table import IndicatorName
from scoring.protocol import PASSAGE_SENSORS, EventName

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
_REFERENCE = re.compile(r'(\bid="|url\(#|href="#)')


@lru_cache(maxsize=64)  # drawing takes most of a report's time, and a site draws the same ones
def figures(scored: Scored) -> Mapping[str, Markup]:
    """Return the figures of a report by their anchors, that of the sensors is `passage`."""
    drawn = {}
    condition = scored.record.setup.condition
    for name, figure in figures_of(scored.result, scored.rows, condition).items():
        drawn[f"figure-{name.number}"] = themed_svg(figure, f"f{name.number}-")
    if drawn and any(scored.rows.occupied.values()):
        drawn["passage"] = themed_svg(passage_figure(scored), "passage-")
    return drawn


def passage_figure(scored: Scored) -> Figure:
    """Draw when the robot occupied the door, and below it when each passage sensor did."""
    result = scored.result
    rows = scored.rows
    condition = scored.record.setup.condition
    time = rows.joint_state.time - result.start
    angle = rows.joint_state.position
    last = max([*rows.joint_state.time[-1:], *rows.force_time[-1:]]) - result.start
    times = {event.event: event.since_start for event in result.events}
    occupation = result.indicators[IndicatorName.DOOR_OCCUPATION_TIME]
    with look():
        figure = Figure()
        axes = figure.subplots()
        begin = times.get(EventName.approaches(condition.starting_side))
        if occupation.value is not None and begin is not None:
            axes.broken_barh([(begin, occupation.value)], (-0.35, 0.7), color=RED)

        # The sensors of the side where the robot starts stand above the others.
        sensors = sorted(PASSAGE_SENSORS, key=lambda one: one.side is condition.destination_side)
        for lane, sensor in enumerate(sensors, start=1):
            low, high = rows.thresholds.mask(sensor.side, sensor.index)
            panel = angle * sensor.side.sign
            axes.fill_between(
                time,
                lane - 0.5,
                lane + 0.5,
                where=(low < panel) & (panel < high),
                facecolor="none",
                edgecolor=GREY,
                linewidth=0,
                hatch="/////",
            )
            bars = []
            for begin, end in rows.occupied.get(sensor, ()):
                since = begin - result.start
                bars.append((since, min(end - result.start, last) - since))
            axes.broken_barh(bars, (lane - 0.35, 0.7), color=BLUE)
        names = [f"{sensor.strip}[{sensor.element}]" for sensor in sensors]
        axes.set_yticks(range(len(sensors) + 1), ["occupation", *names], fontsize=8)
        axes.set_xlim(0.0, last)
        axes.set_ylim(len(sensors) + 0.5, -0.5)
        draw_events(axes, result, condition)
        draw_frame(figure, f"Passage sensors: door occupation time\n{occupation.text}", axes)
    return figure


def themed_svg(figure: Figure, prefix: str) -> Markup:
    """Return a figure as a part of a page: `prefix` makes its ids unique, colours are the page's.

    A screen reader says its title.
    """
    document = svg(figure)
    picture = _NAMESPACE.sub("", document[document.index("<svg") :])
    picture = picture.replace("xlink:href=", "href=")
    picture = _REFERENCE.sub(rf"\g<1>{prefix}", picture)
    picture = _COLOUR.sub(lambda match: f"var(--{_NAMES[match[0]]})", picture)
    spoken = escape(terminal_safe(" ".join(figure.get_suptitle().split())))
    return Markup(picture.replace("<svg", f'<svg role="img" aria-label="{spoken}"', 1))
