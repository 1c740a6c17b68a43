"""A replay's result beside the stored one: what is said where nothing is stored."""

from __future__ import annotations

from pathlib import Path

from madrob_console.archive.comparison import stored_result
from tests.madrob_console.recorded_runs import copy_run

NONE = "no stored result lies beside the recording"


def test_a_bag_alone_has_no_stored_result(tmp_path: Path) -> None:
    folder = copy_run(tmp_path, 1)
    (bag,) = folder.glob("*.mcap")
    assert stored_result(bag) == NONE
    (folder / "result.json").unlink()
    assert stored_result(folder) == NONE
