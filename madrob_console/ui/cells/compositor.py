"""A compositor that renders and writes changed cells only.

Textual's own renders every visible widget whenever a cell of any of them changes, and writes a
changed row from the left edge of its widget on. It draws where this module cannot be imported:
private parts are known of one minor version only.
"""

from __future__ import annotations

import importlib.metadata
from typing import TYPE_CHECKING

from rich.control import Control
from textual._compositor import ChopsUpdate, Compositor, ReflowResult
from textual.geometry import Region

if TYPE_CHECKING:
    from rich.console import Console
    from textual.geometry import Size
    from textual.strip import Strip
    from textual.widget import Widget


KNOWN = "8.2."
"""Begin of the versions of Textual whose private parts are used here."""

if not (_version := importlib.metadata.version("textual")).startswith(KNOWN):
    raise ImportError(f"version {_version} writes twice the bytes over SSH that {KNOWN}x does")


class CellsUpdate(ChopsUpdate):
    """Changed spans of the screen with what they show now."""

    def render_segments(self, console: Console) -> str:
        return "".join(
            f"{Control.move_to(x, y)}{strip.render(console)}"
            for (y, _, _), strips in zip(self.spans, self.chops, strict=True)
            for x, strip in strips.items()
            if strip is not None
        )


class CellCompositor(Compositor):
    """In a screen's `__init__` it takes the place of Textual's compositor."""

    def reflow(self, parent: Widget, size: Size) -> ReflowResult:
        """Lays out; what is new on the screen is painted with the layout, and not once more."""
        result = super().reflow(parent, size)
        for widget in result.shown | result.resized:
            widget._exchange_repaint_regions()
        return result

    def render_partial_update(self) -> ChopsUpdate | None:
        spans = list(self._regions_to_spans(self._dirty_regions))
        self._dirty_regions.clear()
        return CellsUpdate([self._cells(*span) for span in spans], spans, []) if spans else None

    def _cells(self, y: int, begin: int, end: int) -> dict[int, Strip | None]:
        """What the widgets show on a row by column, from `begin` to before `end`."""
        strips: dict[int, Strip | None] = {}
        gaps = [(begin, end)]
        for widget, visible, region in self.layers_visible[y]:  # the front one first
            open_gaps: list[tuple[int, int]] = []
            for left, right in gaps:
                first, last = max(left, visible.x), min(right, visible.right)
                if first >= last:
                    open_gaps.append((left, right))
                    continue
                wanted = Region(first - region.x, y - region.y, last - first, 1)
                (strips[first],) = widget.render_lines(wanted)
                open_gaps += [gap for gap in ((left, first), (last, right)) if gap[0] < gap[1]]
            if not (gaps := open_gaps):
                break
        return strips
