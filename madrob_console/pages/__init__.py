"""Pages for people: the report of a run, standings, and a competition's site."""

from __future__ import annotations

from enum import StrEnum


class PictureFormat(StrEnum):
    """How figures are written."""

    PNG = "png"
    SVG = "svg"
