"""A fake engine that moves with the wall clock, run as a program in a pty by other tests."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

from madrob_console.engine.snapshot import RecorderView, Snapshot
from madrob_console.referee.acts import ConfirmPose, SetUp, Start
from madrob_console.ui.link import ConsoleDefaults
from madrob_console.ui.terminal import run_console
from scoring.protocol import Side, Step
from tests.madrob_console.ui.fake_engine import EPOCH, FakeEngine, a_setup


class MovingEngine(FakeEngine):
    """Panel and force swing, sensors come and go, the log grows once a second.

    A run goes on until the file `ends` is there.
    """

    def __init__(self, ends: Path | None = None) -> None:
        super().__init__()
        self._began = time.monotonic()
        self._ends = ends

    def start_run(self) -> None:
        """Skip to a running run."""
        for act in (SetUp(a_setup()), ConfirmPose(), Start()):
            assert self.act(act) is None
        self.tick(5.0)
        self._began -= 5.0
        self.do_step(Step.TOUCH)

    def snapshot(self) -> Snapshot:
        elapsed = time.monotonic() - self._began
        self.now = EPOCH + elapsed
        if self.run.active and self._ends is not None and self._ends.exists():
            self.finish()
        if self.run.active:
            self.angle = 0.6 + 0.5 * math.sin(elapsed)
            self.force = 8 * math.sin(3 * elapsed)
            self.maximum = 9.5
            self.occupied = {(Side.CCW, int(elapsed) % 5)}
            self.recorder = RecorderView("recording", int(elapsed * 350), int(elapsed * 60_000))
            if int(elapsed) > len(self.log):
                self.say(f"event number {int(elapsed)}")
        return super().snapshot()


if __name__ == "__main__":
    engine = MovingEngine(Path(sys.argv[2]) if len(sys.argv) > 2 else None)
    if "--running" in sys.argv:
        engine.start_run()
    sys.exit(run_console(lambda: engine, ConsoleDefaults(competition="Autumn Cup")))
