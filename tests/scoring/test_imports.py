"""What is imported for good is not searched for rubbish, and everything else still is."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import pytest

from scoring.imports import import_kept


def test_what_a_module_makes_is_set_apart_and_the_search_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "large_library.py").write_text(
        "import gc\nsearched = gc.isenabled()\nmade = [[] for _ in range(1000)]\n"
    )
    before = gc.get_freeze_count()
    module = import_kept("large_library")
    monkeypatch.delitem(sys.modules, "large_library")
    assert not module.searched
    assert gc.get_freeze_count() >= before + 1000
    assert gc.isenabled()


def test_a_module_that_is_there_already_costs_nothing() -> None:
    before = gc.get_freeze_count()
    assert import_kept("pathlib").Path is Path
    assert gc.get_freeze_count() <= before


def test_a_module_that_cannot_be_imported_leaves_the_search_on() -> None:
    with pytest.raises(ImportError):
        import_kept("no_such_library_anywhere")
    assert gc.isenabled()
