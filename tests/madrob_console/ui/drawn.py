"""Waiting until a screen shows what it was told."""

from __future__ import annotations

import asyncio

from textual.pilot import Pilot
from textual.screen import Screen


async def drawn(pilot: Pilot[None]) -> None:
    """Until nothing is left to be drawn.

    A pilot pauses until the process takes little of the processor, which on a busy machine says
    nothing: other programs may have it.
    """
    await pilot.pause()
    while pilot.app.is_running and _owes(pilot.app.screen):  # one that has ended draws no more
        await asyncio.sleep(0.005)
        await pilot.pause()


def _owes(screen: Screen[object]) -> bool:
    shown = screen._compositor.visible_widgets
    return (
        screen._layout_required
        or bool(screen._dirty_widgets)
        or any(widget._layout_required or widget._repaint_required for widget in shown)
    )
