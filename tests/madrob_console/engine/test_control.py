"""The part of the protocol that all versions share, and what an engine owns."""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import shutil
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import platformdirs
import pytest

from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine import discovery, wire
from madrob_console.engine.control import (
    ControlPort,
    Inquiry,
    StopAnswer,
    WhoAnswer,
    ask_owner,
    stop_answer_in,
    who_answer_in,
)
from madrob_console.engine.core import Engine
from madrob_console.engine.discovery import EngineHandle, FoundEngine, all_engines, found_at, held
from madrob_console.engine.engine_lock import (
    LOCK_FILE,
    HeldError,
    Owned,
    address_of,
    make_private,
    owned_by,
    results_name,
)
from madrob_console.engine.engine_thread import LocalEngine
from madrob_console.engine.requests import (
    NO_ANSWER,
    NO_REPLAY,
    ExportDossier,
    ExportTeam,
    Faster,
    GiveCurves,
    GiveFrames,
    GivePlan,
    JumpTo,
    NextRunNumber,
    OpenRun,
    Perform,
    PlayOrPause,
    Request,
    SetSpeed,
    Skip,
    Slower,
    TakeOver,
)
from madrob_console.engine.scorer import EarlierRun
from madrob_console.engine.wire import EngineClient
from madrob_console.referee.acts import Abort, ConfirmPose, SetUp, Start
from madrob_console.referee.competition_plan import (
    Attempts,
    Plan,
    PlanLine,
    PlannedAttempt,
    PlanProgress,
    Task,
)
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.served import Served, act, simulated, start
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write
from tests.madrob_console.stranger import NOBODY, stranger
from tests.watching import until

PRESENCE = WhoAnswer(os.getpid(), "0.1.0", 5, "SIMULATED nominal", "simulated")


@contextmanager
def answering(owned: Owned, presence: WhoAnswer = PRESENCE) -> Iterator[ControlPort]:
    """An engine's names, and what answers on them."""
    with held(owned) as got, ControlPort(got.listening, lambda: presence) as control:
        yield control


@pytest.fixture
def owned(tmp_path: Path) -> Owned:
    return owned_by(SourceKind.SIMULATED, tmp_path, results=tmp_path / "runs")


def say(owned: Owned, line: bytes) -> bytes:
    """What is answered to a line."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(10.0)
        connection.connect(address_of(owned.testbed))
        connection.sendall(line)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        while part := connection.recv(65536):
            answer += part
    return answer


def test_every_version_is_asked_and_answers_in_these_words(owned: Owned) -> None:
    """They stand in the consoles and engines of all versions: they never change."""
    busy = msgspec.structs.replace(
        PRESENCE,
        pid=7,
        domain=3,
        results="/runs",
        socket="/run/s",
        started=1.5,
        phase="running",
        run="run 1 of subject 3",
        busy=True,
        screens=2,
        console=("--testbed", "ros"),
        remarks=("odd",),
    )
    with answering(owned, busy):
        assert say(owned, b'{"ask": "who"}\n') == (
            b'{"pid":7,"version":"0.1.0","wire":5,"testbed":"SIMULATED nominal","kind":"simulated",'
            b'"domain":3,"results":"/runs","socket":"/run/s","started":1.5,"phase":"running",'
            b'"run":"run 1 of subject 3","busy":true,"screens":2,"console":["--testbed","ros"],'
            b'"remarks":["odd"],"unsaved":false}\n'
        )
        assert say(owned, b'{"ask": "stop", "force": false}\n') == (
            b'{"ends":false,"refused":"a run is going on, 2 screens are attached"}\n'
        )


def test_what_a_later_version_adds_is_passed_over_and_what_it_lacks_is_unknown() -> None:
    later = who_answer_in(b'{"pid": 7, "wire": 900, "mood": ["good"], "busy": true}\n')
    assert later == WhoAnswer(7, wire=900, busy=True)
    assert later.against_stopping == "a run is going on"
    assert stop_answer_in(b'{"ends": true, "in": 3}') == StopAnswer(ends=True)
    assert stop_answer_in(b"\x93\x01") == StopAnswer()
    assert stop_answer_in(b'{"refused": "\xff"}') == StopAnswer()
    assert who_answer_in(b'{"version": "\xff"}') is None
    assert who_answer_in(b"") is who_answer_in(b'{"pid": "x"}') is None


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"\n",
        b"GET / HTTP/1.0\r\n",
        b"[" * 60000,
        b"\x00" * 70000,
        b'{"ask": 3}\n',
        b'{"ask": "\xff"}\n',
    ],
)
def test_rubbish_is_not_answered_and_the_next_one_is(owned: Owned, line: bytes) -> None:
    with answering(owned):
        with suppress(OSError):  # it hung up before it had read all of it
            assert say(owned, line) in (b"", NOTHING_ELSE)
        found = found_at(owned.testbed)
        assert found is not None
        assert found.presence == PRESENCE


NOTHING_ELSE = b'{"ends":false,"refused":"this engine knows who and stop"}\n'


def test_who_may_stop_it_ends_it_as_a_signal_would(owned: Owned) -> None:
    got: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: got.append(number))
    try:
        with answering(owned):
            heard = ask_owner(owned.testbed, Inquiry("stop"))
            assert heard is not None
            assert stop_answer_in(heard.line).ends
            until(lambda: got)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert got == [signal.SIGTERM]


def test_an_engine_that_has_failed_still_says_so(owned: Owned) -> None:
    def failing() -> WhoAnswer:
        raise MadrobError("the engine has failed: no disk")

    with answering(owned) as control:
        control.describe = failing
        found = found_at(owned.testbed)
        assert found is not None
        assert found.presence is not None
        assert (found.presence.phase, found.presence.pid) == ("failed", os.getpid())
        assert "no disk" in found.presence.run


def test_a_second_engine_of_the_same_testbed_is_told_of_the_first(owned: Owned) -> None:
    with answering(owned), pytest.raises(HeldError) as told, held(owned):
        pass
    assert told.value.same
    assert f"(SIMULATED nominal, pid {os.getpid()}, since " in str(told.value)
    assert f"`madrob engine stop --pid {os.getpid()}` ends it" in str(told.value)
    with held(owned):
        pass  # nothing is left of the first


def test_a_results_folder_is_one_folder_by_whatever_path(owned: Owned, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "runs")
    live = owned_by(SourceKind.ROS, 3, results=tmp_path / "link")
    with answering(owned), pytest.raises(HeldError) as told, held(live):
        pass
    assert not told.value.same
    assert f"{tmp_path / 'link'} has an engine already (SIMULATED nominal, " in str(told.value)
    assert "or use another --results" in str(told.value)
    with answering(owned), held(owned_by(SourceKind.REPLAY, "bag", results=None)):
        pass  # it records nothing


def test_a_folder_that_another_machine_records_to_is_refused(owned: Owned, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with held(owned):
        pass
    with (tmp_path / "runs" / LOCK_FILE).open("w") as lock:
        lock.write("pid 7 on hall\x1b[2J\n")
        lock.flush()
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(HeldError, match=r"\(pid 7 on hall\), of another user"), held(owned):
            pass
    with held(owned) as got:
        assert got.remarks == ()
        assert f"pid {os.getpid()} on " in (tmp_path / "runs" / LOCK_FILE).read_text()
        assert (tmp_path / "runs" / LOCK_FILE).stat().st_mode & 0o777 == 0o600


def test_a_file_system_without_locks_is_said_and_does_not_stop_anybody(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(_file: int, _operation: int) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", without)
    with held(owned) as got:
        (remark,) = got.remarks
        assert "No locks available: other users and other machines are not kept out" in remark
        assert len(got.listening) == 2


def test_a_results_folder_that_does_not_answer_holds_up_no_engine(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs = threading.Event()

    def hang(_path: Path) -> int:
        hangs.wait()
        raise OSError(5, "no disk")

    monkeypatch.setattr(discovery, "_lock", hang)
    with held(owned) as got:
        assert "it does not answer: other users and other machines are not" in got.remarks[0]
        assert len(got.listening) == 2
    hangs.set()


def test_an_engine_whose_lock_file_hangs_is_not_kept_out_by_itself(
    owned: Owned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(discovery, "_PATIENCE", 0.05)
    thaw = threading.Event()
    (tmp_path / "runs").mkdir()

    def hangs(_file: int, _length: int) -> None:
        assert thaw.wait(50.0)

    monkeypatch.setattr(os, "ftruncate", hangs)
    try:
        with held(owned) as holds:  # its own thread has locked the file by now, and waits
            (remark,) = holds.remarks
            assert "it does not answer: other users and other machines are not" in remark
    finally:
        thaw.set()


def test_a_lock_file_that_is_a_trap_is_not_waited_for(owned: Owned, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    os.mkfifo(tmp_path / "runs" / LOCK_FILE)
    with held(owned) as got:
        assert "no plain file" in got.remarks[0]


def test_a_folder_that_cannot_be_made_is_not_held(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    owned = owned_by(SourceKind.SIMULATED, tmp_path, results=tmp_path / "file" / "runs")
    with held(owned) as got:
        assert len(got.listening) == 1
        assert results_name(tmp_path / "file" / "runs") is None


@pytest.mark.machine
@pytest.mark.parametrize("full", [False, True])
def test_names_that_another_user_took_stop_nobody_and_are_said(owned: Owned, full: bool) -> None:
    assert owned.results is not None
    owned.results.mkdir()
    names = (owned.testbed, str(results_name(owned.results)))
    with stranger(*names, full=full) as process:
        whose = f"process {process.pid} of another user ({NOBODY}) has the name "
        with held(owned) as got:
            assert not got.listening
            assert got.lock is not None
            for remark, name, what in zip(
                got.remarks, names, ("this simulated testbed", owned.results), strict=True
            ):
                assert remark.startswith(f"{whose}{name} of an engine of yours: have it ended")
                assert remark.endswith(f"a lock file alone keeps other engines off {what}")
            with pytest.raises(HeldError, match=f"pid {os.getpid()} on "), held(owned):
                pass
        for name in names:
            with pytest.raises(MadrobError, match=re.escape(whose + name)):
                found_at(name)
        found, unseen = all_engines()
        assert process.pid not in [one.pid for one in found]
        assert len([words for words in unseen if whose in words]) == 2
        # whatever it was found by
        by_name = FoundEngine(process.pid, names, None, None, silent=True, since=None)
        with pytest.raises(ProcessLookupError):
            EngineHandle(by_name)


@pytest.mark.machine
def test_an_engine_of_this_user_that_hangs_with_a_full_backlog_is_found_and_named(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(discovery, "_BACKLOG", 0)
    with held(owned), closing(socket.socket(socket.AF_UNIX)) as caller:
        caller.connect(address_of(owned.testbed))
        found = found_at(owned.testbed)
        assert found is not None
        assert (found.pid, found.silent) == (os.getpid(), True)
        with pytest.raises(HeldError, match=f"pid {os.getpid()}, since"), held(owned):
            pass
        with EngineHandle(found):
            pass


def test_what_cannot_be_looked_at_is_said(
    owned: Owned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("madrob_console.engine.engine_lock._TABLE", tmp_path / "none")
    with answering(owned):
        _, unseen = all_engines()
        assert "an engine whose runtime folder is lost is not listed" in unseen[0]
        assert found_at(owned.testbed) is not None


@pytest.fixture
def taken_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A runtime folder among the temporary ones that another user made first."""
    if os.getuid() != 0:
        pytest.skip("only root can make folders of another user")
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = tmp_path / f"runtime-{os.getuid()}"
    folder.mkdir(mode=0o777)
    os.chown(folder, 65534, 65534)
    try:
        if folder not in platformdirs.user_runtime_path("madrob").parents:
            pytest.skip("this user has a runtime folder of the login")
    except PermissionError:
        pass  # what the test is about
    return folder


def test_a_folder_that_is_lost_with_those_above_it_is_made_for_its_user_alone(
    tmp_path: Path,
) -> None:
    above = tmp_path / "1000"
    for _ in range(2):
        make_private(above / "madrob")
    assert [folder.stat().st_mode & 0o777 for folder in (above, above / "madrob")] == [0o700] * 2


def test_a_runtime_folder_that_another_user_made_first_is_named_with_the_remedy(
    taken_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["engine", "serve", "--testbed", "simulated", f"--results={tmp_path}"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert str(taken_folder) in said
    assert "set XDG_RUNTIME_DIR to a folder of your own" in said


def test_a_second_engine_in_a_ros_domain_is_told_of_the_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    domain = 101 + os.getpid() % 100
    options = ("--testbed", "ros", "--domain", str(domain))
    presence = WhoAnswer(
        os.getpid(), wire=5, testbed=f"LIVE ros domain {domain}", kind="ros", domain=domain,
        console=options,
    )  # fmt: skip
    with answering(owned_by(SourceKind.ROS, domain, results=tmp_path / "a"), presence):
        for text in (f"+{domain}", f"0{domain:o}", f" {domain} "):
            monkeypatch.setenv("ROS_DOMAIN_ID", text)
            assert (
                main(["engine", "serve", "--testbed", "ros", f"--results={tmp_path / 'b'}"]) == 75
            )
            said = capsys.readouterr().err
            who = f"(LIVE ros domain {domain}, pid {os.getpid()}, since "
            assert said.startswith(f"madrob: ROS domain {domain} has an engine already {who}")
            assert f"`madrob console {shlex.join(options)}` attaches to it" in said
            assert f"`madrob engine stop {shlex.join(options)}` ends it\n" in said
        assert main(["run", "--testbed", "ros", "--subject", "3", f"--results={tmp_path}"]) == 2


WAYS = ("in this process", "over a socket")

EXAMPLES: tuple[Request[Any], ...] = (
    Perform.of(Abort("why")),
    NextRunNumber(3, 1),
    OpenRun("subject_003_cond_001_run_001_20231114_221320"),
    ExportTeam(3),
    ExportDossier("subject_003_cond_001_run_001_20231114_221320"),
    GiveCurves(),
    GiveFrames(),
    GivePlan(),
    TakeOver(),
    PlayOrPause(),
    Faster(),
    Slower(),
    SetSpeed(2.0),
    Skip(1.0),
    JumpTo(1.0),
)


@pytest.fixture
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Engine:
    return simulated(tmp_path / "runs", scenario=getattr(request, "param", Scenario.NOMINAL))


@pytest.fixture(params=WAYS)
def client(
    request: pytest.FixtureRequest, engine: Engine, tmp_path: Path
) -> Iterator[EngineClient]:
    if request.param == WAYS[0]:
        with closing(LocalEngine(engine)) as local:
            yield local
        return
    with (
        closing(Served(tmp_path, engine=engine)) as served,
        closing(served.attach()) as remote,
    ):
        yield remote


@pytest.mark.machine
def test_a_run_goes_on_while_the_screen_only_looks(client: EngineClient) -> None:
    start(client)
    until(lambda: client.snapshot().result is not None)
    shown = client.snapshot()
    assert shown.run.outcome is Outcome.COMPLETED
    assert shown.recorder.dropped == 0
    assert shown.folder is not None
    assert (Path(shown.folder) / "result.json").is_file()
    assert client.send_request(NextRunNumber(3, 1, practice=True)) == 2
    assert client.send_request(NextRunNumber(3, 1)) == 1
    curves = client.send_request(GiveCurves())
    assert curves is not None
    assert not curves.empty
    assert len(curves.events) > 5


@pytest.mark.machine
def test_the_plan_and_what_is_done_of_it_come_from_the_engine(
    client: EngineClient, engine: Engine, tmp_path: Path
) -> None:
    assert client.send_request(GivePlan()) == PlanProgress()
    task = Task(3, 1)
    engine.hear_of_plan(Plan((PlanLine(task, 2),), ("plan.csv line 2: no",), "plan.csv"))
    until(lambda: client.snapshot().plan.lines)
    assert client.snapshot().plan.problems == ("plan.csv line 2: no",)
    for run_number, competition in ((1, ""), (2, "Spring Cup")):
        write(tmp_path / "runs", summary(3, 1, run_number, competition=competition))
    found = client.send_request(GivePlan())
    assert found.tasks == (Attempts(task, 2, 1, 1, 6),)
    assert found.next == PlannedAttempt(task, 2, 2)
    assert found.problems == ("plan.csv line 2: no",)


@pytest.mark.machine
@pytest.mark.parametrize("engine", [Scenario.NO_TOUCH], indirect=True)
def test_what_was_done_shows_in_the_next_snapshot(client: EngineClient) -> None:
    start(client)
    assert act(client, Abort("enough")) is None
    assert client.snapshot().run.phase is Phase.STOPPED


@pytest.mark.machine
def test_a_refusal_comes_back_in_words(client: EngineClient) -> None:
    assert act(client, Start()) == "no run is set up yet"
    assert client.send_request(JumpTo(1.0)) == NO_REPLAY
    assert client.send_request(ExportTeam(3)) == "nobody packs runs here: use `madrob export`"


@pytest.mark.machine
@pytest.mark.parametrize(
    "request_",
    [
        OpenRun("../../etc"),
        Perform("abort", {"reason": 3}),
        Perform("set up", {}),
        Perform("rm -rf", {}),
    ],
)
def test_what_fails_is_raised_in_words(client: EngineClient, request_: Request[Any]) -> None:
    with pytest.raises(MadrobError, match=r"no run folder|'abort'|'set up'|no act"):
        client.send_request(request_)
    assert client.snapshot().run.phase is Phase.IDLE
    assert act(client, SetUp(make_setup())) is None  # the next one is answered


@pytest.mark.machine
def test_a_run_that_is_set_up_while_a_slow_disk_reads_another_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = completed()
    shutil.copytree(source, tmp_path / source.name)
    engine, begun, go_on = simulated(tmp_path), threading.Event(), threading.Event()
    read_run = engine.read_run

    def slow(folder: Path) -> Future[EarlierRun]:
        begun.set()
        assert go_on.wait(60.0)
        return read_run(folder)

    monkeypatch.setattr(engine, "read_run", slow)
    with closing(LocalEngine(engine)) as client:
        answer = client.begin_request(OpenRun(source.name, invalid=True))
        assert begun.wait(60.0)
        assert act(client, SetUp(make_setup(run_number=4))) is None
        go_on.set()
        assert "run 4 of subject 3 was set up meanwhile, and stays" in str(answer.result(60.0))
        run = client.snapshot().run
        assert run.setup is not None
        assert (run.phase, run.setup.run_number) == (Phase.READY, 4)


@pytest.mark.machine
def test_every_request_is_carried_out(client: EngineClient) -> None:
    assert {type(example) for example in EXAMPLES} == set(wire.REQUESTS)
    for example in EXAMPLES:
        if type(example) in (OpenRun, GiveFrames):
            with pytest.raises(MadrobError, match=r"No such file|this is no replay"):
                client.send_request(example)
        else:
            client.send_request(example)


@pytest.mark.machine
def test_after_the_end_every_question_gets_an_answer(client: EngineClient) -> None:
    client.close()
    began = time.monotonic()
    with pytest.raises(MadrobError, match="the engine has ended"):
        act(client, ConfirmPose())
    assert time.monotonic() - began < 1.0


@pytest.mark.machine
def test_what_a_screen_was_told_failed_does_not_happen_later(
    client: EngineClient, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, go_on = threading.Event(), threading.Event()
    take = engine.source.take_messages

    def stalls(timeout: float) -> list[RawMessage]:
        held.set()
        assert go_on.wait(30.0)
        return list(take(timeout))

    monkeypatch.setattr(engine.source, "take_messages", stalls)
    monkeypatch.setattr(Perform, "timeout", Perform.effect_time + 0.3)
    assert held.wait(30.0)
    with pytest.raises(MadrobError, match=NO_ANSWER):
        act(client, SetUp(make_setup()))
    go_on.set()
    assert client.send_request(Skip(1.0)) == NO_REPLAY  # whatever came before it has had its turn
    assert client.snapshot().run.phase is Phase.IDLE


@pytest.mark.machine
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_engine_that_fails_says_so_at_once(
    client: EngineClient, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_arguments: object, **_options: object) -> None:
        raise ValueError("a bug")

    monkeypatch.setattr(engine, "submit", fails)
    began = time.monotonic()
    with pytest.raises(MadrobError, match="the engine has failed: a bug"):
        act(client, Start())
    assert time.monotonic() - began < 3.0
    until(lambda: not any(thread.name == "engine" for thread in threading.enumerate()))
    with pytest.raises(MadrobError, match="the engine has"):
        act(client, Start())


@pytest.mark.machine
def test_one_that_waits_does_not_hold_up_the_others(
    client: EngineClient, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag is read for as long as it takes; an abort goes past it."""
    reading, go_on = threading.Event(), threading.Event()

    def reads(_folder: Path) -> None:
        reading.set()
        assert go_on.wait(30.0)
        raise MadrobError("its bag is gone")

    monkeypatch.setattr("madrob_console.engine.scorer.open_run", reads)
    with ThreadPoolExecutor() as pool:
        opening = pool.submit(client.send_request, EXAMPLES[2])
        assert reading.wait(30.0)
        assert act(client, SetUp(make_setup())) is None
        go_on.set()
        with pytest.raises(MadrobError, match="its bag is gone"):
            opening.result()
