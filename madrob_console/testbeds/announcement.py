"""A testbed's announcement, `/madrob/testbed/info` (protocol section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from recorder.bag import RawMessage

INFO_TOPIC = "/madrob/testbed/info"
INFO_TYPE = "std_msgs/msg/String"

LARGEST_INFO = 4096
"""Bytes; a longer message is no announcement."""

_LONGEST_SCENARIO = 40
_UNNAMED = "it does not say what"


@dataclass(frozen=True, slots=True)
class Announcement:
    """What a testbed announces about itself.

    A simulated one says in `simulated` what it plays; every run on it is practice. `messages` are
    kept for recordings.
    """

    simulated: str | None = None
    problem: str | None = None
    messages: tuple[RawMessage, ...] = ()


SILENT = Announcement()


class _Info(msgspec.Struct):
    kind: str
    scenario: str = ""


_infos = msgspec.json.Decoder(_Info)


def info_text(scenario: str) -> str:
    return msgspec.json.encode(_Info(SourceKind.SIMULATED, scenario)).decode()


def simulated_in(text: str) -> str | None:
    """What a simulated testbed plays, None for another kind; MadrobError for no announcement."""
    try:
        info = _infos.decode(text)
    except (msgspec.MsgspecError, RecursionError, UnicodeEncodeError):
        shown = terminal_safe(text[:_LONGEST_SCENARIO])
        raise MadrobError(
            f"not understood: '{shown}'; it tells a simulated testbed from a real one: stop what "
            "sends that"
        ) from None
    if info.kind != SourceKind.SIMULATED:
        return None
    return terminal_safe(info.scenario[:_LONGEST_SCENARIO]).strip() or _UNNAMED
