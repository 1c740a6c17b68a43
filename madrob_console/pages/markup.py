"""HTML that is always escaped, and the colours of pages."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import chain, repeat
from typing import TypeAlias
from urllib.parse import quote

from madrob_console.common.names import terminal_safe
from madrob_console.referee.records import JournalMark
from scoring.figures.run_drawings import BAND, BLUE, GREY, ORANGE, RED
from scoring.figures.team_drawings import TimedPhase


class Markup(str):
    """Finished HTML. The results of str's methods are plain text again, and are escaped."""

    __slots__ = ()


Content: TypeAlias = "str | Iterable[Content]"

NOTHING = Markup()

_MADE_OF = re.compile('<meta name="journal" content="([0-9]{1,9}) ([0-9a-f]{64})">')
_TEAM_OF = re.compile('<meta name="team" content="([0-9a-f]{64})">')
_ELEMENT = re.compile("<[^>]*>")
_VOID = frozenset({"br", "img", "meta"})
_INLINE = frozenset({"a", "b", "bdi", "del", "small", "span", "strong"})


def page(
    title: str,
    *body: Content,
    head: Content = NOTHING,
    wide: bool = False,
    journal: JournalMark | None = None,
    team: str = "",
) -> str:
    """A whole page without scripts, and nothing from elsewhere.

    `journal` is the one of which it was made, for `made_of`. `team` is the digest of the team's
    other runs that it names, for `team_of`.
    """
    mark = None if journal is None else f"{journal.lines} {journal.sha256}"
    sheets = ("report.css", "wide.css") if wide else ("report.css",)
    css = "".join(_sheet(name) for name in sheets)
    top = (
        CONTENT_SECURITY_POLICY,
        element("meta", name="team", content=team) if team else NOTHING,
        head,
        NOTHING if mark is None else element("meta", name="journal", content=mark),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", Markup(css)),
    )
    return f"{PAGE_BEGINS}{together(top)}</head>\n{element('body', body)}</html>\n"


PAGE_BEGINS = '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'


@cache
def _sheet(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


SKIP = "main"
"""Anchor of the main part, for the skip link of a wide page."""


def skip_link() -> Markup:
    """A keyboard user's link past the parts that all pages have."""
    return element("a", "Skip to the content", href=f"#{SKIP}", class_="skip")


def made_of(head: str) -> JournalMark | None:
    """Mark of the journal of which a page was made, from its `head`; None = not stated."""
    found = _MADE_OF.search(head)
    return None if found is None else JournalMark(int(found[1]), found[2])


def team_of(head: str) -> str | None:
    """Digest of the team's other runs that a page names, from its `head`; None = not stated."""
    found = _TEAM_OF.search(head)
    return None if found is None else found[1]


def element(tag: str, *content: Content, **attributes: str) -> Markup:
    """An element; text in its content is escaped.

    In the names of attributes `class_` stands for `class`, and `_` for `-`.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escaped(value)}"'
        for name, value in attributes.items()
    )
    end = "" if tag in _VOID else f"</{tag}>"
    line_end = "" if tag in _INLINE else "\n"
    return Markup(f"<{tag}{given}>{together(content)}{end}{line_end}")


def together(content: Content) -> Markup:
    if isinstance(content, Markup):
        return content
    if isinstance(content, str):
        return escaped(content)
    return Markup("".join(together(part) for part in content))


def escaped(text: str) -> Markup:
    """Text from anywhere, escaped and without control characters."""
    return Markup(html.escape(terminal_safe(text)))


CONTENT_SECURITY_POLICY = element(
    "meta",
    http_equiv="Content-Security-Policy",
    content="default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'",
)
"""Tells browsers to load nothing from anywhere, run no script and send no form."""


def said(text: str) -> Markup:
    """Words that a user typed, isolated: their direction of writing ends with them."""
    return element("bdi", text)


def table(
    head: Iterable[Content],
    rows: Iterable[Iterable[Content]],
    class_: str,
    caption: Content = NOTHING,
    marked: Sequence[str] = (),
) -> Markup:
    """A table whose first column names the rows; a narrow screen shows a row as a card.

    `marked` holds the class of each row, or empty text; it may be shorter than the rows.
    """
    names = [together(name) for name in head]
    body = []
    for row, mark in zip(rows, chain(marked, repeat("")), strict=False):
        first, *cells = row
        named = zip(names[1:], cells, strict=True)
        data = [element("td", cell, data_name=_plain(name)) for name, cell in named]
        of = {"class_": mark} if mark else {}
        body.append(element("tr", element("th", first, scope="row"), data, **of))
    heads = element("tr", [element("th", name, scope="col") for name in names])
    told = element("caption", caption) if caption else NOTHING
    return element("table", told, element("thead", heads), element("tbody", body), class_=class_)


def _plain(name: Markup) -> str:
    return html.unescape(_ELEMENT.sub("", name))


def scrolled(what: Markup, name: str) -> Markup:
    """Something wide in a place that scrolls sideways, by the keyboard, too."""
    return element("div", what, class_="scroll", role="region", aria_label=name, tabindex="0")


def listed(items: Iterable[Content], nothing: str) -> Markup:
    """A list, or the words `nothing` where it is empty."""
    entries = [element("li", item) for item in items]
    return element("ul", entries) if entries else element("p", nothing)


def section(title: str, *content: Content, name: str = "") -> Markup:
    """A part of the page under a heading; `name` is its anchor."""
    attributes = {"id": name} if name else {}
    return element("section", element("h2", title), content, **attributes)


def link(target: str, *content: Content) -> Markup:
    """A link to a place on the page, `#name`, or to a file beside it, by its relative path."""
    return element("a", *content, href=target if target.startswith("#") else quote(target))


# Colours of drawings in a page that may be dark: names in place of colours.


_NAMES: Mapping[str, str] = {
    "#ffffff": "paper",
    "#000000": "ink",
    BAND: "band",
    ORANGE: "orange",
    BLUE: "blue",
    RED: "red",
    GREY: "grey",
    **{
        phase.colour: f"phase-{phase.name.lower()}"
        for phase in TimedPhase
        if phase.colour not in (ORANGE, BLUE)
    },
}
"""As `report.css` calls them."""

_COLOUR = re.compile("|".join(_NAMES))
_NAMESPACE = re.compile(r' xmlns(:xlink)?="[^"]*"')


def themed(drawing: str) -> Markup:
    """A drawing of ours (SVG or HTML) with its style colours replaced by the page's."""
    part = _NAMESPACE.sub("", drawing)
    return Markup(_COLOUR.sub(lambda found: f"var(--{_NAMES[found[0]]})", part))
