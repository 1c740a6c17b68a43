"""The state on its way to the screens: part by part, each encoded once, when it has changed.

A part is a field of `Snapshot`. The log and the result, which are most of it, cross when there is
a new line or another result; an engine where nothing happens sends a sign of life.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Any, get_type_hints

import msgspec

from madrob_console.engine.shown import wire
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError

SIGN_OF_LIFE = 0.5
"""Screens hear this often from an engine that has nothing new to say but its time, s.

Also from one whose core stands still: its pulse says so.
"""

OWN = "right"
"""The part that is not the same for all screens: it crosses beside the others."""

_NAMES = tuple(field.name for field in fields(Snapshot))
_SHARED = tuple(name for name in _NAMES if name != OWN)


class Outgoing:
    """What is new in the engine's state, for any number of screens that saw other versions last.

    Attributes:
        version: of the state that is sent now; 0 = none yet.
    """

    def __init__(self) -> None:
        self.version = 0
        self._sent: Snapshot | None = None
        self._sent_at = 0.0
        self._parts: dict[str, tuple[int, msgspec.Raw]] = {}
        self._frames: dict[int, bytes] = {}

    def show(self, snapshot: Snapshot, now: float) -> None:
        """Take the engine's latest snapshot.

        Args:
            snapshot: the latest.
            now: s of a monotonic clock.
        """
        sent = self._sent
        new = [
            name
            for name in _SHARED
            if sent is None or getattr(snapshot, name) != getattr(sent, name)
        ]
        if new in ([], ["time"]) and now - self._sent_at < SIGN_OF_LIFE:
            return
        self.version += 1
        for name in new:
            self._parts[name] = (self.version, wire.raw(getattr(snapshot, name)))
        self._frames.clear()
        self._sent, self._sent_at = snapshot, now

    def since(self, version: int) -> bytes:
        """What is new since a version, as it crosses the socket; everything since version 0."""
        if version not in self._frames:
            new = {name: raw for name, (since, raw) in self._parts.items() if since > version}
            self._frames[version] = wire.frame(wire.State(new))
        return self._frames[version]


class Incoming:
    """The state as it has arrived so far."""

    def __init__(self) -> None:
        self._parts: dict[str, Any] = {}

    def take(self, state: wire.State) -> Snapshot | None:
        """The state with what has arrived now; None while parts of the first one are missing.

        Raises:
            MadrobError: what has arrived is no part of a state.
        """
        for name, raw in state.parts.items():
            if name not in _NAMES:
                raise MadrobError("not a message of an engine: an unknown part of its state")
            self._parts[name] = wire.decoded(_decoders()[name], raw, "a message of an engine")
        return Snapshot(**self._parts) if len(self._parts) == len(_NAMES) else None


@cache
def _decoders() -> Mapping[str, msgspec.msgpack.Decoder[Any]]:
    types = get_type_hints(Snapshot)
    return {name: msgspec.msgpack.Decoder(types[name]) for name in _NAMES}
