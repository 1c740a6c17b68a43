"""Make the shipped reference recordings, and what they must score to, anew."""

from __future__ import annotations

import tarfile
from io import BytesIO

from madrob_console.cli.reference_set import ARCHIVE, EXPECTED_FILE, FOLDER
from tests.madrob_console.references.bags import bag_of
from tests.madrob_console.references.runs import RUNS
from tests.madrob_console.references.truth import expected_text, reference

FOLDER.mkdir(exist_ok=True)
with tarfile.open(FOLDER / ARCHIVE, "w:xz", preset=9) as archive:
    for run in RUNS:
        member, content = tarfile.TarInfo(f"{run.name}.mcap"), bag_of(run)
        member.size = len(content)
        archive.addfile(member, BytesIO(content))
(FOLDER / EXPECTED_FILE).write_bytes(expected_text([reference(run) for run in RUNS]))
sizes = [file.stat().st_size for file in FOLDER.iterdir()]
print(f"{len(RUNS)} recordings, {sum(sizes)} bytes in {len(sizes)} files")
