"""The protests of a team against a result: open until decided or withdrawn (section 2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from madrob_console.common.formatting import relative_text


class ProtestEnd(StrEnum):
    """How a protest ends."""

    UPHELD = "upheld"
    PARTLY = "partly upheld"
    REJECTED = "rejected"
    WITHDRAWN = "withdrawn"


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
        referee: who took it.
        answer: what closed it; null = it is open.
    """

    number: int
    time: float
    team: str
    text: str
    about: str
    at: float | None
    referee: str
    answer: ProtestAnswer | None = None

    @property
    def open(self) -> bool:
        return self.answer is None

    def about_words(self, start: float | None) -> str:
        """Subject and instant: `step 4, 12.500 s from the start`; `start` in s since the epoch."""
        if self.at is None or start is None:
            return self.about
        instant = f"{relative_text(self.at, start)} s"
        named = "" if self.about == instant else f"{self.about}, "
        return f"{named}{instant} from the start"

    @property
    def title(self) -> str:
        return f"protest {self.number} ({self.about})"


def open_protests(protests: Iterable[Protest]) -> tuple[Protest, ...]:
    """Those that wait for a decision, the first filed at the beginning."""
    return tuple(protest for protest in protests if protest.open)
