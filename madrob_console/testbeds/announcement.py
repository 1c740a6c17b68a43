"""What a testbed says of itself, once for all: `/madrob/testbed/info` (protocol section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.names import terminal_safe
from recorder.message import RawMessage

INFO_TOPIC = "/madrob/testbed/info"
INFO_TYPE = "std_msgs/msg/String"

LARGEST_INFO = 4096
"""A longer message is no announcement, bytes."""

_LONGEST_SCENARIO = 40
_UNNAMED = "it does not say what"


@dataclass(frozen=True, slots=True)
class Announcement:
    """What a testbed says of itself.

    Attributes:
        simulated: what a simulated one plays, in words: every run on it is practice; None = it is
            a real one, or says nothing.
        problem: why what it says cannot be understood, in words; None = it can.
        messages: what it said once for all, as it came, for recordings.
        simulated_time: `/clock` less the engine's clock, s; None = nobody publishes `/clock`.
    """

    simulated: str | None = None
    problem: str | None = None
    messages: tuple[RawMessage, ...] = ()
    simulated_time: float | None = None


SILENT = Announcement()
"""It says nothing of itself."""


class _Info(msgspec.Struct):
    kind: str
    scenario: str = ""


_infos = msgspec.json.Decoder(_Info)


def info_text(scenario: str) -> str:
    """What a simulated testbed announces."""
    return msgspec.json.encode(_Info(SourceKind.SIMULATED, scenario)).decode()


def simulated_in(text: str) -> str | None:
    """What a simulated testbed plays, by its announcement; None: it is of another kind.

    Raises:
        MadrobError: it is no announcement.
    """
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
