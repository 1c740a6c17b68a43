from __future__ import annotations

import math

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.messages.mapping import TopicMapping
from scoring.protocol import Signal
from tests.madrob_console.messages.made import FLOAT


@pytest.mark.parametrize(
    "path", ["", ".", "a.", ".a", "a[", "a[-1]", "a[x]", "a b", "0", "a..b", "a[=x]", "a[n=]"]
)
def test_malformed_field_is_refused_with_an_example(path: str) -> None:
    with pytest.raises(MadrobError, match=r"position\[0\]"):
        TopicMapping(Signal.DOOR, "/d", FLOAT, path)


@pytest.mark.parametrize(("scale", "offset"), [(0.0, 0.0), (math.nan, 0.0), (1.0, math.inf)])
def test_scale_that_loses_the_signal_is_refused(scale: float, offset: float) -> None:
    with pytest.raises(MadrobError, match=r"^/d: "):
        TopicMapping(Signal.DOOR, "/d", FLOAT, "data", scale, offset)
