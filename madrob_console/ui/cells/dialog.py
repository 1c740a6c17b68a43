"""A dialog at the bottom of the screen: the run stays in view and goes on."""

from __future__ import annotations

from collections.abc import Sequence

from textual import events
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.referee.questions import Ask, Option, Pick, Question, Sure, Write
from madrob_console.ui.cells.field import Field
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line, paragraph
from madrob_console.ui.keys.asks import Intent


class Prompt(Lines, can_focus=True):
    """Title, answers so far, and the question."""

    def __init__(self, ask: Ask[Intent], about: str) -> None:
        super().__init__()
        self._title = ask.title
        self._about = about
        self.question: Question | None = None
        self.answers: tuple[str, ...] = ()
        self.cursor = 0
        self.complaint = ""

    def check_consume_key(self, key: str, character: str | None) -> bool:
        """No letter goes on to the keys of the console."""
        return character is not None

    def lines(self, width: int) -> Sequence[Line]:
        """All rows but the text field."""
        rows = paragraph(self._title, width, Tone.STRONG)
        if self._about:
            rows[-1] = line(*rows[-1], Span(f"  {self._about}", Tone.DIM))
        if said := ", ".join(filter(None, self.answers)):
            rows.append(line(Span(f"chosen: {said}", Tone.WARN)))
        match self.question:
            case Pick(text, options):
                rows += paragraph(text, width)
                rows += [
                    _option(option, number == self.cursor) for number, option in enumerate(options)
                ]
                rows.append(_hint("its key, or arrows and Enter; Escape closes: nothing happens"))
            case Sure(text):
                rows += paragraph(text, width, Tone.STRONG)
                no = (Span("n", Tone.CAP), " no (also Enter, Escape)")
                rows.append(line(Span("y", Tone.CAP), " yes   ", *no))
            case Write(text):
                rows.append(_hint("Enter goes on; Escape closes: nothing happens"))
                if self.complaint:
                    rows += paragraph(self.complaint, width, Tone.BAD)
                rows += paragraph(text, width)
        return rows


class Dialog(Vertical):
    """Asks the questions of an `Ask` one after the other.

    The keys that it does not know do nothing; Escape closes it and never does more.
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

    def __init__(self, name: str, ask: Ask[Intent], about: str = "") -> None:
        super().__init__(name=name)
        self.ask = ask
        self._open = list(ask.questions)
        self._answers: list[str] = []
        self._prompt = Prompt(ask, about)
        self._field = Field(select_on_focus=False)
        self.trap_focus()

    def compose(self) -> ComposeResult:
        """The prompt and a text field for questions that need one."""
        yield self._prompt
        yield self._field

    def on_mount(self) -> None:
        """Ask the first question."""
        self._show()

    def take_focus(self) -> None:
        """Where typing goes now."""
        writing = isinstance(self._prompt.question, Write)
        self.screen.set_focus(self._field if writing else self._prompt)

    def on_key(self, event: events.Key) -> None:
        """Only what the question knows; nothing goes on to the keys of the console."""
        event.stop()
        event.prevent_default()
        match self._prompt.question:
            case _ if event.key == "escape":
                self.post_message(self.Closed(self))
            case Write():
                self._late(event)
            case Pick(_, options):
                self._pick(event, options)
            case Sure() if event.key == "y":
                self._next()
            case Sure() if event.key in ("n", "enter"):
                self.post_message(self.Closed(self))

    def _late(self, event: events.Key) -> None:
        """Keys that were typed before the text field had the focus."""
        if event.key == "enter":
            self._text(self._field.value)
        elif event.is_printable and event.character:
            self._field.insert_text_at_cursor(event.character)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """A text is typed."""
        event.stop()
        self._text(event.value)

    def _text(self, value: str) -> None:
        text = " ".join(value.split())
        question = self._prompt.question
        if not text and isinstance(question, Write) and question.missing:
            self._prompt.complaint = question.missing
            self._prompt.redraw()
            return
        self._next(text)

    def _pick(self, event: events.Key, options: tuple[Option, ...]) -> None:
        prompt = self._prompt
        if event.key in ("up", "down"):
            prompt.cursor = (prompt.cursor + (1 if event.key == "down" else -1)) % len(options)
            prompt.redraw()
            return
        by_key = next((o for o in options if o.key == event.character), None)
        chosen = options[prompt.cursor] if event.key == "enter" else by_key
        if chosen is None:
            return
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
        self._open.pop(0)
        if answer is not None:
            self._answers.append(answer)
        if self._open:
            self._show()
        else:
            self.post_message(self.Answered(self, tuple(self._answers)))

    def _show(self) -> None:
        prompt, question = self._prompt, self._open[0]
        prompt.question, prompt.answers = question, tuple(self._answers)
        prompt.cursor, prompt.complaint = 0, ""
        self._field.display = isinstance(question, Write)
        self._field.value = question.initial if isinstance(question, Write) else ""
        prompt.redraw()
        self.take_focus()


def _option(option: Option, at_cursor: bool) -> Line:
    tone = Tone.CURSOR if at_cursor else Tone.PLAIN
    return line(
        Span("> " if at_cursor else "  ", Tone.STRONG),
        Span(option.key, Tone.CAP),
        " ",
        Span(option.label, tone),
    )


def _hint(text: str) -> Line:
    return line(Span(text, Tone.DIM))
