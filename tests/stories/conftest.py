from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stories.hands import Hall


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[Hall]:
    with Hall(tmp_path) as hall:
        yield hall
