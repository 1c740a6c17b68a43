"""A dialog at the bottom of the screen, its text fields and drafts; the run stays in view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from rich.cells import cell_len
from textual import events
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.common.names import terminal_safe
from madrob_console.referee.acts.act import Ask, Option, Pick, Question, Sure, Write
from madrob_console.ui.cells.lines import Line, Lines, Span, Target, Tone, line, paragraph, width_of
from madrob_console.ui.keys.console_app import TypeAhead
from madrob_console.ui.keys.dialogs import Intent
from madrob_console.ui.look.words import cut_inside

# Drafts of refused acts, offered again when the same is asked of the same run.


class DraftKey(NamedTuple):
    """A question for a text; `name` is the opener's, `about` the run and the dialog's title."""

    name: str
    about: str
    question: str


class Drafts:
    """Texts typed into dialogs; those of a refused act are kept until it takes effect."""

    def __init__(self) -> None:
        self.typed: dict[DraftKey, str] = {}
        self.kept: dict[DraftKey, str] = {}

    def settle(self, name: str, *, refused: bool) -> None:
        """What `name` has asked is answered, and its act was refused or took effect."""
        self.kept = {asked: text for asked, text in self.kept.items() if asked.name != name}
        if refused:
            self.kept |= self.typed
        self.typed = {}


# A text field on one line that does not blink.


_EDITING = ("cursor_", "home", "end", "delete_")
_OF_NUMBERS = "0123456789.,+-eE "


class Field(Input):
    """A compact input; pasted line breaks become blanks instead of cutting the text."""

    def __init__(self, *, id: str | None = None, select_on_focus: bool = True) -> None:  # noqa: A002 - textual's name
        super().__init__(id=id, select_on_focus=select_on_focus, compact=True)
        self.cursor_blink = False

    async def _on_key(self, event: events.Key) -> None:
        # textual lets the screen see these keys first: a letter typed meanwhile would overtake them
        for binding in self._bindings.key_to_bindings.get(event.key, ()):
            if binding.action.startswith(_EDITING):
                event.prevent_default()
                event.stop()
                await self.run_action(binding.action)
                return
        await super()._on_key(event)

    def on_blur(self) -> None:
        """Shows the beginning of a long text; coming back selects it all."""
        if self.select_on_focus:
            self.cursor_position = 0

    def _on_paste(self, event: events.Paste) -> None:
        # Input itself keeps only the first line: what follows would be lost without a word
        text = terminal_safe(event.text.strip())
        if text:
            self.replace(text, *self.selection)
        event.prevent_default()
        event.stop()


class NumberField(Field):
    """A field that refuses letters, and says so."""

    class Refused(Message):
        """A letter was typed into the field of that name."""

        def __init__(self, field: str, letter: str) -> None:
            super().__init__()
            self.field = field
            self.letter = letter

    async def _on_key(self, event: events.Key) -> None:
        char = event.character
        if event.is_printable and char is not None and char not in _OF_NUMBERS:
            event.prevent_default()
            event.stop()
            self.post_message(self.Refused((self.id or "").replace("-", " "), char))
            return
        await super()._on_key(event)


FreshAsk = Callable[[], Ask[Intent] | str]
"""What a dialog asks as things stand now, or in words why it asks nothing any more."""

_CLOSES = "Escape closes"
_YES, _NO = "y", "n"
_OR_NO = "no (also Enter, Escape)"


class Prompt(Lines, can_focus=True):
    """Title, answers so far, and the question; `cursor` is the option that Enter takes."""

    class Clicked(Message):
        """The mouse chose an answer, by its key."""

        def __init__(self, key: str) -> None:
            super().__init__()
            self.key = key

    def __init__(self, title: str, about: str) -> None:
        super().__init__()
        self.title = title
        self._about = about
        self.question: Question | None = None
        self.answers: tuple[str, ...] = ()
        self.cursor = 0
        self.notice = ""
        self.overtaken = ""
        self.complaint = ""

    def check_consume_key(self, key: str, character: str | None) -> bool:
        """No letter goes on to the keys of the console."""
        return character is not None

    def on_click(self, event: events.Click) -> None:
        if (hit := self.clicked(event)) is not None:
            self.post_message(self.Clicked(hit[0]))

    def lines(self, width: int) -> Sequence[Line]:
        rows = self._head(width)
        if self.notice:
            rows += paragraph(self.notice, width, Tone.WARN)
        if self.overtaken:
            rows += paragraph(f"NOT POSSIBLE ANY MORE: {self.overtaken}", width, Tone.BAD)
            rows.append(
                line(Target("Enter", Tone.CAP, _NO), Target(" closes this", Tone.PLAIN, _NO))
            )
            return rows
        if said := ", ".join(filter(None, self.answers)):
            rows += paragraph(f"chosen: {said}", width, Tone.WARN)
        match self.question:
            case Pick(text, options, listed, below):
                rows += [row for words in listed for row in paragraph(words, width, Tone.WARN)]
                rows += paragraph(text, width) if text else []
                rows += _options(options, self.cursor, width)
                rows += [row for words in below for row in paragraph(words, width, Tone.DIM)]
            case Sure(text):
                rows += paragraph(text, width, Tone.STRONG)
                yes = (Target(_YES, Tone.CAP, _YES), Target(" yes", Tone.PLAIN, _YES))
                no = (Target(_NO, Tone.CAP, _NO), Target(f" {_OR_NO}", Tone.PLAIN, _NO))
                rows.append(line(*yes, "   ", *no))
        if self.complaint:
            rows += paragraph(self.complaint, width, Tone.BAD)
        if isinstance(self.question, Write):
            rows += paragraph(self.question.text, width)
        return rows

    def _head(self, width: int) -> list[Line]:
        rows = paragraph(self.title, width, Tone.STRONG)
        for text in filter(None, (self._about, _CLOSES)):
            if width_of(rows[-1]) + 2 + cell_len(text) <= width:
                rows[-1] = line(*rows[-1], Span(f"  {text}", Tone.DIM))
            elif text is not _CLOSES:
                rows += paragraph(text, width, Tone.DIM)
        return rows


class Dialog(Vertical):
    """Asks the questions of an `Ask` one after the other.

    Unknown keys do nothing; Escape closes the dialog and never does more. If what it is about
    changes, the dialog changes, says so, and drops keys typed before that could be seen.
    `fresh` gives the questions as things stand; None = nothing can change them. `drafts` are
    texts of acts that were refused.
    """

    class Answered(Message):
        """All questions are answered."""

        def __init__(self, dialog: Dialog, answers: tuple[str, ...]) -> None:
            super().__init__()
            self.dialog = dialog
            self.answers = answers

    class Closed(Message):
        """The referee left it."""

        def __init__(self, dialog: Dialog) -> None:
            super().__init__()
            self.dialog = dialog

    class TooLate(Message):
        """An answer came when nothing could be answered any more; a `confirmed` one was y."""

        def __init__(self, dialog: Dialog, *, confirmed: bool) -> None:
            super().__init__()
            self.dialog = dialog
            self.confirmed = confirmed

    def __init__(
        self,
        name: str,
        ask: Ask[Intent],
        about: str = "",
        fresh: FreshAsk | None = None,
        ahead: TypeAhead | None = None,
        drafts: Drafts | None = None,
    ) -> None:
        super().__init__(name=name)
        self._about = about
        self._drafts = drafts or Drafts()
        self.ask = ask
        self._fresh = fresh
        self._ahead = ahead or TypeAhead()
        self._open = list(ask.questions)
        self._answers: list[str] = []
        self._prompt = Prompt(ask.title, about)
        self._field = Field(select_on_focus=False)
        self.trap_focus()

    def compose(self) -> ComposeResult:
        yield self._prompt
        yield self._field

    def on_mount(self) -> None:
        self._show()

    @property
    def answers(self) -> tuple[str, ...]:
        return tuple(self._answers)

    @property
    def overtaken(self) -> str:
        """Why nothing can be answered any more; empty = it can."""
        return self._prompt.overtaken

    def take_focus(self) -> None:
        writing = isinstance(self._prompt.question, Write) and not self.overtaken
        self.screen.set_focus(self._field if writing else self._prompt)

    def look_again(self) -> None:
        if self._fresh is None or not (self._open or self.overtaken):
            return
        found, prompt = self._fresh(), self._prompt
        if isinstance(found, str):
            if found != prompt.overtaken:
                self._changed(found)
            return
        before, self.ask = self.ask, found
        same = _without_words(found) == _without_words(before)
        if same and not prompt.overtaken:
            if found.questions != before.questions:
                self._take_questions(before, found)
                prompt.redraw()
            return
        if not same:
            self._take_questions(before, found)
        self._changed("")

    def _take_questions(self, before: Ask[Intent], now: Ask[Intent]) -> None:
        """Takes other questions; keeps the answers so far that also answer these."""
        asked = len(now.questions) - len(self._open)
        alike = [*map(_kind, before.questions)] == [*map(_kind, now.questions)]
        if not alike or before.title != now.title:
            self._open, self._answers = list(now.questions), []
            self._show()
            return
        free = isinstance(self._open[0], Write) and isinstance(now.questions[asked], Pick)
        self._open = (
            [*self._open[:1], *now.questions[asked + 1 :]] if free else list(now.questions[asked:])
        )
        self._prompt.question = self._open[0]

    def _changed(self, overtaken: str) -> None:
        prompt = self._prompt
        prompt.title, prompt.overtaken, prompt.complaint = self.ask.title, overtaken, ""
        prompt.notice = "" if overtaken else "This has changed meanwhile: look again."
        self._field.display = isinstance(prompt.question, Write) and not overtaken
        self._ahead.replaced("the question has just changed")
        prompt.redraw()
        self.take_focus()

    def complain(self, words: str) -> None:
        self._prompt.complaint = words
        self._prompt.redraw()

    def ask_again(self, words: str) -> bool:
        """Says what is wrong with the last answer, if that was a text; returns whether it was."""
        question = self._prompt.question
        if self._open or not isinstance(question, Write):
            return False
        self._open = [question]
        self._answers.pop()
        self.complain(words)
        return True

    def on_key(self, event: events.Key) -> None:
        """Handles what the question knows; nothing goes on to the keys of the console."""
        if self._field.has_focus and event.key not in ("escape", "enter"):
            return  # it moves and deletes in the text
        event.stop()
        event.prevent_default()
        if (words := self._ahead.leaves_out(event)) is not None:
            self.complain(words)
            return
        match self._prompt.question:
            case _ if event.key == "escape":
                self.post_message(self.Closed(self))
            case _ if self.overtaken:
                self._answer_too_late(event.key)
            case Write():
                self._late(event)
            case Pick(_, options):
                self._pick(event, options)
            case Sure():
                self._decide(event)

    def on_prompt_clicked(self, event: Prompt.Clicked) -> None:
        event.stop()
        match self._prompt.question:
            case _ if self.overtaken:
                self.post_message(self.Closed(self))
            case Pick(_, options):
                self._choose(next(option for option in options if option.key == event.key))
            case Sure() if event.key == _YES:
                self._next()
            case Sure():
                self.post_message(self.Closed(self))

    def _answer_too_late(self, key: str) -> None:
        if key in ("enter", _NO):
            self.post_message(self.Closed(self))
        else:
            self.post_message(self.TooLate(self, confirmed=key == _YES))

    def _late(self, event: events.Key) -> None:
        """Takes keys that were typed before the text field had the focus."""
        if event.key == "enter":
            self._text(self._field.value)
        elif event.is_printable and event.character:
            self._field.insert_text_at_cursor(event.character)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self._text(event.value)

    def _text(self, value: str) -> None:
        text = " ".join(value.split())
        question = self._prompt.question
        if not text and isinstance(question, Write) and question.missing:
            self.complain(question.missing)
            return
        self._next(text)

    def _pick(self, event: events.Key, options: tuple[Option, ...]) -> None:
        prompt = self._prompt
        if event.key in ("up", "down"):
            step = 1 if event.key == "down" else -1
            listed = sum(bool(option.label) for option in options)
            prompt.cursor = (max(prompt.cursor, -step - 1) + step) % listed
            prompt.redraw()
            return
        chosen = next((o for o in options if o.key == event.character), None)
        if event.key == "enter":
            if prompt.cursor < 0:
                self.complain("Press the key of an answer, or choose one with the arrows.")
                return
            chosen = options[prompt.cursor]
        if chosen is not None:
            self._choose(chosen)
        else:
            self._mistyped(event)

    def _decide(self, event: events.Key) -> None:
        if event.key == _YES:
            self._next()
        elif event.key in (_NO, "enter"):
            self.post_message(self.Closed(self))
        else:
            self._mistyped(event)

    def _mistyped(self, event: events.Key) -> None:
        """A letter that answers nothing may begin a text, whose letters are no answers either."""
        letter = event.character or ""
        if letter.isalpha():
            self._ahead.mistyped(letter)
        if event.is_printable:
            self.complain(f"'{letter}' is no answer here")

    def _choose(self, chosen: Option) -> None:
        if chosen.free:
            self._open[0] = Write(chosen.label.capitalize(), missing="a reason is needed")
            self._show()
        elif chosen.value is None:
            self.post_message(self.Closed(self))
        else:
            self._next(chosen.value)

    def _next(self, answer: str | None = None) -> None:
        if not self._open:
            return  # keys that were typed faster than the screen changes
        answered = self._open.pop(0)
        if answer is not None:
            self._answers.append(answer)
            if isinstance(answered, Write):
                self._drafts.typed[self._asked(answered)] = answer
        if not self._open:
            self.post_message(self.Answered(self, tuple(self._answers)))
            return
        if isinstance(answered, Pick) and isinstance(self._open[0], Write):
            self._ahead.asked()
        self._show()

    def _show(self) -> None:
        prompt, question = self._prompt, self._open[0]
        prompt.question, prompt.answers = question, tuple(self._answers)
        prompt.cursor = question.marked if isinstance(question, Pick) else 0
        prompt.complaint = prompt.notice = ""
        self._field.display = isinstance(question, Write)
        self._field.value = self._initial(question) if isinstance(question, Write) else ""
        prompt.redraw()
        self.take_focus()

    def _initial(self, question: Write) -> str:
        return self._drafts.kept.get(self._asked(question)) or question.initial

    def _asked(self, question: Write) -> DraftKey:
        return DraftKey(self.name or "", f"{self._about} {self.ask.title}", question.text)


def _kind(question: Question) -> object:
    return question.options if isinstance(question, Pick) else type(question)


def _without_words(ask: Ask[Intent]) -> tuple[object, ...]:
    """Title and questions, without the words beside the same options: sensors change those."""
    asked = (
        replace(one, text="", below=()) if isinstance(one, Pick) else one for one in ask.questions
    )
    return (ask.title, *asked)


_BESIDE = 3
"""Cells between two options of one row."""
_MOST_ROWS = 2
"""Options that need more rows than this, side by side, have a row each."""


def _options(options: Sequence[Option], cursor: int, width: int) -> list[Line]:
    """Side by side where two rows hold them all, else one a row."""
    cells = [
        _option(one, width, at_cursor=at == cursor) for at, one in enumerate(options) if one.label
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
    return line(
        Target("> " if at_cursor else "  ", Tone.STRONG, option.key),
        Target(option.key, Tone.CAP, option.key),
        Target(" ", Tone.PLAIN, option.key),
        Target(cut_inside(option.label, width - 4), tone, option.key),
    )
