"""The first message to an engine, and its answers, for all versions.

Fields may be added with a default; none may go or mean something else. A reader skips the
fields that it does not know.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import replace

from madrob_console.engine.requests import Role

if TYPE_CHECKING:
    from madrob_console.referee.run import Run


class Hello(msgspec.Struct, frozen=True, tag=True):
    """A screen attaches: its protocol version, role and name for people."""

    version: int
    role: Role
    who: str


class Who(msgspec.Struct, frozen=True, tag=True):
    """Who are you? Answered by a `WhoAnswer`."""


class Stop(msgspec.Struct, frozen=True, tag=True):
    """End, with `force` even while a run goes on or screens are attached: a `StopAnswer`."""

    force: bool = False


class Rejected(msgspec.Struct, frozen=True, tag=True):
    """The engine hangs up, and why; `again`: it starts or ends, ask again in a moment."""

    reason: str
    again: bool = False


class WhoAnswer(msgspec.Struct, frozen=True, tag=True):
    """What an engine says of itself.

    Attributes:
        version: of the software.
        wire: the version of the protocol that it speaks with screens; 0 = it takes none.
        testbed: for people, such as `LIVE ros domain 0`.
        results: where it keeps the runs; empty if it keeps none.
        phase: of the current run, or `starting`, `failed`, `ending`.
        run: the current run, for people.
        busy: whether a run goes on or is still being recorded.
        console: the options with which a console attaches to it.
        unsaved: whether anything of a run is in its memory alone.
    """

    version: str = ""
    wire: int = 0
    testbed: str = ""
    results: str = ""
    phase: str = "starting"
    run: str = ""
    busy: bool = False
    screens: int = 0
    console: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unsaved: bool = False

    def with_run(self, run: Run, *, busy: bool, unsaved: bool = False) -> WhoAnswer:
        return replace(self, phase=run.phase.value, run=run_title(run), busy=busy, unsaved=unsaved)

    @property
    def against_stopping(self) -> str:
        """Why a stop needs `force`, in words; empty = it does not."""
        reasons = []
        if self.busy:
            reasons.append("a run is going on")
        if self.unsaved:
            reasons.append("a run is NOT ON DISK yet")
        if self.screens:
            one = self.screens == 1
            reasons.append(
                "a screen is attached" if one else f"{self.screens} screens are attached"
            )
        return ", ".join(reasons)


class StopAnswer(msgspec.Struct, frozen=True, tag=True):
    """The engine ends, unless it is `refused` in words."""

    refused: str = ""


def run_title(run: Run) -> str:
    setup = run.setup
    return "" if setup is None else f"run {setup.run_number} of subject {setup.subject}"
