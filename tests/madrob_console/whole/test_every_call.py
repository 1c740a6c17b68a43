"""A fault at each call by which an engine changes its results folder, and nothing is lost.

The way of SQLite: after each, the state is examined.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from madrob_console.referee.acts import (
    AddNote,
    ConfirmPose,
    Correct,
    Finalise,
    Reissue,
    SetUp,
    Start,
    TakeBack,
    Void,
    ZeroHandle,
)
from tests.madrob_console.each_call import Call, CallFault, Trap, compiled, share_of_this_commit
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.fault_table import Row, fault_table
from tests.madrob_console.refereed_run import EngineGoneError, Notes, Referee, what_is_wrong
from tests.madrob_console.small_disk import SmallDisk, disk_image
from tests.madrob_console.warm_starts import WarmStarts

pytestmark = pytest.mark.needs("cc", "/usr/include/stdio.h")

SCENARIO = "touch-only"
FAST, SLOW = 4.0, 2.0
"""How fast the testbed is; slower where many wait side by side for a disk that hangs."""
ALL_FROM = 300
"""`--runs` from which every call is tried."""
SHARES = 20
"""Of which a smaller number of runs tries one."""
LONG_HANG, SHORT_HANG = 60.0, 6.0  # s; longer than screens wait for an answer
AT_A_TIME, HANGING = 6, 12
GOES = 4
"""How often a fault is aimed again when its call did not come."""
TAKEN_WITHIN = 1.0  # s; of what waits for no disk, on a machine that is busy with this
DECIDED_WITHIN = 3.0  # s; of what is withdrawn when it is not on disk within 2 s
_NO_REPORTS = "[results]\nreports = false\n"  # they are made by another process, from what is there


@dataclass(frozen=True, slots=True)
class Tried:
    """One run with a fault.

    Attributes:
        call: at which it was to come.
        came: whether it came.
        calls: of this run, in order.
        wrong: what was not as it must be.
        notes: of the referee.
    """

    call: Call
    came: bool
    calls: Sequence[Call]
    wrong: Sequence[str]
    notes: Notes

    @property
    def delays(self) -> dict[str, float]:
        """The slowest answers, s."""
        return {
            "note": self.notes.slowest(AddNote),
            "start": self.notes.slowest(Start),
            "finalise, re-issue": self.notes.slowest(Finalise, Reissue),
        }


@pytest.fixture(scope="module")
def warm() -> Iterator[WarmStarts]:
    with compiled() as library, WarmStarts(library) as starts:
        yield starts


@pytest.fixture(scope="module")
def calls(warm: WarmStarts, tmp_path_factory: pytest.TempPathFactory) -> tuple[Call, ...]:
    """The calls of a run to which nothing happens, in order."""
    notes = tmp_path_factory.mktemp("calls")
    results = notes / "results"
    trap = Trap(results, notes)
    with engine(results, warm, trap) as process:
        Referee(process).whole_run()
    return trap.calls()


def engine(
    results: Path, warm: WarmStarts, trap: Trap | None = None, speed: float = FAST
) -> EngineProcess:
    environment = {} if trap is None else trap.environment
    return EngineProcess(
        results,
        SCENARIO,
        speed=speed,
        warm=warm,
        environment=environment,
        settings=_NO_REPORTS,
    )


def tried(warm: WarmStarts, folder: Path, fault: CallFault, call: Call, hang: float) -> Tried:
    """A run with a fault at one call, and what is found after it."""
    folder.mkdir()
    with ExitStack() as stack:
        disk: SmallDisk | None = None
        place = folder / "disk"
        if fault is CallFault.POWER_CUT:
            disk = stack.enter_context(disk_image(place))
        results = place / "results"
        trap = Trap(place, folder, fault, call, hang)

        def disk_back() -> None:
            time.sleep(max(0.0, trap.happened().hangs_until - time.monotonic()))

        notes, wrong = Notes(), []
        speed = SLOW if fault is CallFault.HANG else FAST
        try:
            with engine(results, warm, trap, speed) as process:
                referee = Referee(process, patience=hang + 40.0, disk_back=disk_back)
                notes = referee.notes
                try:
                    referee.whole_run()
                    disk_back()
                except EngineGoneError:
                    if not fault.ends_the_engine:
                        wrong.append(f"the engine ended: {process.log.read_text()[-2000:]}")
                except AssertionError as error:
                    wrong.append(str(error))
                process.end(hang + 60.0)  # the disk may hang while it closes
                wrong += said_badly(process)
                if fault is CallFault.HANG:
                    wrong += answered_late(notes)
        except AssertionError as error:  # it did not come up
            if not fault.ends_the_engine:
                wrong.append(str(error))
        came = trap.happened().at
        ended = came if came is not None and fault.ends_the_engine else math.inf
        if disk is not None:
            disk.restart()
        wrong += found_later(results, warm, notes, ended)
    return Tried(call, came is not None, trap.calls(), wrong, notes)


def tried_till_it_comes(
    warm: WarmStarts, folder: Path, fault: CallFault, call: Call, hang: float
) -> Tried:
    """A run with a fault at one call.

    How often what reads or what caches comes depends on the moment: when this run had fewer of that
    call, the next go aims at one in the midst of those that it had.
    """
    folder.mkdir()
    for go in range(GOES):
        one = tried(warm, folder / str(go), fault, call, hang)
        if one.came or one.wrong:
            break
        alike = [seen for seen in one.calls if (seen.name, seen.file) == (call.name, call.file)]
        call = alike[len(alike) // 2] if alike else call
    return one


def found_later(results: Path, warm: WarmStarts, notes: Notes, ended: float) -> list[str]:
    """What the next engine finds wrong, or that it does not come."""
    try:
        with engine(results, warm) as later:
            return [*what_is_wrong(results, notes, later, ended), *said_badly(later)]
    except AssertionError as error:
        return [f"the next engine: {error}"]


def answered_late(notes: Notes) -> list[str]:
    """Acts whose answer waited for the disk."""
    late = [
        (kinds, notes.slowest(*kinds), limit)
        for kinds, limit in (
            ((SetUp, ZeroHandle, ConfirmPose, AddNote), TAKEN_WITHIN),
            ((Start, Finalise, Reissue, Void, Correct, TakeBack), DECIDED_WITHIN),
        )
    ]
    return [
        f"{' or '.join(kind.name for kind in kinds)} was answered after {took:.2f} s"
        for kinds, took, limit in late
        if took > limit
    ]


def said_badly(process: EngineProcess) -> list[str]:
    """Tracebacks in an engine's log."""
    log = process.log.read_text()
    return [f"a traceback in the log: {log[-3000:]}"] if "Traceback" in log else []


def test_a_run_to_which_nothing_happens_is_as_it_was_answered(
    warm: WarmStarts, calls: tuple[Call, ...], tmp_path: Path
) -> None:
    known = Counter(call.name for call in calls)
    assert all(known[name] for name in ("open", "write", "fsync", "fdatasync", "rename", "mkdir"))
    never = Call("rmdir", "nothing", 1)
    one = tried(warm, tmp_path / "run", CallFault.IO_ERROR, never, 0.0)
    assert (one.came, one.wrong) == (False, [])


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
@pytest.mark.parametrize("fault", CallFault)
def test_a_fault_at_any_call_loses_no_act_and_does_none_twice(
    fault: CallFault,
    warm: WarmStarts,
    calls: tuple[Call, ...],
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    fitting = [call for call in calls if fault.fits(call)]
    whole = request.config.getoption("--runs") >= ALL_FROM
    if not whole:
        changing = [call for call in fitting if call.name != "look"]
        fitting = fitting if fault is CallFault.NO_HANDLES else changing
    chosen = fitting if whole else fitting[share_of_this_commit(SHARES) :: SHARES]
    hang = LONG_HANG if whole else SHORT_HANG
    with ThreadPoolExecutor(HANGING if fault is CallFault.HANG else AT_A_TIME) as pool:
        done = [
            pool.submit(tried_till_it_comes, warm, tmp_path / str(number), fault, call, hang)
            for number, call in enumerate(chosen)
        ]
        all_tried = [one.result() for one in done]
    row = Row(str(fault))
    for one in all_tried:
        if one.came:
            row.add(str(one.call), one.delays, one.wrong, one.notes.words)
        else:
            row.lost += [f"{one.call} did not come: {words}" for words in one.wrong]
    print(fault_table([row]))
    print(f"{row.tried} of {len(fitting)} calls; {len(all_tried) - row.tried} did not come")
    assert not row.lost
    assert row.tried > 0.8 * len(all_tried)
