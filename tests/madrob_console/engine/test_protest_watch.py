"""Open protests of all runs are known beside the run at hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future

from madrob_console.archive.history import RunSummary, time_words
from madrob_console.engine.process.protest_watch import LOOKING_PERIOD, ProtestWatch
from madrob_console.errors import MadrobError
from tests.madrob_console.run_folders import EPOCH, summary

DUE = EPOCH + 600.0
PROTESTED = summary(4, 7, 2, protest_due=DUE)
OTHER = summary(5, protest_due=DUE + 60.0)
QUIET = summary(6)


class Archive:
    """Runs that are read when a test says so."""

    def __init__(self, *runs: RunSummary) -> None:
        self.runs: Sequence[RunSummary] = runs
        self.asked: list[Future[Sequence[RunSummary]]] = []
        self.now = 0.0
        self.watch = ProtestWatch(lambda: self.runs, self.read, lambda: self.now)

    def read(self, job: Callable[[], Sequence[RunSummary]]) -> Future[Sequence[RunSummary]]:
        self.asked.append(Future())
        return self.asked[-1]

    def answer(self) -> None:
        self.asked[-1].set_result(self.runs)


def known(*runs: RunSummary) -> Archive:
    archive = Archive(*runs)
    archive.watch.look("a result")
    archive.answer()
    archive.watch.look("a result")
    return archive


def test_protests_that_should_have_been_decided_are_told_with_the_keys_that_lead_there() -> None:
    watch = known(QUIET, OTHER, PROTESTED).watch
    assert list(watch.overdue(DUE - 1.0, "")) == []
    (words,) = watch.overdue(DUE + 30.0, "")
    which = "protest against run 2 of subject 4 in condition 7"
    assert words == f"{which}: OVERDUE since {time_words(DUE)}; h opens it, P decides it"
    assert list(watch.overdue(DUE + 31.0, "")) == [words]  # a new fault rings the bell
    assert list(watch.open(DUE - 600.0)) == [
        "protest against run 2 of subject 4 in condition 7: 10 min left",
        "protest against run 1 of subject 5 in condition 7: 11 min left",
    ]


def test_the_run_at_hand_tells_its_own() -> None:
    assert list(known(PROTESTED).watch.overdue(DUE + 30.0, PROTESTED.folder)) == []


def test_it_reads_again_when_a_result_has_come_and_after_a_while_and_waits_for_nothing() -> None:
    archive = known(PROTESTED)
    archive.watch.look("a result")
    assert len(archive.asked) == 1
    archive.watch.look("another")
    archive.watch.look("a third")  # the reading before goes on
    assert len(archive.asked) == 2
    archive.runs = ()
    archive.answer()
    archive.watch.look("another")
    assert list(archive.watch.open(DUE)) == []
    archive.now += LOOKING_PERIOD
    archive.watch.look("another")
    assert len(archive.asked) == 3


def test_what_cannot_be_read_leaves_what_is_known() -> None:
    archive = known(PROTESTED)
    archive.watch.look("another")
    archive.asked[-1].set_exception(MadrobError("the disk is away"))
    archive.watch.look("another")
    assert len(list(archive.watch.open(DUE))) == 1
