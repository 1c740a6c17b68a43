"""A page of HTML taken apart."""

from __future__ import annotations

from collections.abc import Mapping
from html.parser import HTMLParser

_VOID = {"meta", "br"}


class Page(HTMLParser):
    """A page taken apart; every element must be closed where it was opened."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words: list[tuple[tuple[str, ...], str]] = []
        self.rows: list[str] = []
        self._open: list[str] = []
        self.feed(page)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag == "tr":
            self.rows.append("")
        if tag not in _VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert "svg" in self._open, f"<{tag}/> outside of a picture"
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append((tuple(self._open), data))
        if "tr" in self._open:
            self.rows[-1] += data

    def found(self, name: str) -> list[str]:
        """The values of an attribute."""
        return [value for attribute, value in self.attributes if attribute == name]

    @property
    def text(self) -> str:
        """All words, on one line."""
        shown = (data for tags, data in self.words if "style" not in tags)
        return " ".join("".join(shown).split())

    def part(self, name: str) -> str:
        """All words within elements of a kind, or from a heading to the next one."""
        if name == name.lower():
            return " ".join("".join(data for tags, data in self.words if name in tags).split())
        titles = [data for tags, data in self.words if tags[-1:] == ("h2",)]
        after = self.text[self.text.index(name) + len(name) :]
        later = [after.index(t) for t in titles[titles.index(name) + 1 :] if t in after]
        return after[: min(later, default=len(after))].strip()

    def tells(self, told: Mapping[str, tuple[str, ...]]) -> None:
        """Whether each part has all its words."""
        missing = [
            (part, w) for part, words in told.items() for w in words if w not in self.part(part)
        ]
        assert not missing, missing
