from __future__ import annotations

from madrob_console.engine.process.own_time import OwnTime, ThreadState


class Told:
    """A process whose threads a test tells, looked at once a second."""

    def __init__(self) -> None:
        self.threads = {1: ThreadState("S", 0.0), 2: ThreadState("S", 0.0)}
        self.now = 0.0
        self.time = OwnTime(self.now, lambda: dict(self.threads))

    def own_time(self, seconds: int, *, state: str = "S", waits: float = 0.0) -> float:
        """How much more it had in so long; of each second one thread waits a part."""
        before = self.time.since(self.now)
        for _ in range(seconds):
            self.now += 1.0
            self.threads[2] = ThreadState(state, self.threads[2].waited + waits)
            own = self.time.since(self.now)
        return own - before


def test_a_process_that_nothing_holds_up_has_all_the_time() -> None:
    told = Told()
    told.own_time(1)
    assert told.own_time(30) == 30.0
    assert told.own_time(30, state="R") == 30.0


def test_a_process_that_waits_for_a_disk_has_none() -> None:
    told = Told()
    assert told.own_time(600, state="D") == 0.0


def test_a_process_to_which_others_leave_little_of_the_processor_has_little() -> None:
    told = Told()
    told.own_time(1)
    assert 5.0 < told.own_time(100, state="R", waits=0.9) < 15.0


def test_it_counts_anew_when_the_process_says_something() -> None:
    told = Told()
    told.own_time(20)
    told.time.begin(told.now)
    assert told.time.since(told.now) == 0.0
