"""What a referee can do: each act is one class with its rules and its words, and their list.

`impossible` says in words why there can be no such act now (the screens show it beside a dim
key), `refusal` the same of an act with its fields; `apply` gives the new state.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.referee.acts.act import Act, Consequence, Situation
from madrob_console.referee.acts.after import AcceptDoubts, Finalise, Reissue
from madrob_console.referee.acts.before import ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.acts.correct import Correct, TakeBack
from madrob_console.referee.acts.during import (
    Abort,
    AcceptFalseStart,
    AddNote,
    DeclareTimeout,
    MarkIncident,
    RestartCountdown,
    Rule,
    Void,
)
from madrob_console.referee.acts.protest import DecideProtest, FileProtest, WithdrawProtest

__all__ = [
    "ACTS",
    "ACT_CALLED",
    "Abort",
    "AcceptDoubts",
    "AcceptFalseStart",
    "Act",
    "AddNote",
    "ConfirmPose",
    "Consequence",
    "Correct",
    "DecideProtest",
    "DeclareTimeout",
    "FileProtest",
    "Finalise",
    "MarkIncident",
    "Reissue",
    "RestartCountdown",
    "Rule",
    "SetUp",
    "Situation",
    "Start",
    "TakeBack",
    "Void",
    "Waive",
    "WithdrawProtest",
    "ZeroHandle",
    "act_details",
    "act_named",
    "is_urgent",
    "refusals",
]

ACTS: tuple[type[Act], ...] = (
    SetUp,
    ConfirmPose,
    ZeroHandle,
    Waive,
    Start,
    RestartCountdown,
    AcceptFalseStart,
    Abort,
    DeclareTimeout,
    Rule,
    MarkIncident,
    AddNote,
    AcceptDoubts,
    Finalise,
    Reissue,
    Void,
    Correct,
    FileProtest,
    DecideProtest,
    WithdrawProtest,
    TakeBack,
)

ACT_CALLED = {act.name: act for act in ACTS}


def refusals(situation: Situation) -> dict[str, str]:
    """Act name -> why it is not possible now; possible acts are missing."""
    judged = ((act.name, act.impossible(situation)) for act in ACTS)
    return {name: why for name, why in judged if why is not None}


def is_urgent(name: str) -> bool:
    act = ACT_CALLED.get(name)
    return act is not None and act.urgent


def act_details(act: Act) -> dict[str, object]:
    """The fields of an act, as JSON values."""
    details: dict[str, object] = msgspec.to_builtins(act)
    return details


def act_named(name: str, details: Mapping[str, object]) -> Act:
    """Makes an act; MadrobError where name or fields do not fit."""
    kind = ACT_CALLED.get(name)
    if kind is None:
        raise MadrobError(f"no act is called {name!r}")
    try:
        act: Act = msgspec.convert(details, kind)
    except msgspec.ValidationError as error:
        raise MadrobError(f"'{name}': {terminal_safe(str(error))}") from None
    return act
