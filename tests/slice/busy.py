"""`python -m tests.slice.busy RUN`: scores a run again and again, as a scoring child does."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from madrob_console.archive.scored import score_recording

if __name__ == "__main__":
    os.nice(5)
    while True:
        score_recording(Path(sys.argv[1]))
