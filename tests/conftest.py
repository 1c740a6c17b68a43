from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
from collections.abc import Generator

import pytest
from hypothesis import settings

from madrob_console.common.version import software_version
from tests import programs, rings

# else each worker and each process that a test starts compiles everything anew
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# a suite that a shell starts in the background would hand on that Ctrl+C is ignored
signal.signal(signal.SIGINT, signal.default_int_handler)

# locks and logs of engines are none of the user's
_state = tempfile.TemporaryDirectory(prefix="madrob-")
os.environ["XDG_STATE_HOME"] = _state.name

software_version()  # asks git, which no test in a ring without processes may start

# textual reads these when it is imported
for name in ("NO_COLOR", "TEXTUAL_THEME", "COLORTERM", "TEXTUAL_COLOR_SYSTEM", "COLUMNS", "LINES"):
    os.environ.pop(name, None)
os.environ["TEXTUAL_ANIMATIONS"] = "none"
os.environ["TERM"] = "xterm-256color"

# a busy machine is not a wrong result
settings.register_profile("madrob", deadline=None)
settings.load_profile("madrob")


def pytest_addoption(parser: pytest.Parser) -> None:
    """How often the slow proofs repeat themselves; whether screens are stored anew."""
    parser.addoption("--runs", type=int, default=rings.FEW_RUNS, help="runs of each repeated proof")
    parser.addoption("--update-screens", action="store_true", help="store the screens as they are")


def pytest_configure(config: pytest.Config) -> None:
    """What needs the machine takes minutes: it says which test runs, and how many are left."""
    if "machine" in str(config.getoption("-m")) and config.option.verbose == 0:
        config.option.verbose = 1


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """What computes takes a process for each core; screens wait, and the machine waits more."""
    cores = len(os.sched_getaffinity(0))
    asked = str(config.getoption("-m"))
    return cores if asked == "pure" else max(6 if "machine" in asked else 0, cores + 1)


@pytest.hookimpl(tryfirst=True)  # before `-m` picks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Each test is in a ring.

    Slow ones run when `-m` asks for them. Without `-m` and without a path none needs the machine.
    """
    rings.mark(items, config.getoption("--runs"))
    asked = str(config.getoption("-m"))
    left_out = set() if "slow" in asked else {"slow"}
    if not asked and config.args_source is pytest.Config.ArgsSource.TESTPATHS:
        left_out.add("machine")
    others = [item for item in items if any(map(item.get_closest_marker, left_out))]
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item not in set(others)]


def pytest_collection_finish() -> None:
    """Looking for garbage took a fifth of the time, mostly in what is imported and stays."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 100)


@pytest.hookimpl(tryfirst=True)  # before what a fixture starts
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A test whose programs are absent is skipped."""
    programs.look_for(item)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, bool | None, bool | None]:
    """What needs the machine says so."""
    with rings.kept(item):
        return (yield)
