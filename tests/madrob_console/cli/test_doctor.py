from __future__ import annotations

import fcntl
import json
import os
import pwd
import re
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from madrob_console.cli.doctor import (
    doctor,
    look_at_lists,
    look_at_results,
    look_at_state_folder,
    look_at_terminal,
    usable,
    verdict,
)
from madrob_console.cli.doctor_evidence import look_at_evidence
from madrob_console.cli.doctor_ros import look_at_installation, other_users, overheard
from madrob_console.cli.finding import Finding, Severity, line
from madrob_console.cli.output import BAD_INPUT
from madrob_console.engine.ipc.engine_sockets import state_folder
from madrob_console.messages.codec import ROBOT_STARTED_TOPIC
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.competition_plan import PlanSource
from madrob_console.referee.team_list import TeamSource
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated_node import serve_testbed
from madrob_console.testbeds.source import Source
from scoring.protocol import Signal
from tests.madrob_console import said
from tests.madrob_console.cli.typed import Screen
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.ros_peer import (
    BEST_EFFORT,
    BOOL,
    Kind,
    Peer,
    Stream,
    Taker,
    cameras,
    source,
)

ROOT = Path(__file__).parents[3]


def by_subject(findings: Iterable[Finding]) -> dict[str, Finding]:
    return {f.subject: f for f in findings}


@contextmanager
def beside(work: Callable[[threading.Event], object]) -> Iterator[None]:
    """Work in a thread, until the event is set."""
    enough = threading.Event()
    thread = threading.Thread(target=work, args=(enough,))
    thread.start()
    try:
        yield
    finally:
        enough.set()
        thread.join()


def published(publisher: Any, **fields: object) -> AbstractContextManager[None]:  # noqa: ANN401
    """The same message all the time."""

    def publish(enough: threading.Event) -> None:
        while not enough.wait(0.05):
            publisher.publish(publisher.msg_type(**fields))

    return beside(publish)


def examined(folder: Path, listen: float, *mappings: TopicMapping) -> dict[str, Finding]:
    return by_subject(doctor(mappings or DEFAULT_MAPPINGS, folder, disk_space=1, listen=listen))


@pytest.mark.machine
def test_a_live_testbed_is_shown_topic_by_topic(ros_domain: int, tmp_path: Path) -> None:
    def serve(enough: threading.Event) -> None:
        serve_testbed(SimulatedTestbed(), None, 0, say=lambda _: None, stop=enough)

    with beside(serve):
        found = examined(tmp_path, 1.0)
    for mapping in DEFAULT_MAPPINGS[:6]:
        finding = found[mapping.topic]
        assert finding.severity is Severity.OK
        assert finding.text.startswith(f"1 publisher, {mapping.type}, ")
        assert float(finding.text.split()[-2]) == pytest.approx(50, abs=10)
    assert found["/madrob/door/locked"] == Finding(
        Severity.OK, "/madrob/door/locked", "no publisher (optional)"
    )
    assert found["/madrob/door"].severity is Severity.OK
    assert found["ros domain"].text == str(ros_domain)
    assert "console" not in found


FILLED = """
mount -t tmpfs -o size=16m tmpfs /dev/shm || exit 77
dd if=/dev/zero of=/dev/shm/fill bs=4k count=10000 2>/dev/null
truncate -s -$1 /dev/shm/fill
shift
exec "$@"
"""


@pytest.mark.machine
@pytest.mark.parametrize(("free", "verdict"), [(0, "not usable: "), (400_000, "usable, ")])
def test_full_shared_memory_is_named_and_the_doctor_gets_to_the_end(
    ros_domain: int, free: int, verdict: str
) -> None:
    doctoring = [sys.executable, "-m", "madrob_console.cli.main", "doctor"]
    ended = subprocess.run(
        ["unshare", "-m", "sh", "-c", FILLED, "sh", str(free), *doctoring],
        env={**os.environ, "ROS_DOMAIN_ID": str(ros_domain)},
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode == 77 or "unshare" in ended.stderr:
        pytest.skip("a mount of its own is not allowed here")
    lines = ended.stdout.splitlines()
    assert lines[-1].startswith(verdict)
    assert all(re.match(r"(ok|warning|error) ", text) for text in lines[:-1])
    if free == 0:
        assert any("the system ends programs that load ROS then" in text for text in lines)
    else:
        assert sum(text.startswith("warning  ros says ") for text in lines) in range(1, 6)
    assert ended.stderr == ""


CYCLONE = "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, but only rmw_fastrtps_cpp is installed: "
UNABLE = [
    ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, CYCLONE),
    ({"RCL_ASSERT_RMW_ID_MATCHES": "rmw_other_cpp"}, "ROS ended the program that tried it"),
    (
        {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"},
        "ROS_SECURITY_ENABLE=true needs ROS_SECURITY_KEYSTORE",
    ),
]


def madrob(line: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, which ROS may end."""
    return subprocess.run(
        [sys.executable, "-m", "madrob_console.cli.main", *line.split()],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.mark.machine
@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(("environment", "words"), UNABLE)
def test_ros_that_cannot_start_is_an_error(environment: dict[str, str], words: str) -> None:
    ended = madrob("doctor --json", **environment)
    said = json.loads(ended.stdout)
    errors = [one["text"] for one in said["findings"] if one["severity"] == "error"]
    assert (ended.returncode, said["passed"], len(errors)) == (BAD_INPUT, False, 1)
    assert words in errors[0]


@pytest.mark.machine
@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("line", ["testbed", "run --testbed ros", "engine serve --testbed ros"])
def test_missing_middleware_is_a_refusal(line: str) -> None:
    ended = madrob(line, RMW_IMPLEMENTATION="rmw_cyclonedds_cpp")
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (BAD_INPUT, "", 1)
    assert ended.stderr.startswith(f"madrob: {CYCLONE}")


@pytest.mark.machine
def test_absent_discovery_server_is_named(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"127.0.0.1:{11_811 + ros_domain}")
    door = DEFAULT_MAPPINGS[0]
    text = examined(tmp_path, 0.1, door)[door.topic].text
    assert "or correct ROS_DISCOVERY_SERVER=127.0.0.1:" in text


def test_other_users_are_those_whose_programs_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fastrtps_1_el").touch()
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    stale = other_users(tmp_path)
    with (tmp_path / "fastrtps_1_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        running = other_users(tmp_path)
    assert (stale, running) == ("", pwd.getpwuid(os.getuid()).pw_name)


def test_what_libraries_write_past_python_is_caught_once_each(
    capfd: pytest.CaptureFixture[str],
) -> None:
    error = (
        b"\x1b[37;1m2026-11-22 07:52:52.650 \x1b[31;1m[SHM Error]\x1b[0m no room -> Function f\n"
    )
    with overheard() as lines:
        assert lines == []
        for _ in range(3):
            os.write(1, error)
            os.write(2, b"and\n\n")
    assert lines == ["[SHM Error] no room", "and"]
    os.write(1, b"heard again\n")
    out, err = capfd.readouterr()
    assert (out, err) == ("heard again\n", "")


@pytest.mark.slow
@pytest.mark.machine
def test_what_is_wrong_with_topics_is_said(peer: Peer, tmp_path: Path) -> None:
    silent, wrong, absent, twice = DEFAULT_MAPPINGS[:4]
    peer.publisher(silent.topic, silent.type, BEST_EFFORT)
    peer.publisher(wrong.topic, BOOL)
    peer.publisher(ROBOT_STARTED_TOPIC, BOOL)
    first, second = (peer.publisher(twice.topic, twice.type) for _ in range(2))
    with (
        published(first, ranges=[1.0] * 4, range_max=4.0),
        published(second, ranges=[1.0] * 4, range_max=4.0),
        Taker(source()) as other,
    ):
        other.source.publish(said.state("idle"))
        found = examined(tmp_path, 2.0)
    expected = {
        silent.topic: "1 publisher, sensor_msgs/msg/JointState, but silent: look at its sensor",
        wrong.topic: (
            "its type is std_msgs/msg/Bool, not geometry_msgs/msg/WrenchStamped: "
            "correct the settings"
        ),
        ROBOT_STARTED_TOPIC: (
            "its type is std_msgs/msg/Bool, not std_msgs/msg/Empty: correct the robot's program"
        ),
        absent.topic: "no publisher: start the testbed",
        "/madrob/door": "not there: the sides must be set by hand",
    }
    assert {topic: found[topic].text for topic in expected} == expected
    assert found[twice.topic].text.endswith(" Hz: stop all but one")
    assert found["console"].text.startswith("one runs in domain ")
    warned = (silent.topic, wrong.topic, "console")
    assert {found[subject].severity for subject in warned} == {Severity.WARNING}
    assert usable(list(found.values()))


@pytest.mark.slow
@pytest.mark.machine
def test_an_index_into_several_names_is_said(peer: Peer, tmp_path: Path) -> None:
    mapping = DEFAULT_MAPPINGS[0]
    with published(
        peer.publisher(mapping.topic, mapping.type), name=["lock", "door"], position=[0.0, 0.5]
    ):
        findings = list(doctor([mapping], tmp_path, disk_space=1, listen=2.0))
    text = "position[0] is 'lock', one of 2 names: use position[name=...]"
    assert [one for one in findings if "names" in one.text] == [
        Finding(Severity.WARNING, mapping.topic, text)
    ]


@pytest.mark.slow
@pytest.mark.machine
def test_joints_of_others_are_not_counted(peer: Peer, tmp_path: Path) -> None:
    mapping = replace(DEFAULT_MAPPINGS[0], field="position[name=door]")
    door, arm = (peer.publisher(mapping.topic, mapping.type) for _ in range(2))
    with (
        published(door, name=["door"], position=[0.5]),
        published(arm, name=["elbow"], position=[0.5]),
    ):
        found = examined(tmp_path, 2.0, mapping)[mapping.topic]
    assert found.severity is Severity.OK
    assert found.text.startswith(f"2 publishers, {mapping.type}, ")
    assert float(found.text.split()[-2]) == pytest.approx(20, abs=5)


@pytest.mark.slow
@pytest.mark.machine
def test_range_outside_its_limits_is_said(peer: Peer, tmp_path: Path) -> None:
    mappings = [
        TopicMapping(Signal.CW_LEFT, f"/lab/range_{n}", "sensor_msgs/msg/Range", "range")
        for n in range(4)
    ]
    with ExitStack() as lab:
        for each in mappings:
            publisher = peer.publisher(each.topic, each.type)
            lab.enter_context(published(publisher, range=0.7, max_range=0.0))
        findings = list(doctor(mappings, tmp_path, disk_space=1, listen=2.0))
    text = "range 0: 0.70 m is outside of the message's limits 0..0"
    said = Finding(Severity.WARNING, mappings[3].topic, text)
    assert said in findings, findings


@pytest.mark.slow
@pytest.mark.machine
def test_a_mapping_is_proposed_from_what_is_heard(peer: Peer, tmp_path: Path) -> None:
    door, handle, strip = DEFAULT_MAPPINGS[:3]
    peer.publisher("/lab/range", "sensor_msgs/msg/Range")
    peer.publisher("/lab/latch", BOOL)
    peer.publisher(handle.topic, "geometry_msgs/msg/Wrench")
    joints = peer.publisher("/lab/joints", "sensor_msgs/msg/JointState")
    with published(joints, name=["lock", "door"], position=[0.0, 0.5]):
        found = examined(tmp_path, 0.1, door, handle, strip)
    expected = {
        "/lab/joints": "has lock, door: position[name=door]?",
        "/lab/range": "has sensor_msgs/msg/Range: range?",
        handle.topic: "has geometry_msgs/msg/Wrench: force.x?",
    }
    assert {topic: found[topic].text for topic in expected} == expected
    assert "/lab/latch" not in found


def test_an_answer_of_the_robot_that_cannot_be_taken_is_a_fault_now_and_of_the_run(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Source, "robot_problems", {ROBOT_STARTED_TOPIC: "its type is another one"})
    drive.start(make_setup())
    drive.wait(1.0)
    now, told = drive.engine.snapshot(), f"{ROBOT_STARTED_TOPIC}: its type is another one"
    assert told in now.faults
    assert told in [fault.text for fault in now.run.faults]


@pytest.mark.machine
def test_without_ros_it_says_what_to_install_and_the_console_is_usable(tmp_path: Path) -> None:
    program = f"""
        import sys
        from pathlib import Path
        sys.modules["rclpy"] = None  # as if it were not installed
        from madrob_console.cli.doctor import doctor, verdict
        from madrob_console.cli.finding import line
        from madrob_console.messages.mapping import DEFAULT_MAPPINGS
        findings = list(doctor(DEFAULT_MAPPINGS, Path({str(tmp_path)!r}), disk_space=1))
        print(*map(line, findings), verdict(findings), sep="\\n")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
    )
    (found,) = [one for one in done.stdout.splitlines() if " ros  " in one]
    assert found.startswith("warning")
    assert "only simulated: install madrob-console[ros]" in found
    assert done.stdout.splitlines()[-1].startswith("usable, ")
    assert done.stderr == ""


SET_UP = [
    ({"ROS_DOMAIN_ID": "door"}, "ros domain", Severity.ERROR, ""),
    ({"ROS_DOMAIN_ID": "-1"}, "ros domain", Severity.ERROR, ""),
    ({"ROS_DOMAIN_ID": "233"}, "ros domain", Severity.ERROR, ""),
    ({"ROS_DOMAIN_ID": "7"}, "ros domain", Severity.OK, "7"),
    ({}, "discovery", Severity.OK, "SUBNET"),
    ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "discovery", Severity.OK, "OFF"),
]


@pytest.mark.parametrize(("environment", "subject", "level", "text"), SET_UP)
def test_how_ros_is_set_up_is_shown(
    tmp_path: Path, environment: Mapping[str, str], subject: str, level: Severity, text: str
) -> None:
    all_of_it = doctor(DEFAULT_MAPPINGS, tmp_path, disk_space=1, listen=0, environment=environment)
    findings = list(all_of_it)
    found = by_subject(findings)[subject]
    assert found == Finding(level, subject, text or found.text)
    assert usable(findings) == (level is not Severity.ERROR)


@pytest.mark.machine
def test_a_machine_that_does_not_hear_itself_is_not_usable() -> None:
    command = ["unshare", "-n", sys.executable, "-m", "madrob_console.cli.main", "doctor"]
    said = subprocess.run(command, capture_output=True, check=False, text=True)
    if "unshare failed" in said.stderr:
        pytest.skip("no network can be made here")
    assert said.returncode == BAD_INPUT
    assert "this machine does not hear itself: `ip link set lo up`" in said.stdout


@pytest.mark.usefixtures("ros_domain")
def test_a_system_ros_beside_the_wheels_is_warned_of(tmp_path: Path) -> None:
    if "wheels" not in next(look_at_installation({}, tmp_path)).text:
        pytest.skip("ROS is not installed as wheels")
    (tmp_path / "jazzy/share").mkdir(parents=True)
    *_, warning = look_at_installation({}, tmp_path)
    assert warning.severity is Severity.WARNING
    assert warning.text.startswith(f"both {tmp_path}/jazzy and wheels are installed")


def test_the_results_folder_need_not_exist_but_must_be_writable(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (good,) = look_at_results(tmp_path / "new/runs", 1)
    (bad,) = look_at_results(tmp_path / "file/runs", 1)
    (full,) = look_at_results(tmp_path, 10**18)
    assert bad == Finding(
        Severity.ERROR,
        "results",
        f"{tmp_path}/file/runs cannot be written: set results.folder to another",
    )
    assert (good.severity, full.severity) == (Severity.OK, Severity.WARNING)
    assert good.text.startswith(f"{tmp_path}/new/runs: ")
    assert full.text.endswith("less than 1000000 TB: make room")


IN_TIME = "3,1,2,09:00\n4,1,1,09:10\n"
LISTS: dict[str, tuple[str | None, str | None, float | None, list[tuple[Severity, str, str]]]] = {
    "bad lines": (
        "3,Delft\n4,Ghent\nx,Late\n",
        "3,1,2\n7,1,1\n9,20,1\n3,21,1\n",
        None,
        [
            (
                Severity.WARNING,
                "teams",
                "teams.csv line 3: subject 'x' is no number from 1 to 999: write one",
            ),
            (
                Severity.WARNING,
                "plan",
                "plan.csv line 4: there is no condition '21': see `madrob plan --conditions`",
            ),
            (
                Severity.WARNING,
                "plan",
                "the plan has subject 7, 9, not in the list of teams: correct one of them",
            ),
        ],
    ),
    "good ones": (
        "3,Delft\n4,Ghent\n",
        IN_TIME,
        300.0,
        [
            (Severity.OK, "teams", "2 in the list"),
            (Severity.OK, "plan", "3 attempts, teams: 2, conditions: 1"),
        ],
    ),
    "too little time": (
        None,
        IN_TIME,
        301.0,
        [(Severity.WARNING, "plan", "the plan cannot be kept at 09:00: 10 min for 2 x 301 s")],
    ),
    "no such file": (
        None,
        "",
        None,
        [
            (
                Severity.WARNING,
                "plan",
                "plan plan.csv: cannot be read (No such file or directory); correct file of [plan]",
            )
        ],
    ),
    "no lists": (None, None, None, []),
}


@pytest.mark.parametrize("case", LISTS)
def test_the_lists_of_a_competition_are_looked_at_line_by_line(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    teams, plan, seconds, expected = LISTS[case]
    for name, text in {"teams.csv": teams, "plan.csv": plan}.items():
        if text:
            Path(name).write_text(text)
    sources = (
        TeamSource({}, None if teams is None else Path("teams.csv")),
        PlanSource(file=None if plan is None else Path("plan.csv")),
    )
    found = look_at_lists(*sources, *([] if seconds is None else [seconds]))
    assert [(one.severity, one.subject, one.text) for one in found] == expected


@pytest.mark.parametrize(
    ("term", "size", "encoding", "warned"),
    [
        ("xterm-256color", (100, 30), "utf-8", []),
        ("xterm", (80, 24), "utf-8", []),
        ("xterm", (60, 20), "utf-8", ["xterm, 60x20: enlarge it to 80x24"]),
        ("dumb", (80, 24), "utf-8", ["TERM=dumb draws no screens: use TERM=xterm-256color"]),
        ("xterm", (80, 24), "latin-1", ["latin-1: use a UTF-8 locale (LANG=C.UTF-8)"]),
    ],
)
def test_a_terminal_is_judged_by_kind_size_and_characters(
    term: str, size: tuple[int, int], encoding: str, warned: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(sys, "stdout", Screen(encoding))
    monkeypatch.setenv("COLUMNS", str(size[0]))
    monkeypatch.setenv("LINES", str(size[1]))
    found = list(look_at_terminal({"TERM": term}))
    assert [one.subject for one in found] == ["terminal", "characters"]
    assert [one.text for one in found if one.severity is Severity.WARNING] == warned
    good = {one.text for one in found if one.severity is Severity.OK}
    assert good <= {f"{term}, {size[0]}x{size[1]}", "UTF-8"}


def test_a_check_that_breaks_is_a_finding_of_its_own(tmp_path: Path) -> None:
    before = time.monotonic()
    findings = list(doctor(None, tmp_path, disk_space=1, listen=0.1, environment={"TERM": "xterm"}))  # type: ignore[arg-type]
    assert time.monotonic() - before < 5
    assert not any("\n" in f.text for f in findings)
    assert by_subject(findings)["ros"].text


def test_the_report_ends_with_a_verdict() -> None:
    good = Finding(Severity.OK, "python", "3.11")
    warning = Finding(Severity.WARNING, "ros", "not found")
    error = Finding(Severity.ERROR, "results", "cannot be written")
    assert line(good) == "ok       python                     3.11"
    assert verdict([good]) == "usable"
    assert verdict([good, warning]) == "usable, 1 warning"
    assert verdict([error]) == "not usable: see the errors above"
    assert not usable([good, warning, error])


HALL = Stream(Kind.JPEG, count=2, rate=20, size=50_000, reliable=True)


@pytest.mark.machine
def test_each_topic_beside_the_run_is_heard_or_not(ros_domain: int, peer: Peer) -> None:
    left, right = HALL.topics
    wanted = (left, right, "/camera/gone")
    with cameras(HALL):
        peer.until(lambda: peer.own.count_publishers(left))
        found = {f.subject: f for f in look_at_evidence(wanted, ros_domain, os.environ)}
    for topic in (left, right):
        assert re.fullmatch(rf"{HALL.kind.type}, [\d.]+ MB a minute", found[topic].text)
        assert found[topic].severity is Severity.OK
    gone = found["/camera/gone"]
    assert gone.severity is Severity.WARNING
    assert "not heard within 10 s" in gone.text


def test_where_an_engine_keeps_its_lock_is_told_and_what_is_wrong_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    good = look_at_state_folder()
    assert (good.severity, good.text) == (Severity.OK, str(state_folder()))
    assert state_folder().stat().st_mode & 0o777 == 0o700
    state_folder().chmod(0o777)
    open_to_all = look_at_state_folder()
    assert "set XDG_STATE_HOME to a folder of your own" in open_to_all.text
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null/state")
    assert {open_to_all.severity, look_at_state_folder().severity} == {Severity.ERROR}
