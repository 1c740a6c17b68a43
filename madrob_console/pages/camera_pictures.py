"""Pictures of cameras in a report."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from itertools import groupby

from markupsafe import Markup

from madrob_console.archive.pictures import Picture
from madrob_console.pages.templates import NOTHING, render

Anchors = Mapping[tuple[float, str], str]
"""Anchor of the pictures of an event, by its time and name."""


def pictures(shown: Sequence[Picture]) -> Markup:
    """Return the pictures by moment, embedded in the page."""
    if not shown:
        return NOTHING
    moments = [list(group) for _, group in groupby(shown, key=lambda picture: picture.number)]
    return render("pictures.html", moments=moments, base64=_base64)


def anchors(shown: Sequence[Picture]) -> Anchors:
    return {
        (picture.moment.time, picture.moment.name): f"moment-{picture.number}"
        for picture in shown
        if picture.data
    }


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
