"""An engine whose runs are scored in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from madrob_console.archive import score
from madrob_console.engine.runtime.disk import DiskThreads
from madrob_console.engine.runtime.scoring_process import ScoringProcess
from madrob_console.engine.runtime.supervisor import Supervisor
from madrob_console.referee.acts import Act
from madrob_console.testbeds.simulated import Scenario
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.robots import Played
from tests.watching import until


class Referee(Drive):
    """An engine whose results come from elsewhere: they are waited for, time stands still."""

    def __init__(
        self,
        results: Path,
        scorer: ScoringProcess,
        scenario: Played = Scenario.NOMINAL,
        disk: DiskThreads | None = None,
    ) -> None:
        super().__init__(results, scenario, scorer=scorer, disk=disk)
        self.scorer = scorer
        self.faults: set[str] = set()

    def look(self) -> None:
        self.engine.step(0.0)
        self.faults |= set(self.engine.snapshot().all_faults)

    def until_told(self, words: str) -> None:
        """Until screens show this fault."""

        def told() -> bool:
            self.look()
            return any(words in fault for fault in self.faults)

        until(told, 60.0)

    def settle(self, patience: float = 60.0) -> None:
        """Until there is the result that was asked for."""

        def there() -> bool:
            self.look()
            return self.engine.situation().scored

        until(there, patience)

    def finish(self) -> None:
        self.stop()
        self.settle()

    def stop(self) -> None:
        """Until the result is asked for."""
        self.wait_until(lambda: self.engine.run.issue > 0)

    def ruled(self, *acts: Act) -> None:
        for act in acts:
            self.act(act)
            self.settle()

    def verify(self) -> None:
        """The bag gives the digits that are shown, and they are on disk; nothing is wrong."""
        assert self.engine.scored is not None
        assert self.engine.folder is not None
        again = next(score(self.engine.folder)).result
        shown = self.engine.scored.result
        assert again == replace(shown, quality=again.quality)
        assert again.quality.signals == shown.quality.signals
        assert self.engine.snapshot().all_faults == ()
        for name, content in self.engine.scored.files.items():
            assert (self.engine.folder / name).read_bytes() == content, name


S = TypeVar("S", bound=ScoringProcess)


@contextmanager
def kept_running(scorer: S) -> Iterator[S]:
    supervisor = Supervisor(scorer)
    scorer.warm()
    try:
        yield scorer
    finally:
        supervisor.close()


def pid_of(scorer: ScoringProcess) -> int:
    pid = until(lambda: scorer.pid)
    assert pid is not None
    return pid


def alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def children_of(parent: int) -> dict[int, str]:
    """The command lines of what a process has started, by their ids; a zombie has none."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if int((path / "stat").read_text().rpartition(")")[2].split()[1]) == parent:
                found[int(path.name)] = (path / "cmdline").read_text().replace("\0", " ")
    return found
