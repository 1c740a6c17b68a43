"""Pictures of cameras in a report."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

from markupsafe import Markup

from madrob_console.archive.folders import PICTURES_FOLDER
from madrob_console.archive.run_pictures import (
    NO_PILLOW,
    PictureEntry,
    RunPictures,
    difference_words,
    has_pillow,
    is_far,
    nothing_near,
)
from madrob_console.pages.templates import NOTHING, render

MOST_EMBEDDED = 2_000_000
"""Limit of the characters of all pictures in a page."""

_WIDEST = 60_000  # bytes of one
_SIDES = ((20_000, 480), (9_000, 320), (0, 240))  # from so many bytes for each: pixels

_LOOK = 16  # pixels of a side, to compare what pictures show
_ALIKE = 12  # of 255 grey values: more is another view, less is noise

Anchors = Mapping[tuple[float, str], str]
"""Anchor of the pictures of an event, by its time and name."""


class _Embedded(NamedTuple):
    base64: str
    spoken: str
    width: int
    height: int


def pictures(shown: RunPictures, *, beside: bool = True) -> Markup:
    """The pictures by moment; `beside`: their folder lies beside the page, for links."""
    if not shown:
        return NOTHING
    entries = shown.index.pictures
    share = MOST_EMBEDDED * 3 // 4 // max(1, len(shown.files))
    missing = Counter(_key(entry, shown) for entry in entries if entry.file not in shown.files)
    often = {key: count for key, count in missing.items() if count > 1}
    left = (entry for entry in entries if _key(entry, shown) not in often)
    return render(
        "pictures.html",
        shown=shown,
        beside=beside,
        folder=PICTURES_FOLDER,
        problems=shown.index.problems,
        often=[(*key, count) for key, count in often.items()],
        moments_in_all=len({entry.moment for entry in entries}),
        moments=[
            (alike, [_figure(entry, shown, share) for entry in alike[0]])
            for alike in _alike_moments(left, shown)
        ],
        is_far=is_far,
        difference_words=difference_words,
    )


def _alike_moments(
    entries: Iterable[PictureEntry], shown: RunPictures
) -> list[list[list[PictureEntry]]]:
    """The pictures of each moment; moments that look alike, one after the other, are together.

    What a referee has marked always has its own.
    """
    moments: list[list[list[PictureEntry]]] = []
    looks: list[bytes | None] = []
    for _, group in groupby(entries, key=lambda entry: entry.moment):
        same = list(group)
        before, looks = looks, [_look(shown.files.get(entry.file)) for entry in same]
        marked = same[0].event.startswith(("incident", "false_start", "protest"))
        if marked or not (moments and _look_alike(before, looks)):
            moments.append([same])
        else:
            moments[-1].append(same)
    return moments


def _look(data: bytes | None) -> bytes | None:
    """A picture as few grey values; None where there is none."""
    if data is None or not has_pillow():
        return None
    from madrob_console.archive.picture import PictureError, opened  # it loads Pillow

    try:
        return opened(data).convert("L").resize((_LOOK, _LOOK)).tobytes()
    except PictureError:
        return None


def _look_alike(some: Sequence[bytes | None], others: Sequence[bytes | None]) -> bool:
    return len(some) == len(others) and all(
        before and after and max(abs(a - b) for a, b in zip(before, after, strict=True)) <= _ALIKE
        for before, after in zip(some, others, strict=True)
    )


def anchors(shown: RunPictures) -> Anchors:
    return {
        (entry.time, entry.event): f"moment-{entry.moment}"
        for entry in shown.index.pictures
        if entry.file in shown.files
    }


def _key(entry: PictureEntry, shown: RunPictures) -> tuple[str, str]:
    """Camera topic and reason of a missing picture; empty reason = not missing."""
    return entry.topic, "" if entry.file in shown.files else nothing_near(entry)


def _figure(
    entry: PictureEntry, shown: RunPictures, share: int
) -> tuple[PictureEntry, _Embedded | None, str]:
    """The picture, or why there is none."""
    data = shown.files.get(entry.file)
    if not has_pillow():
        return entry, None, nothing_near(entry) or NO_PILLOW
    small = None if data is None else _embedded(entry, data, share)
    return entry, small, nothing_near(entry) or f"the file {entry.file} cannot be read"


def _embedded(entry: PictureEntry, data: bytes, share: int) -> _Embedded | None:
    """The picture within the page; None where the file holds none any more."""
    from madrob_console.archive.picture import (
        PictureError,
        jpeg,
        opened,  # it loads Pillow
    )

    side = next(side for least, side in _SIDES if share >= least)
    try:
        small = jpeg(opened(data, side), max(1000, min(_WIDEST, share)))
    except PictureError:
        return None
    return _Embedded(
        base64.b64encode(small.data).decode(), _spoken(entry), small.width, small.height
    )


def _spoken(entry: PictureEntry) -> str:
    ms = round(1000 * abs(entry.difference or 0.0))
    far = f"{ms} ms {'before' if (entry.difference or 0.0) < 0 else 'after'} it" if ms else "at it"
    return f"Camera {entry.topic} at {entry.since_start:.2f} s, {entry.words}; received {far}."
