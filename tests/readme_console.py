"""Plays a referee at the README's console line: one simulated run, from set-up to result.

    python -m tests.readme_console FOLDER LINE RESULTS

runs the shell line LINE in FOLDER, presses the keys, prints the screens, and ends with 0 if the
run was completed, the console left cleanly and the run lies in the folder RESULTS.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.terminal import Terminal

INSTALLING = 900.0
LONGEST_RUN = 120.0

SCRIPT: tuple[tuple[str, float, str], ...] = (
    ("2 of 9 checks fail", INSTALLING, "Enter"),
    ("Run 1 of subject 1 is set up", 10.0, "F7"),
    ("Done: handle zeroed", 10.0, "F6"),
    ("all passed or waived", 10.0, "F5"),
    ("COUNTDOWN", 10.0, ""),
    ("✓ 3 open the door", LONGEST_RUN, ""),
    ("COMPLETED", LONGEST_RUN, ""),
    ("capability level                     6 ", 10.0, "F10"),
)
"""What to wait for on the screen, for how many seconds at most, and the keys to press then."""


def play(terminal: Terminal) -> int:
    """Follow the script; the exit code of the console."""
    for text, timeout, keys in SCRIPT:
        terminal.wait_for(text, timeout=timeout)
        print(f"--- {text!r} is on the screen", *terminal.screen(), sep="\n", flush=True)
        terminal.press(keys)
    return terminal.wait_exit()


def main(folder: Path, line: str, results: Path) -> int:
    """Run the line and judge what it leaves behind."""
    with Terminal(["bash", "-c", line], cwd=folder) as terminal:
        code = play(terminal)
    names = [path.name for run in results.glob("practice/subject_*") for path in run.iterdir()]
    print(f"--- exit code {code}, files:", *sorted(names), sep="\n", flush=True)
    recorded = any(name.endswith("_0.mcap") for name in names)
    return 0 if code == 0 and recorded and "result.json" in names else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])))
