"""Protests of a team against a result: open until they are decided or withdrawn (section 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from madrob_console.referee.amounts import span_words
from madrob_console.referee.run_times import relative_text


class ProtestEnd(StrEnum):
    """How a protest ends."""

    UPHELD = "upheld"
    PARTLY = "partly upheld"
    REJECTED = "rejected"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True, slots=True)
class ProtestTimes:
    """A competition's deadlines.

    Attributes:
        filing: until so long after a result is signed a protest is in time, s. It runs on while
            another protest is open, and begins anew once the result was changed.
        decision: so long after it was filed it is to be decided, s.
    """

    filing: float = 1800.0
    decision: float = 3600.0


USUAL_PROTEST_TIMES = ProtestTimes()
"""Half an hour and an hour."""


@dataclass(frozen=True, slots=True)
class ProtestAnswer:
    """What closed a protest.

    Attributes:
        time: s since the epoch.
        end: how it ended.
        reason: the referee's words; of a withdrawal the team's.
        referee: who decided, or heard of the withdrawal.
    """

    time: float
    end: ProtestEnd
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class Protest:
    """A team protests against a result.

    Attributes:
        number: of the run's protests, from 1.
        time: when it was filed, s since the epoch.
        team: who protests.
        text: what the team says.
        about: what it is about: a step, an indicator, a time, or the whole run.
        at: the instant in question, s since the epoch; null = none was named.
        due: when it is to be decided, s since the epoch.
        late: why it was admitted although it came late; empty = it was in time.
        referee: who took it.
        answer: what closed it; null = it is open.
    """

    number: int
    time: float
    team: str
    text: str
    about: str
    at: float | None
    due: float
    late: str
    referee: str
    answer: ProtestAnswer | None = None

    @property
    def open(self) -> bool:
        """Whether it waits for a decision."""
        return self.answer is None

    @property
    def late_decision(self) -> str:
        """That it was decided after its deadline, as `late_words`; empty where it was not."""
        answer = self.answer
        if answer is None or answer.end is ProtestEnd.WITHDRAWN:
            return ""
        return late_words(self.due, answer.time)

    def about_words(self, start: float | None) -> str:
        """What it is about and when that was: `step 4, 12.500 s from the start`.

        Args:
            start: of the run, s since the epoch; None = it has none.
        """
        if self.at is None or start is None:
            return self.about
        instant = f"{relative_text(self.at, start)} s"
        named = "" if self.about == instant else f"{self.about}, "
        return f"{named}{instant} from the start"

    @property
    def title(self) -> str:
        """Its number and what it is about."""
        return f"protest {self.number} ({self.about})"


def open_protests(protests: Iterable[Protest]) -> tuple[Protest, ...]:
    """Those that wait for a decision, the first one that is due first."""
    return tuple(sorted((one for one in protests if one.open), key=lambda one: one.due))


def due_words(due: float, now: float) -> str:
    """How long there is to decide a protest: `12 min left`, `due now`, `OVERDUE by 1 h 05 min`.

    Args:
        due: when it is to be decided, s since the epoch.
        now: s since the epoch.
    """
    left = due - now
    if abs(left) < 1.0:
        return "due now"
    return f"{span_words(left)} left" if left >= 0 else f"OVERDUE by {span_words(-left)}"


def deadline_words(due: float, now: float, date: Callable[[float], str]) -> str:
    """The same by the clock: `due by 23 Nov 08:29`, `OVERDUE since 23 Nov 08:29`.

    Args:
        due: when it is to be decided, s since the epoch.
        now: s since the epoch.
        date: a time in words, of s since the epoch.
    """
    return f"{'OVERDUE since' if due < now else 'due by'} {date(due)}"


def late_words(due: float, decided: float) -> str:
    """That a decision came late: `LATE, 12 min after it was due`; empty where it was in time."""
    return f"LATE, {span_words(decided - due)} after it was due" if decided > due else ""
