"""The clocks of a machine, for tests that step or stop them."""

from __future__ import annotations

from madrob_console.common.clock import NS
from tests.madrob_console.engine.drive import EPOCH_NS


class Machine:
    """The two clocks of a machine, in virtual time; stands in for the module `time`."""

    def __init__(self) -> None:
        self._passed = 0
        self._wall = EPOCH_NS

    def step(self, jump: float) -> None:
        """Set the wall clock ahead by `jump` s, or back."""
        self._wall += round(jump * NS)

    def time_ns(self) -> int:
        return self._wall + self._passed

    def monotonic_ns(self) -> int:
        return self._passed

    def sleep(self, duration: float) -> None:
        self._passed += round(duration * NS)
