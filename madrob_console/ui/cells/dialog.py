"""A question in front of the run, which goes on being drawn behind it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from rich.cells import cell_len
from textual import events
from textual.containers import Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.ui.cells.field import Field
from madrob_console.ui.cells.lines import (
    Line,
    Lines,
    Span,
    Target,
    Tone,
    line,
    paragraph,
    width_of,
)
from madrob_console.ui.keys.questions import Ask, Option, Pick, Question, Sure, Write
from madrob_console.ui.keys.type_ahead import TypeAhead
from madrob_console.ui.look.words import cut_inside


class Drafts:
    """Texts typed into dialogs; those of a refused act are kept until it takes effect.

    Each by what the dialog is about, its opener first, and by the question.
    """

    def __init__(self) -> None:
        self.typed: dict[tuple[str, ...], str] = {}
        self.kept: dict[tuple[str, ...], str] = {}

    def settle(self, name: str, *, refused: bool) -> None:
        """What `name` has asked is answered, and its act was refused or took effect."""
        self.kept = {question: text for question, text in self.kept.items() if question[0] != name}
        self.kept |= self.typed if refused else {}
        self.typed = {}


FreshAsk = Callable[[], Ask | str]
"""What a dialog asks as things stand now, or in words why it asks nothing any more."""

_CLOSES = "Escape closes"
_ANSWER_FIRST = "A question is open: answer it, or Escape closes it."
_YES, _NO = "y", "n"
_OR_NO = "no (also Enter, Escape)"


class Prompt(Lines):
    """Draws a dialog: its title, the answers so far, and the question."""

    def __init__(self, dialog: Dialog) -> None:
        super().__init__()
        self._dialog = dialog

    def take_click(self, target: str, _event: events.Click) -> None:
        self._dialog.take_answer(target)

    def lines(self, width: int) -> Sequence[Line]:
        dialog, rows = self._dialog, self._head(width)
        rows += paragraph(dialog.notice, width, Tone.WARN) if dialog.notice else []
        if dialog.overtaken:
            rows += paragraph(f"NOT POSSIBLE ANY MORE: {dialog.overtaken}", width, Tone.BAD)
            close = Target("Enter", Tone.CAP, _NO), Target(" closes this", Tone.PLAIN, _NO)
            return [*rows, line(*close)]
        if said := ", ".join(filter(None, dialog.answers)):
            rows += paragraph(f"chosen: {said}", width, Tone.WARN)
        match dialog.question:
            case Pick(text, options, listed, below):
                rows += [row for words in listed for row in paragraph(words, width, Tone.WARN)]
                rows += paragraph(text, width) if text else []
                rows += _options(options, dialog.cursor, width)
                rows += [row for words in below for row in paragraph(words, width, Tone.DIM)]
            case Sure(text):
                rows += paragraph(text, width, Tone.STRONG)
                yes = (Target(_YES, Tone.CAP, _YES), Target(" yes", Tone.PLAIN, _YES))
                no = (Target(_NO, Tone.CAP, _NO), Target(f" {_OR_NO}", Tone.PLAIN, _NO))
                rows.append(line(*yes, "   ", *no))
        rows += paragraph(dialog.complaint, width, Tone.BAD) if dialog.complaint else []
        rows += paragraph(dialog.question.text, width) if dialog.writing else []
        return rows

    def _head(self, width: int) -> list[Line]:
        rows = paragraph(self._dialog.ask.title, width, Tone.STRONG)
        for text in filter(None, (self._dialog.about, _CLOSES)):
            if width_of(rows[-1]) + 2 + cell_len(text) <= width:
                rows[-1] = line(*rows[-1], Span(f"  {text}", Tone.DIM))
            elif text is not _CLOSES:
                rows += paragraph(text, width, Tone.DIM)
        return rows


_OF_DIALOG = ("escape", "enter")
"""Keys that a text field leaves to its dialog."""


class Dialog(Vertical):
    """Asks the questions of an `Ask` one after the other; the app sends it every other key.

    Unknown keys do nothing; Escape closes the dialog and never does more. If what it is about
    changes, the dialog changes, says so, and drops keys typed before that could be seen.
    `fresh` gives the questions as things stand; None = nothing can change them. `drafts` are
    texts of acts that were refused. `cursor` is the option that Enter takes, -1 = none.
    `overtaken` says why nothing can be answered any more; empty = it can.
    """

    @dataclass
    class Answered(Message):
        """All questions are answered."""

        dialog: Dialog

    @dataclass
    class Closed(Message):
        """The referee left it, by `escape` or by an answer that does nothing."""

        dialog: Dialog
        escape: bool = False

    @dataclass
    class Passed(Message):
        """A key that was typed after Escape: it is for the pane."""

        key: events.Key

    @dataclass
    class TooLate(Message):
        """An answer came when nothing could be answered any more; a `confirmed` one was y."""

        dialog: Dialog
        confirmed: bool

    def __init__(
        self,
        name: str,
        ask: Ask,
        about: str = "",
        fresh: FreshAsk | None = None,
        ahead: TypeAhead | None = None,
        drafts: Drafts | None = None,
    ) -> None:
        self._prompt = Prompt(self)
        self._field = Field(select_on_focus=False)
        super().__init__(self._prompt, self._field, name=name)
        self.about = about
        self._drafts = drafts or Drafts()
        self.ask = ask
        self._fresh = fresh
        self._ahead = ahead or TypeAhead()
        self._open = list(ask.questions)
        self.question = ask.questions[0]
        self.answers: list[str] = []
        self.cursor = 0
        self.notice = self.overtaken = self.complaint = ""
        self._escaped = self._left = self._ended = False

    def on_mount(self) -> None:
        self._show()

    def take_input(self, event: events.Key | events.Paste) -> None:
        """A key, or what was pasted, whatever has the focus; in turn, also before it is drawn."""
        key = event.key if isinstance(event, events.Key) else ""
        if self.writing and not self._escaped and key not in _OF_DIALOG:
            self._field.post_message(event)
        elif key:
            self._escaped |= key == "escape"
            self.post_message(event)

    @property
    def writing(self) -> bool:
        return isinstance(self.question, Write) and not self.overtaken

    def end(self) -> None:
        """Removes it; a key that still waits for it may not take the focus to what is gone."""
        self._ended = True
        self.remove()

    def _take_focus(self) -> None:
        if not self._ended:
            self.screen.set_focus(self._field if self.writing else None)

    def look_again(self) -> None:
        if self._fresh is None or not (self._open or self.overtaken):
            return
        fresh = self._fresh()
        if isinstance(fresh, str):
            if fresh != self.overtaken:
                self._change(fresh)
            return
        before, self.ask = self.ask, fresh
        same = _without_words(fresh) == _without_words(before)
        if not same or fresh.questions != before.questions:
            self._take_questions(before, fresh)
            self._prompt.redraw()
        if not same or self.overtaken:
            self._change("")

    def _take_questions(self, before: Ask, now: Ask) -> None:
        """Takes other questions; keeps the answers so far that also answer these."""
        answered = len(now.questions) - len(self._open)
        alike = [*map(_kind, before.questions)] == [*map(_kind, now.questions)]
        if not alike or before.title != now.title:
            self._open, self.answers = list(now.questions), []
            self._show()
            return
        free = isinstance(self._open[0], Write) and isinstance(now.questions[answered], Pick)
        self._open = [*self._open[:free], *now.questions[answered + free :]]
        self.question = self._open[0]

    def _change(self, overtaken: str) -> None:
        self.overtaken, self.complaint = overtaken, ""
        self.notice = "" if overtaken else "This has changed meanwhile: look again."
        self._field.display = self.writing
        self._ahead.replaced("the question has just changed")
        self._prompt.redraw()
        self._take_focus()

    def complain(self, words: str) -> None:
        self.complaint = words
        self._prompt.redraw()

    def ask_again(self, words: str) -> bool:
        """Says what is wrong with the last answer, if that was a text; returns whether it was."""
        if self._open or not isinstance(self.question, Write):
            return False
        self._open = [self.question]
        self.answers.pop()
        self.complain(words)
        return True

    def on_key(self, event: events.Key) -> None:
        """Handles what the question knows; nothing goes on to the keys of the console."""
        event.stop()
        event.prevent_default()
        if self._left:
            self.post_message(self.Passed(event))
            return
        if (words := self._ahead.leaves_out(event)) is not None:
            self.complain(words)
            return
        if event.key == "escape":
            self._left = True
            self.post_message(self.Closed(self, escape=True))
        elif self.overtaken:
            self.take_answer(event.key)
        elif not self.writing:
            self._pick(event)
        elif event.key == "enter":
            self._take_text(self._field.value)

    def _pick(self, event: events.Key) -> None:
        enter = event.key == "enter"
        match self.question:
            case Pick(_, options) if event.key in ("up", "down"):
                step = 1 if event.key == "down" else -1
                listed = sum(bool(option.label) for option in options)
                self.cursor = (max(self.cursor, -step - 1) + step) % listed
                self._prompt.redraw()
            case Pick() if enter and self.cursor < 0:
                self.complain("Press the key of an answer, or choose one with the arrows.")
            case Pick(_, options) if enter and options[self.cursor].last:
                self.complain(f"Only {options[self.cursor].key} itself does that.")
            case Pick(_, options) if enter:
                self._choose(options[self.cursor])
            case _ if not any(  # with caps lock, too
                self.take_answer("enter" if enter else key)
                for key in (event.character or "", (event.character or "").lower())
            ):
                self._mistyped(event)

    def take_answer(self, key: str) -> bool:
        """Takes what a key answers; False if it answers nothing."""
        no = key in ("enter", _NO)
        match self.question:
            case _ if self.overtaken and not no:
                self.post_message(self.TooLate(self, confirmed=key == _YES))
            case question if no and (self.overtaken or isinstance(question, Sure)):
                self.post_message(self.Closed(self))
            case Sure() if key == _YES:
                self._next()
            case Pick(_, options) if key in (keys := [option.key for option in options]):
                self._choose(options[keys.index(key)])
            case Pick() if key == _NO:  # "no" in every question, and there nothing is done
                self.post_message(self.Closed(self))
            case _:
                return False
        return True

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self._take_text(event.value)

    def _take_text(self, value: str) -> None:
        text = " ".join(value.split())
        if not text and isinstance(self.question, Write) and self.question.missing:
            self.complain(self.question.missing)
        else:
            self._next(text)

    def _mistyped(self, event: events.Key) -> None:
        """A letter that answers nothing may begin a text, whose letters are no answers either."""
        letter = "Space" if event.key == "space" else event.character or ""
        if len(letter) == 1 and letter.isalpha():
            self._ahead.mistyped(letter)
        words = f"{letter} is not possible here" if event.is_printable else _ANSWER_FIRST
        self.complain(words)

    def _choose(self, chosen: Option) -> None:
        if not self._open:
            return  # as in `_next`
        if chosen.free:
            self._open[0] = Write(chosen.label.capitalize(), missing="a reason is needed")
            self._show()
        elif chosen.value is None:
            self.post_message(self.Closed(self))
        else:
            if chosen.last:
                del self._open[1:]
            self._next(chosen.value)

    def _next(self, answer: str | None = None) -> None:
        if not self._open:
            return  # keys that were typed faster than the screen changes
        answered = self._open.pop(0)
        if answer is not None:
            self.answers.append(answer)
            if isinstance(answered, Write):
                self._drafts.typed[self._draft_key(answered)] = answer
        if not self._open:
            self.post_message(self.Answered(self))
            return
        if isinstance(answered, Pick) and isinstance(self._open[0], Write):
            self._ahead.asked()
        self._show()

    def _show(self) -> None:
        question = self.question = self._open[0]
        self.cursor = question.marked if isinstance(question, Pick) else 0
        self.complaint = self.notice = ""
        self._field.display = isinstance(question, Write)
        self._field.value = ""
        if isinstance(question, Write):
            draft = self._drafts.kept.get(self._draft_key(question))
            self._field.value = draft or question.initial
        self._prompt.redraw()
        self._take_focus()

    def _draft_key(self, question: Write) -> tuple[str, ...]:
        return (self.name or "", self.about, self.ask.title, question.text)


def _kind(question: Question) -> object:
    return question.options if isinstance(question, Pick) else type(question)


def _without_words(ask: Ask) -> tuple[object, ...]:
    """Title and questions, without the words beside the same options: sensors change those."""
    questions = (
        replace(question, text="", below=()) if isinstance(question, Pick) else question
        for question in ask.questions
    )
    return (ask.title, *questions)


_BESIDE = 3
"""Cells between two options of one row."""
_MOST_ROWS = 3
"""Options that need more rows than this, side by side, have a row each."""


def _options(options: Sequence[Option], cursor: int, width: int) -> list[Line]:
    """Side by side where three rows hold them all, else one a row."""
    cells = [
        _option(option, width, at_cursor=at == cursor)
        for at, option in enumerate(options)
        if option.label
    ]
    rows: list[Line] = []
    for cell in cells:
        if rows and width_of(rows[-1]) + _BESIDE + width_of(cell) <= width:
            rows[-1] = (*rows[-1], Span(" " * _BESIDE), *cell)
        else:
            rows.append(cell)
    return rows if len(rows) <= _MOST_ROWS else cells


def _option(option: Option, width: int, *, at_cursor: bool) -> Line:
    tone = Tone.CURSOR if at_cursor else Tone.PLAIN
    cap = "Space" if option.key == " " else option.key
    return line(
        Target("> " if at_cursor else "  ", Tone.STRONG, option.key),
        Target(cap, Tone.CAP, option.key),
        Target(" ", Tone.PLAIN, option.key),
        Target(cut_inside(option.label, width - 3 - len(cap)), tone, option.key),
    )
