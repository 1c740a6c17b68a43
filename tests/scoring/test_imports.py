"""What is imported for good is kept from the garbage collector."""

from __future__ import annotations

import gc
import sys
from importlib import import_module
from pathlib import Path

import pytest

from scoring.imports import imports_kept


def test_what_a_module_makes_is_set_apart_and_the_collector_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "large_library.py").write_text(
        "import gc\ncollecting = gc.isenabled()\nmade = [[] for _ in range(1000)]\n"
    )
    before = gc.get_freeze_count()
    with imports_kept():
        module = import_module("large_library")
    monkeypatch.delitem(sys.modules, "large_library")
    assert not module.collecting
    assert gc.get_freeze_count() >= before + 1000
    assert gc.isenabled()


def test_a_module_that_cannot_be_imported_leaves_the_collector_on() -> None:
    with pytest.raises(ImportError), imports_kept():
        import_module("no_such_library_anywhere")
    assert gc.isenabled()
