"""What an engine owns, what it says of itself to any version, and how it is found and ended."""

from __future__ import annotations

import fcntl
import os
import shlex
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from subprocess import Popen

import msgspec
import pytest

from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine import client, discovery, engine_lock, wire
from madrob_console.engine.client import RemoteEngine
from madrob_console.engine.discovery import (
    FoundEngine,
    ask,
    found_at,
    held,
    process_of,
    running_engines,
)
from madrob_console.engine.engine_lock import (
    LOCK_FILE,
    HeldError,
    Owned,
    connect_to,
    names_in_use,
    owned_by,
    state_folder,
)
from madrob_console.engine.requests import Role
from madrob_console.engine.server import EngineServer
from madrob_console.engine.wire import Rejected, Who, WhoAnswer
from tests.madrob_console.stranger import NOBODY, stranger

KNOWN = WhoAnswer("0.1.0", 5, "SIMULATED nominal")


@contextmanager
def answering(owned: Owned, known: WhoAnswer = KNOWN) -> Iterator[tuple[EngineServer, str]]:
    """An engine's locks and its name, and what answers on it."""
    with held(owned) as got, EngineServer(got.listening, known) as server:
        yield server, got.name


@pytest.fixture
def owned(tmp_path: Path) -> Owned:
    return owned_by(SourceKind.SIMULATED, tmp_path, results=tmp_path / "runs")


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


# ------------------------------------------------------------------ who, stop, another version


def say(name: str, message: dict[str, object] | bytes) -> list[object]:
    """What is answered to a first message, as plain data."""
    data = message if isinstance(message, bytes) else msgspec.msgpack.encode(message)
    connection, _ = connect_to(name, 10.0)
    with connection:
        answer = b""
        with suppress(ConnectionResetError, BrokenPipeError):  # it has read enough
            connection.sendall(wire.LENGTH.pack(len(data)) + data)
            connection.shutdown(socket.SHUT_WR)
            while part := connection.recv(65536):
                answer += part
    answers = []
    while answer:
        (length,) = wire.LENGTH.unpack(answer[:4])
        answers.append(msgspec.msgpack.decode(answer[4 : 4 + length]))
        answer = answer[4 + length :]
    return answers


def test_the_first_message_and_its_answers_have_a_form_that_never_changes(owned: Owned) -> None:
    busy = WhoAnswer(
        "0.1.0", 5, "SIMULATED nominal", "/runs", "running", "run 1 of subject 3", True, 2,
        ("--testbed", "ros"), ("odd",),
    )  # fmt: skip
    with answering(owned, busy) as (_, name):
        (answer,) = say(name, {"type": "Who"})
        assert answer == {
            "type": "WhoAnswer", "version": "0.1.0", "wire": 5, "testbed": "SIMULATED nominal",
            "results": "/runs", "phase": "running", "run": "run 1 of subject 3", "busy": True,
            "screens": 2, "console": ["--testbed", "ros"], "remarks": ["odd"], "unsaved": False,
        }  # fmt: skip
        refused = "a run is going on, 2 screens are attached"
        assert say(name, {"type": "Stop", "force": False}) == [
            {"type": "StopAnswer", "refused": refused}
        ]
        hello = {"type": "Hello", "version": 900, "role": "watch", "who": "ada", "mood": ["good"]}
        (answer,) = say(name, hello)
        assert answer == {
            "type": "Rejected",
            "reason": f"the engine speaks version {wire.VERSION}, this console 900: `madrob engine "
            "stop` ends it, then start the console again",
            "again": False,
        }


def test_what_a_later_version_adds_is_passed_over() -> None:
    later = msgspec.msgpack.encode(
        {"type": "WhoAnswer", "wire": 900, "mood": ["good"], "busy": True}
    )
    answer = wire.message_of(later)
    assert answer == WhoAnswer(wire=900, busy=True)
    assert isinstance(answer, WhoAnswer)
    assert answer.against_stopping == "a run is going on"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\n",
        b"\x93\x01\x02",
        b"\x91" * 60_000,
        b"\x00" * 2_000_000,
        msgspec.msgpack.encode({"type": 3}),
        msgspec.msgpack.encode({"type": "Hello", "version": "x", "role": "watch", "who": ""}),
        msgspec.msgpack.encode({"type": "Call", "number": 1, "deadline": 1.0, "request": 1}),
    ],
)
def test_rubbish_is_rejected_and_the_next_one_is_answered(owned: Owned, data: bytes) -> None:
    with answering(owned) as (_, name):
        for answer in say(name, data):
            assert isinstance(answer, dict)
            assert answer["type"] == "Rejected"
        assert ask(name, Who()) == KNOWN


def test_an_engine_that_has_failed_still_says_so(owned: Owned) -> None:
    def failing() -> WhoAnswer:
        raise MadrobError("the engine has failed: no disk")

    with answering(owned) as (server, name):
        server.describe = failing
        found = found_at(name)
        assert found is not None
        assert found.answer is not None
        assert (found.answer.phase, found.pid) == ("failed", os.getpid())
        assert "no disk" in found.answer.run


def test_an_engine_that_starts_says_so_and_a_screen_comes_later(owned: Owned) -> None:
    with answering(owned) as (_, name):
        assert ask(name, wire.Hello(wire.VERSION, Role.REFEREE, "ada")) == Rejected(
            "is starting", again=True
        )


def test_callers_that_say_nothing_keep_no_other_out(owned: Owned) -> None:
    with answering(owned) as (_, name):
        idle = [connect_to(name, 10.0)[0] for _ in range(100)]
        assert ask(name, Who(), 30.0) == KNOWN
        for one in idle:
            one.close()


# ------------------------------------------------------------------ locks


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
    known = msgspec.structs.replace(KNOWN, results=str(tmp_path / "runs"))
    with answering(owned, known), pytest.raises(HeldError) as told, held(live):
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


def no_locks(_file: int, _operation: int) -> None:
    raise OSError(37, "No locks available")


def test_without_locks_an_engine_is_kept_off_by_those_that_are_found(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fcntl, "flock", no_locks)
    with held(owned) as got:
        (remark,) = got.remarks
        assert "No locks available: other engines are not kept off " in remark
    known = msgspec.structs.replace(KNOWN, results=str(owned.results))
    other = owned_by(SourceKind.SIMULATED, "another", results=owned.results)
    with answering(owned, known), pytest.raises(HeldError, match="an engine already"), held(other):
        pass


def test_a_results_folder_that_does_not_answer_holds_up_no_engine(
    owned: Owned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(discovery, "_LOCKING_TIME", 0.05)
    thaw = threading.Event()
    (tmp_path / "runs").mkdir()

    def hangs(_file: int, _length: int) -> None:
        assert thaw.wait(50.0)

    monkeypatch.setattr(os, "ftruncate", hangs)
    try:
        with held(owned) as holds:  # its own thread has locked the file by now, and waits
            (remark,) = holds.remarks
            assert "it does not answer: other engines are not kept off" in remark
    finally:
        thaw.set()


def in_a_file(results: Path) -> None:
    results.parent.write_text("")


def with_a_trap(results: Path) -> None:
    results.mkdir(parents=True)
    os.mkfifo(results / LOCK_FILE)


@pytest.mark.parametrize(
    ("spoil", "words"), [(in_a_file, "Not a directory"), (with_a_trap, "no plain file")]
)
def test_a_folder_that_cannot_be_locked_is_said_and_not_waited_for(
    tmp_path: Path, spoil: Callable[[Path], None], words: str
) -> None:
    owned = owned_by(SourceKind.SIMULATED, tmp_path, results=tmp_path / "place" / "runs")
    spoil(tmp_path / "place" / "runs")
    with held(owned) as got:
        assert words in got.remarks[0]


DOMAIN = 101 + os.getpid() % 100


def test_a_domain_has_one_engine_also_when_its_name_is_not_seen_or_its_lock_is_lost(
    tmp_path: Path,
) -> None:
    one, two = (owned_by(SourceKind.ROS, DOMAIN, results=tmp_path / name) for name in "ab")
    words = f"ROS domain {DOMAIN} has an engine already"
    with held(one):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(discovery, "names_in_use", lambda *_: {})  # both start at once, say
            with pytest.raises(HeldError, match=words), held(two):
                pass
        (state_folder() / f"domain_{DOMAIN}.lock").unlink()
        with pytest.raises(HeldError, match=words) as told, held(two):
            pass
    assert told.value.same


def test_a_second_engine_in_a_ros_domain_is_told_of_the_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--testbed", "ros", "--domain", str(DOMAIN))
    known = WhoAnswer(wire=5, testbed=f"LIVE ros domain {DOMAIN}", console=options)
    with answering(owned_by(SourceKind.ROS, DOMAIN, results=tmp_path / "a"), known):
        for text in (str(DOMAIN), f" {DOMAIN} "):
            monkeypatch.setenv("ROS_DOMAIN_ID", text)
            assert (
                main(["engine", "serve", "--testbed", "ros", f"--results={tmp_path / 'b'}"]) == 75
            )
            said = capsys.readouterr().err
            who = f"(LIVE ros domain {DOMAIN}, pid {os.getpid()}, since "
            assert said.startswith(f"madrob: ROS domain {DOMAIN} has an engine already {who}")
            assert f"`madrob console {shlex.join(options)}` attaches to it" in said
            assert f"`madrob engine stop {shlex.join(options)}` ends it\n" in said
        assert main(["run", "--testbed", "ros", "--subject", "3", f"--results={tmp_path}"]) == 2


def test_a_state_folder_that_cannot_be_used_is_named_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null/state")
    ros = ["engine", "serve", "--testbed", "ros", f"--domain={DOMAIN}", f"--results={tmp_path}"]
    assert main(ros) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert "/dev/null/state/madrob" in said
    assert "set XDG_STATE_HOME to a folder of your own" in said


# ------------------------------------------------------------------ strangers, and hangs


@pytest.mark.machine
@pytest.mark.parametrize("full", [False, True])
def test_a_stranger_keeps_no_engine_from_its_name_and_is_no_engine(
    owned: Owned, full: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "GREETING_TIME", 0.5)
    own, other = f"{owned.testbed}/{os.getpid()}", f"{owned.testbed}/1"
    with stranger(own, other, full=full) as process:
        with answering(owned) as (_, name):
            assert name.startswith(f"{own}.")
            assert {own, other, name} <= names_in_use(owned.testbed).keys()
            (found,) = running_engines(owned.testbed)
            assert (found.name, found.pid, found.answer) == (name, os.getpid(), KNOWN)
        assert running_engines(owned.testbed) == ()
        for taken in (own, other):
            assert found_at(taken) is None
            with pytest.raises(TimeoutError if full else ConnectionRefusedError):
                RemoteEngine(taken, Role.REFEREE, "ada")
            by_name = FoundEngine(taken, process.pid, None, None)  # whatever it was found by
            with pytest.raises(ProcessLookupError), process_of(by_name):
                pass


FLOOD = """
import os, socket, sys
os.setuid(int(sys.argv[1]))
print("there", flush=True)
while True:
    with socket.socket(socket.AF_UNIX) as caller:
        caller.setblocking(False)
        try:
            caller.connect(sys.argv[2].replace("@", chr(0)))
        except OSError:
            pass
"""


@pytest.mark.machine
def test_a_stranger_who_calls_as_fast_as_it_can_keeps_nobody_out(owned: Owned) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can be another user")
    with answering(owned) as (_, name):
        address = engine_lock.address_of(name).replace("\0", "@")
        with Popen([sys.executable, "-c", FLOOD, str(NOBODY), address]) as process:
            try:
                for _ in range(20):
                    assert ask(name, Who(), 10.0) == KNOWN
            finally:
                process.kill()


@pytest.mark.machine
def test_an_engine_that_hangs_with_a_full_backlog_is_found_and_named(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine_lock, "_BACKLOG", 0)
    with held(owned) as got, closing(socket.socket(socket.AF_UNIX)) as caller:
        caller.connect(engine_lock.address_of(got.name))
        found = found_at(got.name)
        assert found is not None
        assert (found.pid, found.answer) == (os.getpid(), None)
        with pytest.raises(HeldError, match=f"pid {os.getpid()}, since"), held(owned):
            pass
        with process_of(found):
            pass
