"""What an act is, and the questions that its key asks."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Flag as FlagEnum
from enum import auto
from functools import cached_property
from typing import ClassVar, Generic, Protocol, TypeAlias, TypeVar

import msgspec

from madrob_console.referee.checks import Check
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.records import USUAL_PROTEST_TIMES, ProtestTimes
from madrob_console.referee.run import Phase, Run, reissued
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.rest import HandleRest
from scoring.result import Indicator

# What a dialog asks before an act: plain data, no terminal.


T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Option:
    """One answer to a question.

    Attributes:
        key: the key that chooses it.
        label: in words.
        value: what is handed on; None = close the dialog, nothing happens.
        free: ask for a text instead of handing on `value`.
    """

    key: str
    label: str
    value: str | None
    free: bool = False

    @property
    def harmless(self) -> bool:
        """Whether nothing happens by it."""
        return self.value is None and not self.free


NOTHING = Option("n", "nothing: close this", None)
"""The first option of every question that has no other by which nothing happens."""


@dataclass(frozen=True, slots=True)
class Pick:
    """Choose one; Enter takes the marked one.

    To begin with that is the first, by which nothing happens, whatever the question.

    Attributes:
        text: the question.
        options: the answers.
        listed: what has to be seen before it is answered, a row each.

    Raises:
        ValueError: two options have the same key: the second could never be chosen.
    """

    text: str
    options: tuple[Option, ...]
    listed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not any(option.harmless for option in self.options):
            object.__setattr__(self, "options", (NOTHING, *self.options))
        keys = [option.key for option in self.options]
        if len(set(keys)) < len(keys):
            raise ValueError(f"{self.text!r}: two options have the same key, of {' '.join(keys)}")
        if not self.options[0].harmless:
            raise ValueError(f"{self.text!r}: the option by which nothing happens comes first")


@dataclass(frozen=True, slots=True)
class Write:
    """Type a text. `missing` refuses an empty one in words; empty = an empty text will do."""

    text: str
    initial: str = ""
    missing: str = ""


@dataclass(frozen=True, slots=True)
class Sure:
    """Only `y` goes on; Enter, n and Escape close the dialog."""

    text: str


Question = Pick | Write | Sure


@dataclass(frozen=True, slots=True)
class Ask(Generic[T_co]):
    """A dialog.

    Attributes:
        title: what it is about.
        questions: asked one after the other.
        make: makes what is wanted out of the answers of `Pick` and `Write`, in order.
    """

    title: str
    questions: tuple[Question, ...]
    make: Callable[..., T_co]

    @property
    def shortest(self) -> Ask[T_co]:
        """For a screen with room for one line: a question after a reason goes without it."""
        if len(self.questions) < 2 or not isinstance(self.questions[-1], Sure):
            return self
        title = self.title.partition(":")[0]
        return Ask(title, self.questions[-1:], lambda: self.make("none given"))


def reasons(*texts: str) -> tuple[Option, ...]:
    """A short list of reasons under digits, and free text under `o`."""
    listed = (Option(str(number), text, text) for number, text in enumerate(texts, 1))
    return (*listed, Option("o", "other: type it", None, free=True))


def meanwhile(*texts: str) -> Pick:
    """Why a run is to end; who takes the first answer ends nothing."""
    no = Option("n", "no, the run goes on", None)
    return Pick("Why? The run and its clock go on meanwhile.", (no, *reasons(*texts)))


@dataclass(frozen=True)
class Situation:
    """What an act is judged against. What the sensors say is worked out once, where it is wanted.

    Attributes:
        run: the state of the run.
        scored: whether the run has its result, on disk or refused by it.
        look: works out the pre-start checks.
        measure: works out what the handle force was in the last second; None = no data.
        rest_force: a force at rest differs from its zero by no more than this, N.
        hopeless: whether several tries to compute the result were in vain.
        teams: the list of teams as it is now.
        steps: the six as they stand; empty where they are of no interest.
        simulated: what the simulated testbed plays, in words; None = a real one.
        indicators: of the result that is written; empty without one.
        testbed: its name; empty where it has none.
        competition: its name; empty where none was set.
        new_id: makes the identity of a run; empty where none is set up.
        time: now, s since the epoch.
        protest_times: the competition's deadlines for protests.
        refused: what the disk refuses of the run, in words; empty = nothing.
    """

    run: Run
    scored: bool = False
    look: Callable[[], tuple[Check, ...]] = tuple
    measure: Callable[[], HandleRest | None] = lambda: None
    rest_force: float = math.inf
    hopeless: bool = False
    teams: TeamList = NO_TEAMS
    steps: tuple[StepRecord, ...] = ()
    simulated: str | None = None
    indicators: Mapping[IndicatorName, Indicator] = field(default_factory=dict)
    testbed: str = ""
    competition: str = ""
    new_id: Callable[[], str] = str
    time: float = 0.0
    protest_times: ProtestTimes = USUAL_PROTEST_TIMES
    refused: str = ""

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """The pre-start checks as they stand."""
        return self.look()

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What a decision on the run hangs on."""
        return flags(self.run, self.steps, indicators=self.indicators)

    @cached_property
    def handle_rest(self) -> HandleRest | None:
        """The handle force in the last second; None = no data."""
        return self.measure()


class RunView(Protocol):
    """What the referee sees when asking for an act."""

    @property
    def run(self) -> Run:
        """The state of the run."""
        ...

    @property
    def checks(self) -> tuple[Check, ...]:
        """The pre-start checks as they stand."""
        ...

    @property
    def teams(self) -> TeamList:
        """The list of teams as it is now."""
        ...

    @property
    def steps(self) -> tuple[StepRecord, ...]:
        """The six steps as they stand."""
        ...

    @property
    def indicators(self) -> Mapping[IndicatorName, Indicator]:
        """Of the result; empty without one."""
        ...

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What a decision on the run hangs on."""
        ...

    @property
    def elapsed(self) -> float | None:
        """Of the run, s since its start; None outside a run."""
        ...

    @property
    def time(self) -> float:
        """Now, s since the epoch."""
        ...

    @property
    def protest_times(self) -> ProtestTimes:
        """The competition's deadlines for protests."""
        ...


class Consequence(FlagEnum):
    """What an act brings with it, beside the new state of the run; the engine sees to it."""

    NONE = 0
    NEW_RUN = auto()
    """The run before is put away; testbed and robot hear of the set-up."""
    RECORDING = auto()
    """The recording opens; where it cannot, the act is refused."""
    COUNTDOWN = auto()
    """The countdown begins when the act's line is on disk; a line of its own says when."""
    HANDLE_ZERO = auto()
    """The handle zero is kept for the runs to come."""


LONGEST_TEXT = 2000
"""Of an act, characters: names, reasons, notes, the words of a team."""

Asked: TypeAlias = "Act | Ask[Asked] | str"
"""What a key or an answer brings about: an act, a question, or in words why neither."""


class Act(ABC):
    """One act of the referee: plain data that can cross a socket.

    Attributes:
        name: in the journal and on the screens.
        phases: when it is possible.
        elsewhere: refuses it in the others, in words; empty = the phase says why.
        missing: refuses it without its reason or text, in words; empty = none is needed.
        title, questions: the dialog before it, whose answers are its fields; none = at once.
        urgent: it ends what could hurt somebody: no other request and no disk holds it up.
        at_once: it takes effect whatever the disk says, and its line waits for the disk; others
            take effect when the journal has them, or never.
        consequences: what it brings with it.
        stands_out: whether its line of the event log does.
    """

    __slots__ = ()
    name: ClassVar[str]
    phases: ClassVar[tuple[Phase, ...]]
    elsewhere: ClassVar[str] = ""
    missing: ClassVar[str] = ""
    title: ClassVar[str] = ""
    questions: ClassVar[tuple[Question, ...]] = ()
    urgent: ClassVar[bool] = False
    at_once: ClassVar[bool] = True
    consequences: ClassVar[Consequence] = Consequence.NONE
    stands_out: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """An act that does not say when it is possible is none.

        Raises:
            TypeError: its name or its phases are missing.
        """
        for said in ("name", "phases"):
            if not hasattr(cls, said):
                raise TypeError(f"{cls.__name__} does not say its {said}")

    @classmethod
    def impossible(cls, situation: Situation) -> str | None:
        """Why there can be no such act now, whatever its fields, in words; None when there can."""
        phase = situation.run.phase
        if phase in cls.phases:
            return cls.hindrance(situation)
        return cls.elsewhere or _WHY_NOT[phase]

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """What stands in its way in a phase that allows it, in words; None = nothing."""
        return None

    def problem(self, situation: Situation) -> str | None:
        """What is wrong with its fields, in words; None = nothing."""
        return None

    def refusal(self, situation: Situation) -> str | None:
        """Why the act is not possible now, in words; None when it is."""
        refused = self.impossible(situation) or self._too_long or self.problem(situation)
        return refused or (None if self.reason_given.strip() else self.missing or None)

    @property
    def _too_long(self) -> str | None:
        """Why its texts do not go into a journal, in words; None when they do."""
        if _longest(msgspec.to_builtins(self)) <= LONGEST_TEXT:
            return None
        return f"a text has at most {LONGEST_TEXT} characters: write the rest beside it"

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Asked:
        """What its key brings about.

        Args:
            view: what the referee sees.
            pressed: the key, where there are several.

        Returns:
            The act itself, what to ask before it, or in words why neither.
        """
        return Ask(cls.title, cls.questions, cls) if cls.questions else cls()

    def settled(self, situation: Situation) -> Act:
        """The act as it is carried out and journalled: what cannot be otherwise is so."""
        return self

    @abstractmethod
    def apply(self, situation: Situation, at: float) -> Run:
        """The state after the act, done at time `at` (s since the epoch)."""

    def opened_again(self, run: Run, at: float) -> Run:
        """A final result is open once more, and this act is why it is issued again.

        Args:
            run: before the act; any other than a final one stays as it is.
            at: when it is done, s since the epoch.
        """
        if run.phase is not Phase.FINAL:
            return run
        return reissued(run, at, self.name, self.reason_given, self.signature or run.referee)

    @property
    def reason_given(self) -> str:
        """The reason or note that the referee gave, for the journal."""
        return str(getattr(self, "reason", getattr(self, "note", "")))

    @property
    def signature(self) -> str:
        """The name that the referee signed with; empty where nothing is signed."""
        return ""

    @property
    def done(self) -> str:
        """What it did, for who did it; the reason comes after that."""
        return self.name

    @property
    def logged(self) -> str:
        """What it did, for the event log; the reason comes after that."""
        return self.name


_WHY_NOT = {
    Phase.IDLE: "no run is set up yet",
    Phase.READY: "the run has not started",
    Phase.COUNTDOWN: "the countdown is running",
    Phase.RUNNING: "a run is going on",
    Phase.STOPPED: "the run has stopped",
    Phase.FINAL: "the result is final",
}


def _longest(found: object) -> int:
    """How long the longest text in some JSON values is, characters."""
    match found:
        case str():
            return len(found)
        case dict():
            return max(map(_longest, found.values()), default=0)
        case list():
            return max(map(_longest, found), default=0)
    return 0
