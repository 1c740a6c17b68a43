"""What an engine owns, what it says of itself to any version, and how it is found and ended."""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from unittest.mock import Mock

import msgspec
import pytest

from madrob_console.cli.doctor import look_at_state_folder
from madrob_console.cli.finding import Severity
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.ipc import discovery, engine_sockets, greeting, ownership, wire
from madrob_console.engine.ipc.client import RemoteEngine
from madrob_console.engine.ipc.discovery import ask, find_engine, process_of, running_engines
from madrob_console.engine.ipc.engine_lock import (
    LOCK_FILE,
    HeldError,
    Holder,
    Owned,
    holder_in,
    owned_by,
)
from madrob_console.engine.ipc.engine_sockets import connect_to, listen_as, state_folder
from madrob_console.engine.ipc.greeting import Rejected, Who, WhoAnswer
from madrob_console.engine.ipc.ownership import held
from madrob_console.engine.ipc.server import EngineServer
from madrob_console.engine.requests import Role

KNOWN = WhoAnswer("0.1.0", 5, "SIMULATED nominal")


@contextmanager
def answering(owned: Owned, known: WhoAnswer = KNOWN) -> Iterator[tuple[EngineServer, str]]:
    """An engine's locks and its socket, and what answers there."""
    with held(owned) as got, EngineServer(got.listening, known) as server:
        yield server, owned.stem


@pytest.fixture
def owned(tmp_path: Path) -> Owned:
    return owned_by(SourceKind.SIMULATED, tmp_path, results=tmp_path / "runs")


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


# ------------------------------------------------------------------ who, stop, another version


def say(stem: str, message: dict[str, object] | bytes) -> list[object]:
    """What is answered to a first message, as plain data."""
    data = message if isinstance(message, bytes) else msgspec.msgpack.encode(message)
    with connect_to(stem, 10.0) as connection:
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
    with answering(owned, busy) as (_, stem):
        (answer,) = say(stem, {"type": "Who"})
        assert answer == {
            "type": "WhoAnswer", "version": "0.1.0", "wire": 5, "testbed": "SIMULATED nominal",
            "results": "/runs", "phase": "running", "run": "run 1 of subject 3", "busy": True,
            "screens": 2, "console": ["--testbed", "ros"], "remarks": ["odd"], "unsaved": False,
        }  # fmt: skip
        refused = "a run is going on, 2 screens are attached"
        assert say(stem, {"type": "Stop", "force": False}) == [
            {"type": "StopAnswer", "refused": refused}
        ]
        hello = {"type": "Hello", "version": 900, "role": "watch", "who": "ada", "mood": ["good"]}
        (answer,) = say(stem, hello)
        assert answer == {
            "type": "Rejected",
            "reason": f"the engine speaks version {wire.VERSION}, this console 900: `madrob engine "
            f"stop --pid {os.getpid()}` ends it, then start the console again",
            "again": False,
        }


def test_what_a_later_version_adds_is_passed_over() -> None:
    later = {"type": "WhoAnswer", "wire": 900, "mood": ["good"], "busy": True}
    answer = wire.message_of(msgspec.msgpack.encode(later))
    assert answer == WhoAnswer(wire=900, busy=True)
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
    with answering(owned) as (_, stem):
        for answer in say(stem, data):
            assert isinstance(answer, dict)
            assert answer["type"] == "Rejected"
        assert ask(stem, Who()) == KNOWN


def test_an_engine_that_has_failed_still_says_so(owned: Owned) -> None:
    with answering(owned) as (server, stem):
        server.describe = Mock(side_effect=MadrobError("the engine has failed: no disk"))
        answer = ask(stem, Who())
    assert isinstance(answer, WhoAnswer)
    assert (answer.phase, "no disk" in answer.run) == ("failed", True)


def test_an_engine_that_starts_says_so_and_a_screen_comes_later(owned: Owned) -> None:
    with answering(owned) as (_, stem):
        assert ask(stem, greeting.Hello(wire.VERSION, Role.REFEREE, "ada")) == Rejected(
            "is starting", again=True
        )


def test_callers_that_say_nothing_keep_no_other_out(owned: Owned) -> None:
    with answering(owned) as (_, stem), ExitStack() as idle:
        for _ in range(100):
            idle.enter_context(connect_to(stem, 10.0))
        assert ask(stem, Who(), 30.0) == KNOWN


def refusal(owned: Owned) -> HeldError:
    """Why an engine cannot have what it would own."""
    with pytest.raises(HeldError) as told, held(owned):
        pass
    return told.value


# ------------------------------------------------------------------ locks


def test_a_results_folder_is_one_folder_by_whatever_path(owned: Owned, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "runs")
    live = owned_by(SourceKind.ROS, 3, results=tmp_path / "link")
    with answering(owned):
        refused = refusal(live)
        with held(owned_by(SourceKind.REPLAY, "bag", results=None)):
            pass  # it records nothing
    assert not refused.same
    words = rf"{tmp_path}/link has an engine already \(user .*pid {os.getpid()} on .*--results"
    assert re.search(words, str(refused))


def test_a_folder_that_another_machine_records_to_is_refused(owned: Owned, tmp_path: Path) -> None:
    path = tmp_path / "runs" / LOCK_FILE
    path.parent.mkdir()
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for note, who in (
            ('{"pid": 7, "user": "ada", "host": "hall\\u001b[2J"}', "user ada, pid 7 on hall"),
            ("no note", "it does not say which"),
        ):
            path.write_text(note)
            refused = str(refusal(owned))
            assert f"has an engine already ({who}" in refused
            assert "\x1b" not in refused
    with held(owned) as got:
        assert (got.remarks, holder_in(path).pid) == ((), os.getpid())


def test_without_locks_an_engine_is_kept_off_by_those_that_are_found(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    thaw = threading.Event()

    def hangs(_folder: Path) -> int:
        assert thaw.wait(50.0)
        raise OSError(37, "No locks available")

    monkeypatch.setattr(ownership, "lock_results", hangs)
    with monkeypatch.context() as patched:
        patched.setattr(ownership, "_LOCKING_TIME", 0.05)
        with held(owned) as hung:
            assert "it does not answer: other engines are not kept off" in str(hung.remarks)
    thaw.set()
    with held(owned) as got:
        assert "No locks available: other engines are not kept off " in str(got.remarks)
    with answering(owned):
        other = owned_by(SourceKind.SIMULATED, "another", results=owned.results)
        assert "an engine already" in str(refusal(other))


NOBODY = 65534

_BECOME = f"""
import os
os.setgroups([])
os.setresgid({NOBODY}, {NOBODY}, {NOBODY})
os.setresuid({NOBODY}, {NOBODY}, {NOBODY})
"""


@contextmanager
def stranger(
    program: str, *arguments: object, imports: str = ""
) -> Iterator[subprocess.Popen[str]]:
    """A Python program of another user while inside; `imports` run before it is one."""
    if os.getuid() != 0:
        pytest.skip("only root can be another user")
    with subprocess.Popen(
        [sys.executable, "-c", imports + _BECOME + program, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def said_by_stranger(program: str, *arguments: object, imports: str = "") -> str:
    with stranger(program, *arguments, imports=imports) as process:
        return process.communicate(timeout=60.0)[0].strip()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


@contextmanager
def open_folder() -> Iterator[Path]:
    """A folder that every user can reach and write, while inside."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as name:
        folder = Path(name)
        folder.chmod(0o777)
        yield folder


SECOND_USER = """
import sys
from pathlib import Path
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.ipc.ownership import held
from madrob_console.engine.ipc.engine_lock import owned_by
"""
HOLDS = """
os.environ["XDG_STATE_HOME"] = sys.argv[1]
try:
    with held(owned_by(SourceKind.ROS, 3, results=Path(sys.argv[2]))) as got:
        print("holds it", *got.remarks, flush=True)
        if len(sys.argv) > 3:
            sys.stdin.read()
except MadrobError as error:
    print(error)
"""


LOCKS = """
for path in sys.argv[1:]:
    try:
        file = os.open(path, os.O_RDONLY)
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        print("locked", flush=True)
    except OSError as error:
        print(error.strerror, flush=True)
sys.stdin.read()
"""


@pytest.mark.machine
@pytest.mark.parametrize("mode", [0o777, 0o1777])
def test_a_results_folder_of_two_users_has_one_engine_and_the_second_is_told_whose(
    mode: int, owned: Owned
) -> None:
    with open_folder() as folder:
        results = folder / "runs"
        results.mkdir()
        results.chmod(mode)
        mine = owned_by(SourceKind.SIMULATED, "mine", results=results)
        words = folder / "state", results
        with held(mine):
            said = said_by_stranger(HOLDS, *words, imports=SECOND_USER)
            where = f"{results} has an engine already (user root, pid {os.getpid()} on "
            assert said.startswith(where)
        (results / LOCK_FILE).unlink()
        with stranger(HOLDS, *words, "and stays", imports=SECOND_USER) as other:
            assert line_of(other) == "holds it\n"
            assert "(user nobody, pid " in str(refusal(mine))
        with held(mine) as got:  # the file of the other user is there, and is free
            assert got.remarks == ()


def test_a_folder_whose_lock_cannot_be_opened_is_refused(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether another user's engine has the folder cannot be seen."""
    with held(owned):
        pass
    refuses = Mock(side_effect=PermissionError(13, "Permission denied"))
    monkeypatch.setattr(ownership, "lock_results", refuses)
    assert "is another user's: delete it, or use another" in str(refusal(owned))


@pytest.mark.machine
def test_who_may_only_read_a_results_folder_can_lock_no_engine_out() -> None:
    with open_folder() as folder:
        results = folder / "runs"
        results.mkdir(mode=0o755)
        mine = owned_by(SourceKind.SIMULATED, "mine", results=results)
        with held(mine):
            pass  # its file is there
        with stranger(
            LOCKS, results, results / LOCK_FILE, imports="import fcntl, sys\n"
        ) as process:
            # a lock on the folder would block
            assert [line_of(process) for _ in range(2)] == ["locked\n", "Permission denied\n"]
            with held(mine) as got:
                assert got.remarks == ()


@pytest.mark.parametrize("words", ["Not a directory", "no plain file"])
def test_a_folder_that_cannot_be_locked_is_said_and_not_waited_for(
    tmp_path: Path, words: str
) -> None:
    results = tmp_path / "place" / "runs"
    if words == "no plain file":
        results.mkdir(parents=True)
        os.mkfifo(results / LOCK_FILE)
    else:
        results.parent.touch()
    with held(owned_by(SourceKind.SIMULATED, tmp_path, results=results)) as got:
        assert words in got.remarks[0]


def test_a_domain_has_one_engine_also_when_the_first_one_does_not_answer_yet(
    tmp_path: Path,
) -> None:
    first, second = (owned_by(SourceKind.ROS, DOMAIN, results=tmp_path / name) for name in "ab")
    with held(first):
        assert f"ROS domain {DOMAIN} has an engine already" in str(refusal(second))
    with held(second):
        pass  # nothing is left of the first


DOMAIN = 101 + os.getpid() % 100


def test_a_second_engine_in_a_ros_domain_is_told_of_the_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--testbed", "ros", "--domain", str(DOMAIN))
    known = WhoAnswer(wire=5, testbed=f"LIVE ros domain {DOMAIN}", console=options)
    with answering(owned_by(SourceKind.ROS, DOMAIN, results=tmp_path / "a"), known):
        monkeypatch.setenv("ROS_DOMAIN_ID", f" {DOMAIN} ")
        serve = ["engine", "serve", "--testbed", "ros", f"--results={tmp_path / 'b'}"]
        assert main(serve) == 75
        said = capsys.readouterr().err
        who = f"(LIVE ros domain {DOMAIN}, pid {os.getpid()}, since "
        assert said.startswith(f"madrob: ROS domain {DOMAIN} has an engine already {who}")
        assert f"`madrob console {shlex.join(options)}` attaches to it" in said
        assert f"`madrob engine stop --pid {os.getpid()}` ends it\n" in said
        assert main(["run", "--testbed", "ros", "--subject", "3", f"--results={tmp_path}"]) == 2


def refused_state(state: str, results: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What an engine says that can use no state folder there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", state)
        ros = ["engine", "serve", "--testbed", "ros", f"--domain={DOMAIN}", f"--results={results}"]
        assert main(ros) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert f"{state}/madrob" in said
    assert "set XDG_STATE_HOME to a folder of your own" in said
    return said


def test_a_state_folder_that_is_not_this_user_s_alone_is_named_with_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "File exists" in refused_state("/dev/null/state", tmp_path, capsys)
    state_folder().chmod(0o777)
    said = refused_state(os.environ["XDG_STATE_HOME"], tmp_path, capsys)
    assert "others may change it" in said


@pytest.mark.machine
@pytest.mark.parametrize(
    ("mounted", "why"), [("ro", "Read-only file system"), ("rw,nr_inodes=4", "No space left")]
)
def test_a_state_folder_that_takes_no_file_is_named_with_the_remedy(
    mounted: str,
    why: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can mount")
    place = tmp_path / "place"
    folder = place / "madrob" / socket.gethostname()
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "nr_inodes=4", "none", place], check=True)
    try:
        folder.mkdir(parents=True, mode=0o700)
        subprocess.run(["mount", "-o", f"remount,{mounted}", place], check=True)
        if mounted != "ro":
            (folder / "full").touch()
        assert why in refused_state(str(place), tmp_path, capsys)
        monkeypatch.setenv("XDG_STATE_HOME", str(place))
        assert (look_at_state_folder().severity is Severity.ERROR) == (mounted == "ro")
    finally:
        subprocess.run(["umount", place], check=True)


# ------------------------------------------------------------------ strangers, and hangs


CALLS = """
for address in sys.argv[1:]:
    with socket.socket(socket.AF_UNIX) as caller:
        try:
            caller.connect(address)
            print("connected")
        except OSError as error:
            print(error.strerror)
"""


@pytest.mark.machine
@pytest.mark.parametrize("mode", [0o700, 0o755])
def test_no_other_user_can_call_an_engine(
    mode: int, owned: Owned, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    before = os.umask(0)
    request.addfinalizer(lambda: os.umask(before))
    with open_folder() as folder:
        monkeypatch.setenv("XDG_STATE_HOME", str(folder))
        for path in (state_folder().parent, state_folder()):
            path.chmod(mode)
        with answering(owned) as (_, stem):
            there = state_folder() / f"{stem}.sock"
            assert there.is_socket()
            said = said_by_stranger(CALLS, there, imports="import socket, sys\n")
            assert said == "Permission denied"
            assert ask(stem, Who(), 10.0) == KNOWN


def test_the_files_of_an_engine_that_was_killed_are_passed_over(owned: Owned) -> None:
    listen_as(owned.stem).close()
    lock = state_folder() / f"{owned.stem}.lock"
    lock.write_bytes(msgspec.json.encode(Holder(os.getpid())))
    assert find_engine(owned.stem) is None
    assert running_engines() == ()
    with answering(owned):
        (found,) = running_engines()
        assert (found.pid, found.answer) == (os.getpid(), KNOWN)


def test_another_program_on_the_socket_is_no_engine_and_is_not_ended(owned: Owned) -> None:
    """A file of a testbed may name a process that has nothing to do with it any more."""
    lock = state_folder() / f"{owned.stem}.lock"
    with answering(owned):
        (found,) = running_engines()
    lock.write_bytes(msgspec.json.encode(Holder(os.getpid())))
    with listen_as(owned.stem):
        began = time.monotonic()
        assert running_engines() == ()  # it says nothing
        assert time.monotonic() - began < 2 * discovery.PATIENCE
        with pytest.raises(ProcessLookupError), process_of(found):
            pass
        with held(owned):  # and keeps no engine from its place
            pass


@pytest.mark.machine
def test_an_engine_that_hangs_with_a_full_backlog_is_found_and_named_at_once(
    owned: Owned, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine_sockets, "_BACKLOG", 0)
    with held(owned), closing(connect_to(owned.stem, 1.0)):
        began = time.monotonic()
        found = find_engine(owned.stem)
        with pytest.raises(TimeoutError):
            RemoteEngine(owned.stem, Role.REFEREE, "ada")
        assert time.monotonic() - began < 0.5
        assert found is not None
        assert (found.pid, found.answer) == (os.getpid(), None)
        refused = refusal(owned)
        assert (refused.same, f"pid {os.getpid()}, since" in str(refused)) == (True, True)
        with process_of(found):
            pass
