"""The least that handing runs out can do: copy a folder, or zip it.

    python -m tests.benchmarks.bare_files <from> <to> [<module> ...]

zips where the second path ends in `.zip`, after an import of the modules.
"""

from __future__ import annotations

import shutil
import sys
import zipfile
from importlib import import_module
from pathlib import Path


def main(source: Path, target: Path) -> None:
    """Put the files of a folder somewhere else."""
    if target.suffix == ".zip":
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as file:
            for path in source.rglob("*"):
                file.write(path, path.relative_to(source))
    else:
        shutil.copytree(source, target)


if __name__ == "__main__":
    for module in sys.argv[3:]:
        import_module(module)
    main(*map(Path, sys.argv[1:3]))
