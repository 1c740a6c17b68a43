"""What a team takes home of a run: one page, readable on a phone and on paper, and pictures."""

from __future__ import annotations

from enum import StrEnum


class PictureFormat(StrEnum):
    """How figures are written."""

    PNG = "png"
    SVG = "svg"
