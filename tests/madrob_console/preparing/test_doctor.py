from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
import textwrap
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import pytest

from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.preparing.doctor import (
    doctor,
    line,
    look_at_python,
    look_at_results,
    look_at_terminal,
    usable,
    verdict,
)
from madrob_console.preparing.doctor_ros import look_at_installation
from madrob_console.preparing.finding import Finding, Level
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated_node import serve_testbed
from tests.madrob_console import said
from tests.madrob_console.ros_peer import BEST_EFFORT, BOOL, Peer, Taker, source

ROOT = Path(__file__).parents[3]


def by_subject(findings: Iterable[Finding]) -> dict[str, Finding]:
    return {f.subject: f for f in findings}


@pytest.mark.machine
def test_a_live_testbed_is_shown_topic_by_topic(ros_domain: int, tmp_path: Path) -> None:
    stop = threading.Event()
    node = threading.Thread(
        target=serve_testbed,
        args=(SimulatedTestbed(), None, 0),
        kwargs={"say": lambda _: None, "stop": stop},
    )
    node.start()
    try:
        found = by_subject(doctor(DEFAULT_MAPPINGS, tmp_path, listen=1.0))
    finally:
        stop.set()
        node.join()
    for mapping in DEFAULT_MAPPINGS[:6]:
        finding = found[mapping.topic]
        assert finding.level is Level.OK
        assert finding.text.startswith(f"1 publisher, {mapping.type}, ")
        assert float(finding.text.split()[-2]) == pytest.approx(50, abs=10)
    assert found["/madrob/door/locked"] == Finding(
        Level.OK, "/madrob/door/locked", "no publisher (optional)"
    )
    assert found["/madrob/door"].level is Level.OK
    assert found["ros domain"].text == str(ros_domain)
    assert found["middleware"].text.startswith("rmw_")
    assert "console" not in found


@pytest.mark.machine
@pytest.mark.usefixtures("ros_domain")
def test_findings_come_one_by_one_and_nobody_is_listened_to_who_does_not_send(
    tmp_path: Path,
) -> None:
    began = time.monotonic()
    findings = doctor(DEFAULT_MAPPINGS, tmp_path, listen=60.0)
    assert next(findings).subject == "python"
    assert time.monotonic() - began < 2
    found = by_subject(findings)
    assert found[DEFAULT_MAPPINGS[0].topic].text == "no publisher: start the testbed"
    assert time.monotonic() - began < 30


@pytest.mark.slow
def test_what_is_wrong_with_topics_is_said(peer: Peer, tmp_path: Path) -> None:
    silent, wrong, _ = (m.topic for m in DEFAULT_MAPPINGS[:3])
    peer.publisher(silent, DEFAULT_MAPPINGS[0].type, BEST_EFFORT)
    peer.publisher(wrong, BOOL)
    twice = [peer.publisher(DEFAULT_MAPPINGS[3].topic, DEFAULT_MAPPINGS[3].type) for _ in range(2)]
    enough = threading.Event()

    def publish() -> None:
        while not enough.wait(0.05):
            twice[0].publish(twice[0].msg_type())

    thread = threading.Thread(target=publish)
    thread.start()
    with Taker(source()) as other:
        other.source.publish(said.state("idle"))
        found = by_subject(doctor(DEFAULT_MAPPINGS, tmp_path, listen=0.5))
    enough.set()
    thread.join()
    assert found[silent].text == (
        "1 publisher, sensor_msgs/msg/JointState, but silent: look at its sensor"
    )
    assert found[wrong].text == (
        "its type is std_msgs/msg/Bool, not geometry_msgs/msg/WrenchStamped: correct the settings"
    )
    assert found[DEFAULT_MAPPINGS[2].topic].text == "no publisher: start the testbed"
    assert found[DEFAULT_MAPPINGS[3].topic].text.endswith(" Hz: stop all but one")
    assert found["console"].text.startswith("another one runs in domain ")
    assert found["/madrob/door"].text == "not there: the sides must be set by hand"
    assert {found[s].level for s in (silent, wrong, "console")} == {Level.WARNING}
    assert usable(list(found.values()))


@pytest.mark.machine
def test_without_ros_it_says_what_to_install_and_the_console_is_usable(tmp_path: Path) -> None:
    program = f"""
        import sys
        from pathlib import Path
        sys.modules["rclpy"] = None  # as if it were not installed
        from madrob_console.preparing.doctor import doctor, line, verdict
        from madrob_console.messages.codec import DEFAULT_MAPPINGS
        findings = list(doctor(DEFAULT_MAPPINGS, Path({str(tmp_path)!r})))
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


@pytest.mark.parametrize("domain", ["door", "-1", "233"])
def test_a_domain_that_does_not_exist_is_an_error(tmp_path: Path, domain: str) -> None:
    findings = list(doctor(DEFAULT_MAPPINGS, tmp_path, environment={"ROS_DOMAIN_ID": domain}))
    assert by_subject(findings)["ros domain"].level is Level.ERROR
    assert not usable(findings)


@pytest.mark.parametrize(
    ("environment", "subject", "level", "text"),
    [
        ({}, "discovery", Level.OK, "SUBNET"),
        ({"ROS_DOMAIN_ID": "7"}, "ros domain", Level.OK, "7"),
        (
            {"ROS_DOMAIN_ID": "150"},
            "ros domain",
            Level.WARNING,
            "150: its ports may be taken, use 0 to 101",
        ),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            "discovery",
            Level.OK,
            "LOCALHOST: only testbeds on this machine",
        ),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
            "discovery",
            Level.WARNING,
            "OFF: nobody is found, unset it",
        ),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_STATIC_PEERS": "10.0.0.2"},
            "discovery",
            Level.OK,
            "OFF, peers 10.0.0.2",
        ),
    ],
)
def test_how_ros_is_set_up_is_shown(
    tmp_path: Path, environment: Mapping[str, str], subject: str, level: Level, text: str
) -> None:
    findings = doctor(DEFAULT_MAPPINGS, tmp_path, listen=0, environment=environment)
    assert by_subject(findings)[subject] == Finding(level, subject, text)


@pytest.mark.usefixtures("ros_domain")
def test_a_system_ros_beside_the_wheels_is_warned_of(tmp_path: Path) -> None:
    if "wheels" not in next(look_at_installation({}, tmp_path)).text:
        pytest.skip("ROS is not installed as wheels")
    (tmp_path / "jazzy/share").mkdir(parents=True)
    *_, warning = look_at_installation({}, tmp_path)
    assert warning.level is Level.WARNING
    assert warning.text.startswith(f"both {tmp_path}/jazzy and wheels are installed")


def test_python_and_every_library_are_named() -> None:
    found = by_subject(list(look_at_python()))
    assert found["python"].text.startswith(".".join(map(str, sys.version_info[:3])))
    assert "rosbags 0." in found["packages"].text
    assert {f.level for f in found.values()} == {Level.OK}


def test_the_results_folder_need_not_exist_but_must_be_writable(tmp_path: Path) -> None:
    (good,) = look_at_results(tmp_path / "new/runs", 1)
    assert good.level is Level.OK
    assert good.text.startswith(f"{tmp_path}/new/runs: ")
    (tmp_path / "file").touch()
    (bad,) = look_at_results(tmp_path / "file/runs", 1)
    assert bad == Finding(
        Level.ERROR,
        "results",
        f"{tmp_path}/file/runs cannot be written: set results.folder to another",
    )
    (full,) = look_at_results(tmp_path, 10**18)
    assert full.level is Level.WARNING
    assert full.text.endswith("less than 1000000000.0 GB: make room")


def test_output_that_goes_elsewhere_is_no_fault() -> None:
    assert next(look_at_terminal({})).level is Level.OK


@pytest.mark.machine
@pytest.mark.parametrize(
    ("term", "size", "level", "text"),
    [
        ("xterm-256color", (100, 30), Level.OK, "xterm-256color, 256 colours, 100x30"),
        ("xterm", (80, 24), Level.OK, "xterm, 16 colours, 80x24"),
        (
            "xterm",
            (60, 20),
            Level.WARNING,
            "xterm, 16 colours, 60x20: enlarge it to 80x24",
        ),
        ("dumb", (80, 24), Level.WARNING, "TERM=dumb draws no screens: use TERM=xterm-256color"),
    ],
)
def test_a_terminal_is_judged_by_kind_and_size(
    term: str, size: tuple[int, int], level: Level, text: str
) -> None:
    said = in_terminal(term, *size)
    assert line(Finding(level, "terminal", text)) in said
    assert line(Finding(Level.OK, "characters", "UTF-8")) in said


def in_terminal(term: str, columns: int, lines: int) -> str:
    """What the doctor says of the terminal in a terminal of its own."""
    program = """
        import os
        from madrob_console.preparing.doctor import line, look_at_terminal
        print(*map(line, look_at_terminal(os.environ)), sep="\\n")
    """
    environment = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "COLORTERM")}
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=ROOT,
        env={**environment, "TERM": term, "PYTHONUTF8": "1"},
        stdin=theirs,
        stdout=theirs,
    )
    os.close(theirs)
    text = b""
    with suppress(OSError):  # the other end is closed
        while chunk := os.read(ours, 4096):
            text += chunk
    os.close(ours)
    assert process.wait(10) == 0
    return text.decode()


def test_a_check_that_breaks_is_a_finding_of_its_own(tmp_path: Path) -> None:
    before = time.monotonic()
    findings = list(doctor(None, tmp_path, listen=0.1, environment={"TERM": "xterm"}))  # type: ignore[arg-type]
    assert time.monotonic() - before < 5
    assert all("\n" not in f.text for f in findings)
    assert by_subject(findings)["ros"].text


def test_the_report_ends_with_a_verdict() -> None:
    good = Finding(Level.OK, "python", "3.11")
    warning = Finding(Level.WARNING, "ros", "not found")
    error = Finding(Level.ERROR, "results", "cannot be written")
    assert line(good) == "ok       python                     3.11"
    assert verdict([good]) == "usable"
    assert verdict([good, warning]) == "usable, 1 warning"
    assert verdict([error]) == "not usable: see the errors above"
    assert not usable([good, warning, error])
