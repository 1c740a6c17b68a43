"""Faults of the testbed that enter a run's journal and its data quality."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from madrob_console.referee.records import FaultKind, TestbedFault, merged, numbers_in

LASTING = 0.5
"""A trouble that lasts this long is noted, s: not the wobble of a rate that is just beginning."""


class FaultNotes:
    """Notes each trouble of each topic once a run."""

    def __init__(self) -> None:
        self._since: dict[tuple[str, FaultKind], float] = {}
        self._noted: set[tuple[str, FaultKind]] = set()

    def due(
        self, troubles: Mapping[tuple[str, FaultKind], str], now: float
    ) -> list[tuple[str, FaultKind]]:
        """Which of the troubles are to be noted now; `now` is s since the epoch."""
        self._since = {key: self._since.get(key, now) for key in troubles}
        due = [
            key
            for key, since in self._since.items()
            if key not in self._noted and abs(now - since) >= LASTING
        ]
        self._noted.update(due)
        return due


_PASSING = (
    FaultKind.SLOW,
    FaultKind.FLOOD,
    FaultKind.UNREADABLE,
    FaultKind.NO_READING,
    FaultKind.STAMPS,
    FaultKind.SKEW,
)
"""Troubles whose words do not say how long they lasted."""


@dataclass(slots=True, eq=False)
class _Cause:
    """A trouble that came over some topics at the same time.

    Attributes:
        begin, last_at: when it came first and last, s since the epoch.
        worst: the words with the largest numbers, by topic.
        times, lasted: how often it came, and how long that was in all, s.
    """

    kind: FaultKind
    begin: float
    last_at: float
    worst: dict[str, str] = field(default_factory=dict)
    times: int = 1
    lasted: float = LASTING

    def goes_on(self, now: float) -> bool:
        return now - self.last_at <= LASTING

    def see(self, name: str, words: str, now: float) -> None:
        if self.goes_on(now):
            self.lasted += now - self.last_at
        else:
            self.times += 1
        self.last_at = now
        self.worst[name] = max(self.worst.get(name, words), words, key=numbers_in)

    def fault(self) -> TestbedFault:
        again = f", {self.times} times" if self.times > 1 else ""
        lasted = f", for {self.lasted:.1f} s" if self.kind in _PASSING else ""
        text = "; ".join(merged(self.worst.items()))
        return TestbedFault(self.begin, f"{text}{again}{lasted}", self.kind)


class RunFaults:
    """The faults of the testbed in one run: one for each cause.

    A fault is noted when its trouble has lasted for a while, and again when the recording ends:
    then it says on which topics it was, how often and how long.
    """

    def __init__(self) -> None:
        self._notes = FaultNotes()
        self._causes: dict[tuple[str, FaultKind], _Cause] = {}

    def due(self, troubles: Mapping[tuple[str, FaultKind], str], now: float) -> list[TestbedFault]:
        """The faults that are new; `now` is s since the epoch."""
        earlier = list(self._causes.values())
        new = {kind: self._cause(kind, now) for _, kind in self._notes.due(troubles, now)}
        for key, words in troubles.items():
            if key[1] in new:
                self._causes.setdefault(key, new[key[1]])
            if (cause := self._causes.get(key)) is not None:
                cause.see(key[0], words, now)
        return [cause.fault() for cause in new.values() if cause not in earlier]

    def _cause(self, kind: FaultKind, now: float) -> _Cause:
        """The cause that goes on now, else a new one."""
        going_on = (
            cause for cause in self._causes.values() if cause.kind is kind and cause.goes_on(now)
        )
        return next(going_on, _Cause(kind, now - LASTING, now))

    def all(self) -> list[TestbedFault]:
        """All faults of the run, with what is known of them by now."""
        return [cause.fault() for cause in dict.fromkeys(self._causes.values())]
