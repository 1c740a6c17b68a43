"""Pages for people: the report of a run, standings, and a competition's site."""

from __future__ import annotations

from enum import StrEnum


class PictureFormat(StrEnum):
    """File format of figures; HTML is one page, whose time axis can be zoomed."""

    PNG = "png"
    SVG = "svg"
    HTML = "html"
