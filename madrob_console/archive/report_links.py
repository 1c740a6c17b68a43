"""Links of a report, led elsewhere where it stands in another place than it was made for."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from urllib.parse import quote, unquote

_LINK = re.compile(r'<a href="([^"#][^"]*)">([^<]*</a>)?')


def led_elsewhere(page: str, place: Callable[[str], str | None], nowhere: str = "") -> str:
    """A page with other links; those to places on the page itself stay.

    Args:
        page: its text.
        place: where a link leads now, by where it led: relative paths; None = nowhere.
        nowhere: stands behind words that are no link any more.
    """

    def led(found: re.Match[str]) -> str:
        target = place(unquote(html.unescape(found[1])))
        words = found[2] or ""
        if target is None:
            return f"<a>{words}{words and nowhere}"
        return f'<a href="{quote(target)}">{words}'

    return _LINK.sub(led, page)
