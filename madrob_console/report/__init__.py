"""What a team takes home of a run: one page, readable on a phone and on paper, and pictures.

Several runs side by side are in standings; figures in the terminal are in ui.
"""

from __future__ import annotations

from enum import StrEnum


class PictureFormat(StrEnum):
    """How figures are written."""

    PNG = "png"
    SVG = "svg"
