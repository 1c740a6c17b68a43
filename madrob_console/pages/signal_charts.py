"""Door, handle and passage of a run on one time axis that can be zoomed: for a protest.

The only page with a script: a library that lies in it and loads nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from markupsafe import Markup

from madrob_console.common.names import terminal_safe
from madrob_console.pages.templates import render
from scoring.figure_table import Quantity
from scoring.figures.run_drawings import passage_figure
from scoring.protocol import Condition
from scoring.result import Result
from scoring.rows import Rows

_DECIMALS = 5  # of s, rad and N: more than any sensor has


def signals_html(
    name: str, result: Result, rows: Rows, condition: Condition, banners: Sequence[str]
) -> str:
    """The page of a run called `name`; samples as they were recorded, and all events.

    `banners` say why the run is not official.
    """
    passage = passage_figure(result, rows, condition)
    door, handle = (
        [np.round(times - result.start, _DECIMALS).tolist(), np.round(values, _DECIMALS).tolist()]
        for times, values in map(rows.series, (Quantity.POSITION, Quantity.FORCE))
    )
    times = [0.0, *door[0], *handle[0], *(event.since_start for event in result.events)]
    window = min(times), max(times)
    lanes = [
        {"name": lane.name, "spans": [(a, min(b, window[1])) for a, b in lane.spans]}
        for lane in (passage.lanes if passage else ())
    ]
    chart = {
        "door": door,
        "handle": handle,
        "lanes": lanes,
        "events": [(event.since_start, event.event.words) for event in result.events],
        "window": window,
    }
    data = msgspec.json.encode(chart).decode().replace("<", "\\u003c")
    return render(
        "signals.html",
        name=terminal_safe(name),
        banners=banners,
        result=result,
        condition=condition,
        data=Markup(data),
    )
