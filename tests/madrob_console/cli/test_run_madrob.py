"""EUROBENCH's program: four files in, eight files out."""

from __future__ import annotations

import re
import signal
import sys
from pathlib import Path

import pytest

from madrob_console.cli.__main__ import REFUSED, run_madrob
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName
from tests.madrob_console.recorded_runs import recorded
from tests.scoring.pandas_scripts import values

SMOOTHNESS = IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION.value


PATTERNS = ("*_event.csv", "*_wrench.csv", "*_jointState.csv", "condition_*.yaml")
"""Event, wrench, jointState and condition file of a run, as EUROBENCH's runner names them."""


def inputs(run: Path) -> list[Path]:
    return [next(run.glob(pattern)) for pattern in PATTERNS]


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """The exit code of `run_madrob`, which heeds no Ctrl+C any more when it has ended."""
    monkeypatch.setattr(sys, "argv", ["run_madrob", *map(str, arguments)])
    heeded = signal.getsignal(signal.SIGINT)
    try:
        return run_madrob()
    finally:
        signal.signal(signal.SIGINT, heeded)


@pytest.fixture(scope="module")
def files() -> list[Path]:
    return inputs(recorded(Scenario.NOMINAL))


@pytest.mark.parametrize("scenario", [Scenario.NOMINAL, Scenario.TOUCH_ONLY])
def test_every_byte_is_that_of_the_published_scripts(
    scenario: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = inputs(recorded(scenario))
    assert run(monkeypatch, *given, tmp_path / "out") == 0
    written = {path.name: path.read_text() for path in (tmp_path / "out").iterdir()}
    expected = values(*given)
    assert sorted(expected) == sorted(IndicatorName)
    if isinstance(expected[SMOOTHNESS], float):  # pandas adds in another order: the last digit
        smoothness = written.pop(f"{SMOOTHNESS}.yaml")
        known = re.fullmatch(r"type: scalar\nvalue: (\d+\.\d+)\n", smoothness)
        assert known is not None
        assert float(known[1]) == pytest.approx(expected.pop(SMOOTHNESS), rel=1e-14)
    assert written == {
        f"{name}.yaml": f"type: scalar\nvalue: {value}\n" for name, value in expected.items()
    }


def test_files_in_another_order_are_refused(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    event, wrench, *others = files
    assert run(monkeypatch, wrench, event, *others, tmp_path / "out") == REFUSED
    assert f"{wrench}: column event is missing: give time,event" in capsys.readouterr().err


def test_a_wrong_number_of_arguments_ends_in_one_line_and_minus_one(
    files: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for given in ([], files, [*files, "out", "more"]):
        assert run(monkeypatch, *given) == REFUSED
        assert capsys.readouterr().err.count("\n") == 1
    assert run(monkeypatch, "--help") == 0


def test_a_file_that_cannot_be_read_is_named_and_nothing_is_written(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    gone = tmp_path / "event.csv"
    assert run(monkeypatch, gone, *files[1:], tmp_path / "out") == REFUSED
    said = capsys.readouterr().err
    assert said.endswith(f"{gone}: cannot be read (No such file or directory)\n")
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_named(
    files: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, *files, files[0] / "out") == REFUSED
    assert "cannot be made (Not a directory): name another" in capsys.readouterr().err
