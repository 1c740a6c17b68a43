"""The doctor's look at what a log-out does to an engine, and at where its socket lies."""

from __future__ import annotations

import configparser
import os
import pwd
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from madrob_console.engine.process.place import runtime_folder
from madrob_console.errors import MadrobError
from madrob_console.preparing.finding import Finding, Severity

AS_A_SERVICE = "run it as a service (`madrob engine unit`)"
_CONFIGURED = ("etc/systemd", "run/systemd", "usr/local/lib/systemd", "usr/lib/systemd")
"""Where logind's settings lie; the first one with a file of some name has it."""

_PATIENCE = 3.0
_ASK_LOGIND = (
    *("busctl", "--system", "get-property", "org.freedesktop.login1", "/org/freedesktop/login1"),
    *("org.freedesktop.login1.Manager", "KillUserProcesses"),
)

RunCommand = Callable[[Sequence[str]], str | None]
"""Runs a command; what it prints, None where that is not possible."""


def answer_of(command: Sequence[str]) -> str | None:
    """What a command prints; None where there is none, or it fails, or takes too long."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=_PATIENCE
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout


def look_at_session(
    environment: Mapping[str, str], root: Path = Path("/"), ask: RunCommand = answer_of
) -> Iterator[Finding]:
    """Where the socket lies, and what ends an engine when its user logs out.

    Args:
        environment: environment variables.
        root: where the system's files are.
        ask: asks the running system.
    """
    managed = (root / "run/systemd/system").is_dir()
    yield _socket(environment, managed=managed)
    if not managed:
        yield Finding(Severity.OK, "log-out", "no systemd here: it ends no engine")
        return
    user = _user()
    lingers = (root / "var/lib/systemd/linger" / user).exists()
    kills = kills_processes(user, root, ask)
    yield _linger(user, lingers=lingers)
    yield _log_out(kills)


def _socket(environment: Mapping[str, str], *, managed: bool) -> Finding:
    try:
        folder = runtime_folder()
    except MadrobError as error:
        return Finding(Severity.ERROR, "socket", str(error))
    given = environment.get("XDG_RUNTIME_DIR", "")
    if given and folder.parent == Path(given):
        return Finding(Severity.OK, "socket", str(folder))
    what = f"XDG_RUNTIME_DIR is {f'{given}, which cannot be used' if given else 'not set'}"
    return Finding(
        Severity.WARNING if given or managed else Severity.OK,
        "socket",
        f"{folder}: {what}, as after `su` or `sudo`; log in as yourself, or set it to a folder of "
        "your own",
    )


def _linger(user: str, *, lingers: bool) -> Finding:
    if lingers:
        return Finding(Severity.OK, "linger", f"on: what is {user}'s outlives a log-out")
    return Finding(
        Severity.WARNING,
        "linger",
        "off: the last log-out removes the runtime folder and ends services of the user; "
        "`loginctl enable-linger` keeps them",
    )


def _log_out(kills: bool | None) -> Finding:
    if kills is None:
        text = f"not known whether it ends programs (KillUserProcesses): {AS_A_SERVICE}"
        return Finding(Severity.WARNING, "log-out", text)
    if kills:
        text = (
            f"it ends all programs, an engine and its run too (KillUserProcesses): {AS_A_SERVICE}"
        )
        return Finding(Severity.WARNING, "log-out", text)
    return Finding(Severity.OK, "log-out", "it leaves programs alone (KillUserProcesses=no)")


def kills_processes(user: str, root: Path, ask: RunCommand) -> bool | None:
    """Whether a log-out ends what a user started; None where nothing tells.

    What logind itself says comes first, then its settings; a build of systemd may have another
    default, which stands nowhere.
    """
    settings = _logind_settings(root)
    if user in settings.get("killexcludeusers", "root").split():
        return False
    if (only := settings.get("killonlyusers", "").split()) and user not in only:
        return False
    said = ask(_ASK_LOGIND)
    if said is not None and said.split()[:1] == ["b"]:
        return said.split()[1:] == ["true"]
    value = settings.get("killuserprocesses", "").lower()
    return None if not value else value in ("1", "yes", "y", "true", "t", "on")


def _logind_settings(root: Path) -> dict[str, str]:
    """The keys of [Login], in small letters; of two files the later one counts."""
    main = next(
        (file for place in _CONFIGURED if (file := root / place / "logind.conf").is_file()), None
    )
    dropped: dict[str, Path] = {}
    for place in reversed(_CONFIGURED):
        for file in (root / place / "logind.conf.d").glob("*.conf"):
            dropped[file.name] = file
    found: dict[str, str] = {}
    for file in (*([main] if main else []), *(dropped[name] for name in sorted(dropped))):
        parser = configparser.ConfigParser(
            strict=False, interpolation=None, allow_no_value=True, delimiters=("=",)
        )
        try:
            parser.read_string(file.read_text(errors="replace"))
        except (OSError, configparser.Error):
            continue
        if parser.has_section("Login"):
            found |= {key: (value or "").strip() for key, value in parser.items("Login")}
    return found


def _user() -> str:
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a user without a name
        return str(os.getuid())
