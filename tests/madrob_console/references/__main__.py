"""Make the shipped reference recordings, and what they must score to, anew."""

from __future__ import annotations

import tarfile
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.cli.reference_set import ARCHIVE, EXPECTED_FILE, FOLDER
from tests.madrob_console.references.bags import write_bag
from tests.madrob_console.references.runs import RUNS
from tests.madrob_console.references.truth import expected_text, reference

FOLDER.mkdir(exist_ok=True)
references = []
with (
    TemporaryDirectory() as folder,
    tarfile.open(FOLDER / ARCHIVE, "w:xz", preset=9) as archive,
):
    for run in RUNS:
        made = reference(run)
        path = Path(folder) / made.recording
        write_bag(run, path)
        references.append(made)
        member = tarfile.TarInfo(made.recording)
        member.size = path.stat().st_size
        with path.open("rb") as recording:
            archive.addfile(member, recording)
(FOLDER / EXPECTED_FILE).write_bytes(expected_text(references))
sizes = [file.stat().st_size for file in FOLDER.iterdir()]
print(f"{len(references)} recordings, {sum(sizes)} bytes in {len(sizes)} files")
