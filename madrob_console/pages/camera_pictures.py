"""Pictures of cameras in a report, and what flags mean."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import groupby

from madrob_console.archive.folders import PICTURES_FOLDER
from madrob_console.archive.run_pictures import (
    PictureEntry,
    RunPictures,
    difference_words,
    is_far,
    nothing_near,
)
from madrob_console.pages.markup import (
    NOTHING,
    Content,
    Markup,
    element,
    link,
    listed,
    said,
    section,
)
from madrob_console.pages.shared_sections import BIAS_NOTE
from scoring.figures.team_drawings import TimedPhase
from scoring.indicator_table import FigureName, FigurePart, IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import Result
from scoring.rulesets import ruleset

MOST_EMBEDDED = 2_000_000
"""Limit of the characters of all pictures in a page."""

_WIDEST = 60_000  # bytes of one
_SIDES = ((20_000, 480), (9_000, 320), (0, 240))  # from so many bytes for each: pixels

_TOLD = (
    "The frame of each camera that is nearest to what happened, and how far it is from it: -12 ms "
    "is earlier; one that is far off says LATER or EARLIER. Nothing is scored from pictures. "
    "The time of a frame is that of its reception: what it shows was a little earlier."
)

Anchors = Mapping[tuple[float, str], str]
"""Anchor of the pictures of an event, by its time and name."""


def pictures(shown: RunPictures, *, beside: bool = True) -> Markup:
    """The pictures by moment; `beside`: their folder lies beside the page, for links."""
    if not shown:
        return NOTHING
    entries = shown.index.pictures
    share = MOST_EMBEDDED * 3 // 4 // max(1, len(shown.files))
    often = {key: count for key, count in _missing_pictures(shown).items() if count > 1}
    left = (entry for entry in entries if _key(entry, shown) not in often)
    moments = [
        _moment(list(group), shown, share, beside=beside)
        for _, group in groupby(left, key=lambda entry: entry.moment)
    ]
    of = len({entry.moment for entry in entries})
    told_once: list[Content] = [
        (_named(topic), f": no picture at {count} of {of} moments, {why}.")
        for (topic, why), count in often.items()
    ]
    known = [*map(said, shown.index.problems), *told_once]
    problems = listed(known, "") if known else NOTHING
    kept = element("span", f" Larger ones are in the folder {PICTURES_FOLDER}.", class_="beside")
    told = element("p", element("small", _TOLD, kept if beside and shown.files else NOTHING))
    return section("What the cameras saw", told, problems, moments, name="pictures")


def anchors(shown: RunPictures) -> Anchors:
    return {
        (entry.time, entry.event): _moment_anchor(entry)
        for entry in shown.index.pictures
        if entry.file in shown.files
    }


def _named(topic: str) -> Markup:
    return Markup(said(topic).replace("/", "<wbr>/").replace("<<wbr>/", "</"))


def _missing_pictures(shown: RunPictures) -> Counter[tuple[str, str]]:
    return Counter(
        _key(entry, shown) for entry in shown.index.pictures if entry.file not in shown.files
    )


def _key(entry: PictureEntry, shown: RunPictures) -> tuple[str, str]:
    """Camera topic and reason of a missing picture; empty reason = not missing."""
    return entry.topic, "" if entry.file in shown.files else nothing_near(entry)


def _moment(entries: list[PictureEntry], shown: RunPictures, share: int, *, beside: bool) -> Markup:
    first = entries[0]
    title = element("h3", f"{first.since_start:.2f} s: {first.words}")
    figures = [_figure(entry, shown, share, beside=beside) for entry in entries]
    return element(
        "div",
        title,
        element("div", figures, class_="shots"),
        class_="moment",
        id=_moment_anchor(first),
    )


def _moment_anchor(entry: PictureEntry) -> str:
    return f"moment-{entry.moment}"


def _figure(entry: PictureEntry, shown: RunPictures, share: int, *, beside: bool) -> Markup:
    data = shown.files.get(entry.file)
    small = None if data is None else _embedded(entry, data, share)
    if small is None:
        why = nothing_near(entry) or f"the file {entry.file} cannot be read"
        words: Content = (_named(entry.topic), f": no picture, {why}.")
        return element("figure", element("p", words, class_="missing"))
    if beside:
        small = link(f"{PICTURES_FOLDER}/{entry.file}", small)
    return element("figure", small, element("figcaption", list(_caption(entry))))


def _caption(entry: PictureEntry) -> Iterator[Content]:
    far = {"class_": "far"} if is_far(entry) else {}
    yield element("b", difference_words(entry), **far), " ", _named(entry.topic)
    if entry.scale:
        yield element("small", entry.scale)


def _embedded(entry: PictureEntry, data: bytes, share: int) -> Markup | None:
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
    coded = base64.b64encode(small.data).decode()
    return element(
        "img",
        src=f"data:image/jpeg;base64,{coded}",
        alt=_spoken(entry),
        width=str(small.width),
        height=str(small.height),
    )


def _spoken(entry: PictureEntry) -> str:
    ms = round(1000 * abs(entry.difference or 0.0))
    far = f"{ms} ms {'before' if (entry.difference or 0.0) < 0 else 'after'} it" if ms else "at it"
    return f"Camera {entry.topic} at {entry.since_start:.2f} s, {entry.words}; received {far}."


# The meanings of words on a page: the indicators by the protocol, the phases of a run.


PASSAGE = "passage"
"""Anchor of the figure of the passage sensors."""


def anchor(name: IndicatorName) -> str:
    return f"explained-{name}"


def definitions(result: Result) -> Markup:
    rules = ruleset(result.ruleset)
    drawn = result.outcome is not Outcome.ABORTED

    def entries() -> Iterator[Markup]:
        for name in IndicatorName:
            said = rules.explanation(name)
            own = said != name.spec.explanation  # these rules have it otherwise than the protocol
            text = said if own else name.spec.definition
            what: list[Content] = [f"{text[0].upper()}{text[1:]} "]
            what.append(f"In {unit_text(name.spec.unit)}; {name.spec.better} is better.")
            if drawn and (figure := _figure_of(name)) is not None:
                what += " ", link(f"#figure-{figure.number}", f"Figure {figure.number}"), "."
            elif drawn and name is IndicatorName.DOOR_OCCUPATION_TIME:
                what += " ", link(f"#{PASSAGE}", "The passage sensors"), " show it."
            term = element("dt", name.words)
            yield element("div", term, element("dd", what), id=anchor(name))

    ends = [phase.words for phase in TimedPhase if phase.step is not None]
    return section(
        "What the words mean",
        element("dl", entries(), class_="definitions"),
        element(
            "p",
            f"Phases: {', '.join(ends)}. Each ends when its step counts (the six steps), by the "
            "sensors or by the referee; the rest, until the stop, brought no further step.",
        ),
        element("p", BIAS_NOTE),
        name="explained",
    )


def _figure_of(name: IndicatorName) -> FigureName | None:
    whole = (one for one in FigureName if one.spec.part is FigurePart.WHOLE)
    return next((one for one in whole if one.spec.indicator is name), None)
