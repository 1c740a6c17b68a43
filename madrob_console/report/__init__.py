"""What a team takes home of a run: one page, readable on a phone and on paper, and pictures."""

from __future__ import annotations

from enum import StrEnum

REPORT_FILE = "report.html"
"""In a run folder."""


class PictureFormat(StrEnum):
    """How figures are written."""

    PNG = "png"
    SVG = "svg"
