from __future__ import annotations

import os
import pwd
from collections.abc import Sequence
from pathlib import Path

import pytest

from madrob_console.engine.process.place import runtime_folder
from madrob_console.preparing.doctor_session import kills_processes, look_at_session
from madrob_console.preparing.finding import Finding, Severity

USER = pwd.getpwuid(os.getuid()).pw_name
SERVICE = "run it as a service (`madrob engine unit`)"


def silent(_command: Sequence[str]) -> str | None:
    return None


def says(word: str) -> str:
    return f"b {word}\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A system that systemd runs, with nothing set."""
    (tmp_path / "run/systemd/system").mkdir(parents=True)
    return tmp_path


def configure(root: Path, path: str, *lines: str) -> None:
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join(("[Login]", *lines, "")))


def found(root: Path, told: str | None = None, **environment: str) -> dict[str, Finding]:
    findings = look_at_session(environment, root, lambda _: told)
    return {finding.subject: finding for finding in findings}


def test_without_systemd_nothing_is_wrong(tmp_path: Path) -> None:
    findings = found(tmp_path)
    assert findings["log-out"].text == "no systemd here: it ends no engine"
    assert {finding.severity for finding in findings.values()} == {Severity.OK}


def test_where_the_socket_lies_is_told_and_what_to_do_without_a_folder_of_the_login(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own"
    own.mkdir(mode=0o700)
    wide = tmp_path / "wide"
    wide.mkdir(mode=0o755)
    for given, severity, words in (
        (str(own), Severity.OK, ""),
        ("", Severity.WARNING, ": XDG_RUNTIME_DIR is not set, as after"),
        (str(wide), Severity.WARNING, f"{wide}, which cannot be used, as after"),
    ):
        monkeypatch.setenv("XDG_RUNTIME_DIR", given)
        socket = found(root, XDG_RUNTIME_DIR=given)["socket"]
        assert socket.severity is severity
        assert socket.text.startswith(str(runtime_folder()))
        assert words in socket.text
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(own))
    (own / "madrob").chmod(0o755)
    assert found(root, XDG_RUNTIME_DIR=str(own))["socket"].severity is Severity.ERROR


def test_lingering_is_told_with_its_remedy(root: Path) -> None:
    off = found(root)["linger"]
    assert off.severity is Severity.WARNING
    assert "`loginctl enable-linger`" in off.text
    linger = root / "var/lib/systemd/linger" / USER
    linger.parent.mkdir(parents=True)
    linger.touch()
    assert found(root)["linger"].severity is Severity.OK


@pytest.mark.parametrize(
    ("told", "severity", "words"),
    [
        (says("true"), Severity.WARNING, SERVICE),
        (says("false"), Severity.OK, "KillUserProcesses=no"),
        (None, Severity.WARNING, "not known"),
        ("nonsense", Severity.WARNING, "not known"),
    ],
)
def test_what_a_log_out_ends_is_told_as_logind_says_it(
    told: str | None, severity: Severity, words: str, root: Path
) -> None:
    configure(root, "etc/systemd/logind.conf", "KillExcludeUsers=")
    log_out = found(root, told)["log-out"]
    assert log_out.severity is severity
    assert words in log_out.text


def test_where_logind_says_nothing_its_settings_count_the_last_one_most(root: Path) -> None:
    assert kills_processes("ada", root, silent) is None
    configure(root, "usr/lib/systemd/logind.conf", "KillUserProcesses=yes")
    assert kills_processes("ada", root, silent) is True
    configure(root, "etc/systemd/logind.conf", "#KillUserProcesses=yes", "KillUserProcesses = no")
    assert kills_processes("ada", root, silent) is False
    configure(root, "usr/lib/systemd/logind.conf.d/50-kill.conf", "KillUserProcesses=yes")
    assert kills_processes("ada", root, silent) is True
    configure(root, "etc/systemd/logind.conf.d/50-kill.conf", "KillUserProcesses=no")
    assert kills_processes("ada", root, silent) is False
    configure(root, "run/systemd/logind.conf.d/60-kill.conf", "KillUserProcesses=1")
    assert kills_processes("ada", root, silent) is True


def test_users_that_are_left_out_are_not_told_that_they_lose_anything(root: Path) -> None:
    def asked(_command: Sequence[str]) -> str | None:
        return says("true")

    assert kills_processes("root", root, asked) is False
    configure(root, "etc/systemd/logind.conf", "KillExcludeUsers=ada bob")
    assert kills_processes("ada", root, asked) is False
    assert kills_processes("root", root, asked) is True
    configure(root, "etc/systemd/logind.conf", "KillOnlyUsers=bob")
    assert kills_processes("ada", root, asked) is False
    assert kills_processes("bob", root, asked) is True


def test_a_file_that_is_none_tells_nothing(root: Path) -> None:
    (root / "etc/systemd").mkdir(parents=True)
    (root / "etc/systemd/logind.conf").write_bytes(b"no section\xff\n[Login\n")
    assert kills_processes("ada", root, silent) is None
