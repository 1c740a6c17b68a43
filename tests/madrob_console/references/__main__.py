"""Make the shipped reference recordings, and what they must score to, anew."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from madrob_console.cli.reference_set import EXPECTED_FILE, FOLDER
from tests.madrob_console.references.bags import write_bag
from tests.madrob_console.references.runs import RUNS
from tests.madrob_console.references.truth import expected_text, reference

FOLDER.mkdir(exist_ok=True)
references = []
for run in RUNS:
    made = reference(run)
    path = FOLDER / made.recording
    write_bag(run, path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    references.append(replace(made, sha256=digest))
(FOLDER / EXPECTED_FILE).write_bytes(expected_text(references))
sizes = [file.stat().st_size for file in FOLDER.iterdir()]
print(f"{len(references)} recordings, {sum(sizes)} bytes in {len(sizes)} files")
