"""Which cases of a test run by default, where all of them take too long together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import pytest
from _pytest.mark import ParameterSet

_T = TypeVar("_T")


def slow_but_for(cases: Iterable[_T], *quick: _T) -> list[_T | ParameterSet]:
    """The cases of `parametrize`: those that are not among the quick ones are marked slow."""
    return [case if case in quick else pytest.param(case, marks=pytest.mark.slow) for case in cases]
