"""Builds HTML in which everything that is no `Markup` is escaped."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from importlib.resources import files
from typing import TypeAlias
from urllib.parse import quote

from madrob_console.names import terminal_safe
from madrob_console.referee.run import JournalMark


class Markup(str):
    """Finished HTML. Whatever is made of it with str's methods is text again, and escaped."""

    __slots__ = ()


Content: TypeAlias = "str | Iterable[Content]"

NOTHING = Markup()

_MADE_OF = re.compile('<meta name="journal" content="([0-9]{1,9}) ([0-9a-f]{64})">')
_VOID = frozenset({"br", "meta"})
_INLINE = frozenset({"a", "b", "bdi", "del", "small", "span", "strong"})


def page(title: str, *body: Content, style: str = "", journal: JournalMark | None = None) -> str:
    """A whole page without scripts, and nothing from elsewhere.

    Args:
        title: in the browser's tab.
        body: of the page.
        style: CSS for this kind of page, beyond what all have.
        journal: of which it was made, for `made_of`; None = nothing is said of it.
    """
    mark = None if journal is None else f"{journal.lines} {journal.sha256}"
    css = files(__package__).joinpath("report.css").read_text(encoding="utf-8")
    head = element(
        "head",
        element("meta", charset="utf-8"),
        NOTHING if mark is None else element("meta", name="journal", content=mark),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", Markup(css + style)),
    )
    return "<!DOCTYPE html>\n" + element("html", head, element("body", body), lang="en")


def made_of(head: str) -> JournalMark | None:
    """The mark of the journal of which a page was made; None where it does not say.

    Args:
        head: how it begins.
    """
    found = _MADE_OF.search(head)
    return None if found is None else JournalMark(int(found[1]), found[2])


def element(tag: str, *content: Content, **attributes: str) -> Markup:
    """An element with its content; text is escaped.

    Args:
        tag: its name.
        content: text, `Markup`, or any nesting of them.
        attributes: by name; `class_` stands for `class`, and `_` for `-`.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escaped(value)}"'
        for name, value in attributes.items()
    )
    end = "" if tag in _VOID else f"</{tag}>"
    line_end = "" if tag in _INLINE else "\n"
    return Markup(f"<{tag}{given}>{together(content)}{end}{line_end}")


def together(content: Content) -> Markup:
    """Text and markup in one piece."""
    if isinstance(content, Markup):
        return content
    if isinstance(content, str):
        return escaped(content)
    return Markup("".join(together(part) for part in content))


def escaped(text: str) -> Markup:
    """Text from anywhere, without control characters and without power."""
    return Markup(html.escape(terminal_safe(text)))


def said(text: str) -> Markup:
    """Words that somebody typed: whatever their direction of writing, it ends with them."""
    return element("bdi", text)


def table(head: Iterable[Content], rows: Iterable[Iterable[Content]], class_: str) -> Markup:
    """A table whose first column names the rows; a narrow screen shows a row as a card."""
    names = [together(name) for name in head]
    body = []
    for first, *cells in rows:
        named = zip(names[1:], cells, strict=True)
        data = [element("td", cell, data_name=html.unescape(name)) for name, cell in named]
        body.append(element("tr", element("th", first, scope="row"), data))
    heads = element("tr", [element("th", name, scope="col") for name in names])
    return element("table", element("thead", heads), element("tbody", body), class_=class_)


def listed(items: Iterable[Content], nothing: str) -> Markup:
    """A list, or words where it is empty."""
    entries = [element("li", item) for item in items]
    return element("ul", entries) if entries else element("p", nothing)


def section(title: str, *content: Content, name: str = "") -> Markup:
    """A part of the page under a heading; by its name links find it."""
    attributes = {"id": name} if name else {}
    return element("section", element("h2", title), content, **attributes)


def link(target: str, *content: Content) -> Markup:
    """A link to a place on the page, `#name`, or to a file beside it, by its relative path."""
    return element("a", *content, href=target if target.startswith("#") else quote(target))
