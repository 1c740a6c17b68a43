"""Write `numbers.json` and `doubts.json` anew: `python -m tests.corpus`.

Whoever does so names each run and value that changed, before and after, and why.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from tests.corpus.test_corpus import HERE, doubts_text, numbers_text, unpack

with TemporaryDirectory() as folder:
    runs = unpack(Path(folder))
    (HERE / "numbers.json").write_text(numbers_text(runs), encoding="utf-8")
    (HERE / "doubts.json").write_text(doubts_text(runs), encoding="utf-8")
print("numbers.json and doubts.json are written")
