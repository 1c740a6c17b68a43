"""No test runs outside of the rings, and none needs more than its ring gives."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from itertools import count
from multiprocessing import get_context
from pathlib import Path

import pytest

from tests import rings
from tests.rings import NeedsMachineError


def test_every_place_of_the_table_is_there() -> None:
    assert [place for place in rings.FOLDERS if not (Path(__file__).parent / place).exists()] == []


def test_outside_of_the_machine_nothing_sleeps_and_no_process_is_started() -> None:
    with pytest.raises(NeedsMachineError, match=r"^time.sleep: watch for it, use virtual time, or"):
        time.sleep(0.0)
    with pytest.raises(NeedsMachineError, match=r"^subprocess.Popen: "):
        subprocess.run([sys.executable, "-c", "pass"], check=True)
    with pytest.raises(NeedsMachineError, match=r"^the process "):
        get_context("spawn").Process(target=print).start()


def test_what_computes_without_end_fails_and_what_waits_for_a_processor_does_not() -> None:
    hangs = pytest.raises(pytest.fail.Exception, match=r"^it hangs: more than 0.2 s of processor")
    with rings.bounded(0.2), hangs:
        for _ in count():
            pass
    with rings.bounded(0.2):
        threading.Event().wait(0.5)
