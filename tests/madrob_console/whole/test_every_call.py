"""A fault at each call by which an engine changes its results folder, and nothing is lost.

The way of SQLite: after each, the state is examined. `each_call.c` is loaded into the engine before
everything else and stands between it and the C library. A run without a fault lists the calls; then
each can be the one at which something happens. A call is known by its name, its file, and how often
that came: the threads of an engine take turns in another order each time, but what each of them
does to its own file is the same.
"""

from __future__ import annotations

import errno
import hashlib
import math
import struct
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from madrob_console.common.version import software_version
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
from tests.madrob_console.engine_process import NO_REPORTS, EngineProcess
from tests.madrob_console.refereed_run import EngineGoneError, Notes, Referee, what_is_wrong
from tests.madrob_console.small_disk import SmallDisk, disk_image

pytestmark = pytest.mark.needs("cc", "/usr/include/stdio.h")

FAST, SLOW = 4.0, 2.0
"""How fast the testbed is; slower where many wait side by side for a disk that hangs."""
ALL_FROM = 300
"""`--runs` from which every call is tried."""
SHARES = 30
"""Of which a smaller number of runs tries one."""
LONG_HANG, SHORT_HANG = 60.0, 6.0  # s; longer than screens wait for an answer
AT_A_TIME, HANGING = 4, 8
GOES = 4
"""How often a fault is aimed again when its call did not come."""
TAKEN_WITHIN = 1.0  # s; of what waits for no disk, on a machine that is busy with this
DECIDED_WITHIN = 3.0  # s; of what is withdrawn when it is not on disk within 2 s

_SHARED = struct.Struct("qqqq")  # as in each_call.c
FAULTS = {
    "process killed": "kill",
    "power cut": "power",
    "EIO": str(errno.EIO),
    "ENOSPC": str(errno.ENOSPC),
    "EMFILE": str(errno.EMFILE),
    "hang": "hang",
}
"""What happens at a call, and its word for each_call.c."""
ENDS_THE_ENGINE = ("process killed", "power cut")


@dataclass(frozen=True, slots=True)
class Call:
    """One of an engine's calls.

    Attributes:
        name: of the call; `look` opens what is not changed.
        file: the name of what it is for, digits and random parts left out.
        number: from 1: how often it came.
    """

    name: str
    file: str
    number: int

    def can_have(self, fault: str) -> bool:
        """Whether the fault can come at this call; to look changes nothing on the disk."""
        match fault:
            case "EMFILE":
                return self.name in ("open", "look")
            case "ENOSPC":
                return self.name not in ("look", "unlink", "rmdir")
            case "process killed" | "power cut":
                return self.name != "look"
            case _:
                return True


class Trap:
    """Waits in an engine for one call.

    Args:
        library: each_call.c, compiled.
        folder: what is changed in there counts.
        notes: a folder for files of its own.
        fault: what happens.
        call: at which one; None = none, they are only listed.
        hang: how long a hang lasts, s.
    """

    def __init__(
        self,
        library: Path,
        folder: Path,
        notes: Path,
        fault: str = "",
        call: Call | None = None,
        hang: float = 0.0,
    ) -> None:
        self._state, self._log = notes / "each_call.state", notes / "each_call.log"
        self._state.write_bytes(bytes(_SHARED.size))
        self._log.touch()
        self.environment = {
            "LD_PRELOAD": str(library),
            "EACH_CALL_FOLDER": str(folder.resolve()),
            "EACH_CALL_STATE": str(self._state),
            "EACH_CALL_LOG": str(self._log),
        }
        if call is not None:
            self.environment |= {
                "EACH_CALL_NAME": call.name,
                "EACH_CALL_FILE": call.file,
                "EACH_CALL_NUMBER": str(call.number),
                "EACH_CALL_FAULT": FAULTS[fault],
                "EACH_CALL_HANG": f"{hang:g}",
            }

    def calls(self) -> tuple[Call, ...]:
        """All that came so far, in their order."""
        count: Counter[str] = Counter()
        calls = []
        for line in self._log.read_text().splitlines():
            name, _, file = line.partition(" ")
            count[line] += 1
            calls.append(Call(name, file, count[line]))
        return tuple(calls)

    def came_at(self) -> float | None:
        """When the fault came, s of the monotonic clock; None = it did not."""
        _, fired, _, came_at = _SHARED.unpack(self._state.read_bytes())
        return came_at / 1e9 if fired else None

    def wait_for_disk(self) -> None:
        """Until a hang is over."""
        hangs_to = _SHARED.unpack(self._state.read_bytes())[2]
        time.sleep(max(0.0, hangs_to / 1e9 - time.monotonic()))


@dataclass(frozen=True, slots=True)
class Tried:
    """One run with a fault: whether it came, the calls, what was wrong, the referee's notes."""

    call: Call
    came: bool
    calls: Sequence[Call]
    wrong: Sequence[str]
    notes: Notes


def engine(
    results: Path, environment: Mapping[str, str] | None = None, speed: float = FAST
) -> EngineProcess:
    return EngineProcess(
        results, "touch-only", speed=speed, environment=environment or {}, settings=NO_REPORTS
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = Path(__file__).parents[1] / "each_call.c"
    library = tmp_path_factory.mktemp("library") / "each_call.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", library, source, "-ldl"], check=True)
    return library


@pytest.fixture(scope="module")
def calls(library: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Call, ...]:
    """The calls of a run to which nothing happens, in order."""
    notes = tmp_path_factory.mktemp("calls")
    trap = Trap(library, notes / "disk", notes)
    with engine(notes / "disk" / "results", trap.environment) as process:
        Referee(process).whole_run()
    return trap.calls()


def tried(library: Path, folder: Path, fault: str, call: Call, hang: float) -> Tried:
    """A run with a fault at one call, and what is found after it."""
    folder.mkdir()
    with ExitStack() as stack:
        disk: SmallDisk | None = None
        place = folder / "disk"
        if fault == "power cut":
            disk = stack.enter_context(disk_image(place))
        results = place / "results"
        trap = Trap(library, place, folder, fault, call, hang)
        notes, wrong = Notes(), []
        ends = fault in ENDS_THE_ENGINE
        try:
            with engine(results, trap.environment, SLOW if hang else FAST) as process:
                referee = Referee(process, patience=hang + 40.0, disk_back=trap.wait_for_disk)
                notes = referee.notes
                try:
                    referee.whole_run()
                    trap.wait_for_disk()
                except EngineGoneError:
                    if not ends:
                        wrong.append(f"the engine ended: {process.log.read_text()[-2000:]}")
                except AssertionError as error:
                    wrong.append(str(error))
                process.end(hang + 60.0)  # the disk may hang while it closes
                wrong += said_badly(process)
                if hang:
                    wrong += answered_late(notes)
        except AssertionError as error:  # it did not come up
            if not ends:
                wrong.append(str(error))
        came = trap.came_at()
        ended = came if came is not None and ends else math.inf
        if disk is not None:
            disk.restart()
        try:
            with engine(results) as later:
                wrong += [*what_is_wrong(results, notes, later, ended), *said_badly(later)]
        except AssertionError as error:
            wrong.append(f"the next engine: {error}")
    return Tried(call, came is not None, trap.calls(), wrong, notes)


def tried_till_it_comes(library: Path, folder: Path, fault: str, call: Call, hang: float) -> Tried:
    """A run with a fault at one call.

    How often what reads or what caches comes depends on the moment: when this run had fewer of that
    call, the next go aims at one in the midst of those that it had.
    """
    folder.mkdir()
    for go in range(GOES):
        one = tried(library, folder / str(go), fault, call, hang)
        if one.came or one.wrong:
            break
        alike = [seen for seen in one.calls if (seen.name, seen.file) == (call.name, call.file)]
        call = alike[len(alike) // 2] if alike else call
    return one


def answered_late(notes: Notes) -> list[str]:
    """Acts whose answer waited for the disk."""
    at_once, decided = (
        (SetUp, ZeroHandle, ConfirmPose, AddNote),
        (Start, Finalise, Reissue, Void, Correct, TakeBack),
    )
    return [
        f"one of {[kind.name for kind in kinds]} was answered after {took:.2f} s"
        for kinds, limit in ((at_once, TAKEN_WITHIN), (decided, DECIDED_WITHIN))
        if (took := notes.slowest(*kinds)) > limit
    ]


def said_badly(process: EngineProcess) -> list[str]:
    """Tracebacks in an engine's log."""
    log = process.log.read_text()
    return [f"a traceback in the log: {log[-3000:]}"] if "Traceback" in log else []


def test_a_run_to_which_nothing_happens_is_as_it_was_answered(
    library: Path, calls: tuple[Call, ...], tmp_path: Path
) -> None:
    known = {call.name for call in calls}
    assert {"open", "write", "fsync", "fdatasync", "rename", "mkdir"} <= known
    one = tried(library, tmp_path / "run", "EIO", Call("rmdir", "nothing", 1), 0.0)
    assert (one.came, one.wrong) == (False, [])


def share_of_this_commit(shares: int) -> int:
    """Which of so many shares of the calls is this commit's turn: no two have the same version."""
    digest = hashlib.blake2s(software_version().encode(), digest_size=4)
    return int.from_bytes(digest.digest(), "big") % shares


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_at_any_call_loses_no_act_and_does_none_twice(
    fault: str,
    library: Path,
    calls: tuple[Call, ...],
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    chosen = [call for call in calls if call.can_have(fault)]
    hang = LONG_HANG if fault == "hang" else 0.0
    if request.config.getoption("--runs") < ALL_FROM:
        if fault != "EMFILE":
            chosen = [call for call in chosen if call.name != "look"]
        chosen = chosen[share_of_this_commit(min(SHARES, len(chosen))) :: SHARES]
        hang = min(hang, SHORT_HANG)
    with ThreadPoolExecutor(HANGING if hang else AT_A_TIME) as pool:
        done = [
            pool.submit(tried_till_it_comes, library, tmp_path / str(number), fault, call, hang)
            for number, call in enumerate(chosen)
        ]
        all_tried = [one.result() for one in done]
    came = sum(one.came for one in all_tried)
    notes = max(one.notes.slowest(AddNote) for one in all_tried)
    finals = max(one.notes.slowest(Start, Finalise, Reissue) for one in all_tried)
    print(f"\n{fault}: {came} calls of {len(calls)}; a note took {notes:.2f}, a start or", end=" ")
    print(
        f"signature {finals:.2f} s at most",
        *{w for t in all_tried for w in t.notes.words},
        sep="\n",
    )
    assert [(one.call, one.wrong) for one in all_tried if one.wrong] == []
    assert came > 0.8 * len(all_tried)
