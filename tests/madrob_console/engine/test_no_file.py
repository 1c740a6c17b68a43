"""The engine's core touches no file and imports nothing once it is ready: it is watched doing runs.

What Python reports of itself (audit hook) and every call of a built-in function that touches files
(profile hook), in the engine's thread alone.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import BytesIO, StringIO
from pathlib import Path
from types import FrameType

import pytest

from madrob_console.engine.process.local import LocalEngine
from madrob_console.engine.process.scoring_process import ScoringProcess
from madrob_console.engine.shown.requests import NextRunNumber, OpenRun
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    Correct,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    TakeBack,
    Void,
    ZeroHandle,
)
from madrob_console.referee.acts.take_back import last_decision
from madrob_console.referee.on_record import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Condition, Outcome, Step
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.served import act, simulated, start
from tests.watching import until

SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")
_CORE, _KEEPERS = "engine", ("keeper", "reader 0", "reader 1", "reader 2")
_FRAMES = 6
SPEED, PATIENCE = 1.0, 120.0  # a core that is watched is slow, and the machine may be busy
_FILES = ("posix", "fcntl", "_io")
_NO_FILE = {"fspath", "eventfd_write"}  # the latter: the bell of the scorer's thread
_EVENTS = ("open", "os.", "fcntl.", "shutil.", "glob.", "pathlib.", "tempfile.")


class Watch:
    """What threads of an engine do.

    Attributes:
        calls: of built-in functions by the core.
        found: what it did that it should not, and the keepers, too.
    """

    def __init__(self) -> None:
        self.calls = 0
        self.found: set[str] = set()

    def audited(self, event: str, arguments: tuple[object, ...]) -> None:
        """Python reports something."""
        thread = threading.current_thread().name
        imports = event == "import" and thread in (_CORE, *_KEEPERS)
        if imports or (thread == _CORE and event.startswith(_EVENTS)):
            self._tell(f"{thread}: {event} {arguments[:1]}", sys._getframe(2))

    def profiled(self, frame: FrameType, event: str, function: object) -> None:
        """Something is called."""
        if event != "c_call" or threading.current_thread().name != _CORE:
            return
        self.calls += 1
        owner = getattr(function, "__self__", None)
        if isinstance(owner, BytesIO | StringIO):
            return
        module = getattr(function, "__module__", None) or type(owner).__module__
        name = getattr(function, "__name__", "")
        if module in _FILES and name not in _NO_FILE:
            self._tell(f"{module}.{name}", frame)

    def _tell(self, what: str, frame: FrameType | None) -> None:
        where = list[str]()
        while frame is not None and len(where) < _FRAMES:
            where.append(f"{frame.f_code.co_filename.rpartition('/')[2]}:{frame.f_lineno}")
            frame = frame.f_back
        self.found.add(f"{what}: {' < '.join(where)}")


_watch: Watch | None = None


def _audited(event: str, arguments: tuple[object, ...]) -> None:
    if _watch is not None:
        _watch.audited(event, arguments)


sys.addaudithook(_audited)  # for good: it cannot be taken away again


@contextmanager
def watched() -> Iterator[Watch]:
    """Watch each engine that is made inside."""
    global _watch  # noqa: PLW0603  so is the hook that reads it
    _watch = Watch()
    threading.setprofile(_watch.profiled)
    try:
        yield _watch
    finally:
        threading.setprofile(None)
        _watch = None


@pytest.mark.machine
@pytest.mark.timeout(240)
def test_the_core_touches_no_file_and_imports_nothing(tmp_path: Path) -> None:
    engine = simulated(tmp_path / "runs", SPEED, scorer=ScoringProcess())
    with watched() as watch, closing(LocalEngine(engine)) as local:

        def done(*acts: Act) -> None:
            for one in acts:
                until(lambda one=one: act(local, one) is None)  # type: ignore[misc]

        start(local)
        done(AddNote("all is well"), MarkIncident(IncidentKind.COLLISION, "door frame"))
        until(lambda: local.snapshot().result is not None, PATIENCE)
        assert local.snapshot().run.outcome is Outcome.COMPLETED
        first = f"practice/{Path(local.snapshot().folder or '').name}"
        done(Rule(Step.TOUCH, confirmed=False, reason="video"), SIGNED, Reissue("appeal"), SIGNED)
        done(Void("unsafe"), Correct(3, Condition.from_number(11), "typed wrongly"))
        last = last_decision(local.snapshot().run)
        assert last is not None
        done(TakeBack(last.kind, last.time, "my mistake"), SIGNED)
        number = local.ask(NextRunNumber(3, 1, practice=True))
        done(SetUp(make_setup(run_number=number, countdown=5.0)))
        until(lambda: local.snapshot().run.phase is Phase.READY)
        done(ZeroHandle(), ConfirmPose(), Start(), RestartCountdown("robot not ready"))
        until(lambda: local.snapshot().run.phase is Phase.RUNNING)
        done(Abort("enough"))
        until(lambda: local.snapshot().result is not None)
        assert local.ask(OpenRun(first)) is None
        until(lambda: local.snapshot().opened)
        done(Reissue("once more"), AddNote("afterwards"), SIGNED)
        until(lambda: local.snapshot().run.issue == 4 and local.snapshot().result is not None)
        assert local.snapshot().run.phase is Phase.FINAL
        assert watch.calls > 10_000
        assert not watch.found, "\n".join(sorted(watch.found))
