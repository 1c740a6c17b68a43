"""`result.json` as it is published: every result is what the schema says."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from madrob_console.archive.file_digests import digests_of
from madrob_console.archive.result_document import ResultDocument, result_schema
from madrob_console.archive.result_files import result_files
from madrob_console.archive.result_reader import read_result
from madrob_console.engine import state_schemas
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Signal
from tests.corpus.test_corpus import unpack
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import (
    aborted,
    appealed,
    ended_after,
    recorded,
)
from tests.madrob_console.run_folders import put_hole

FOLDERS: dict[str, Callable[[], Path]] = {
    "completed": partial(recorded, Scenario.NOMINAL),  # ruled, protested, issued again
    "timeout": appealed,  # with all else that a referee can say
    "aborted": aborted,
    "interrupted": partial(ended_after, 6.0),
}


def document(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


@pytest.mark.parametrize("outcome", FOLDERS)
def test_every_result_is_what_the_schema_says(outcome: str) -> None:
    folder = FOLDERS[outcome]()
    found = document(folder)
    assert found["outcome"] == outcome
    jsonschema.validate(found, result_schema())
    assert set(found) == {each.name for each in fields(ResultDocument)}
    for path in folder.glob("result_issue_*.json"):
        jsonschema.validate(json.loads(path.read_text()), result_schema())
    assert found["files_left_out"] == []
    kinds = {Path(name).suffix for name in found["files"]}
    assert kinds == {".mcap", ".yaml", ".csv"}
    assert len(found["files"]) == sum(one.suffix in kinds for one in folder.iterdir())
    for name, told in found["files"].items():
        data = (folder / name).read_bytes()
        assert told == {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}


@pytest.mark.parametrize("outcome", FOLDERS)
def test_a_result_read_back_is_written_to_the_same_bytes(outcome: str) -> None:
    data = (FOLDERS[outcome]() / "result.json").read_bytes()
    again = msgspec.json.encode(msgspec.json.decode(data, type=ResultDocument))
    assert msgspec.json.format(again, indent=2) + b"\n" == data
    assert read_result(str(FOLDERS[outcome]())).team == "Delft"


@pytest.mark.parametrize("outcome", FOLDERS)
def test_a_result_names_what_computed_it(outcome: str) -> None:
    assert document(FOLDERS[outcome]())["libraries"] == {
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "pandas")},
    }


@pytest.mark.parametrize(
    "otherwise", [{}, {"topic": "/lab/handle", "scale": 0.5, "offset": 3.0}], ids=str
)
def test_a_result_says_how_its_signals_were_read_live_and_in_a_rescoring(
    otherwise: dict[str, Any], tmp_path: Path
) -> None:
    mappings = [
        replace(one, **otherwise) if one.signal is Signal.HANDLE else one
        for one in DEFAULT_MAPPINGS
    ]
    drive = Drive(tmp_path, Scenario.NO_TOUCH, mappings=mappings)
    drive.whole_run(make_setup(timeout=2.0))
    drive.engine.close()
    assert document(drive.folder)["mappings"] == [
        asdict(one.limited()) | {"signal": one.signal.value} for one in mappings
    ]
    again = result_files(drive.folder, drive.scored())
    assert again["result.json"] == (drive.folder / "result.json").read_bytes()


def test_a_recording_that_cannot_be_read_has_no_digest_and_a_reason(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "event.csv").write_text("time,event\n")
    (folder / "run_0.mcap").symlink_to("/etc/passwd")
    os.mkfifo(folder / "pipe.csv")
    put_hole(folder / "sparse.csv")
    digests, left_out = digests_of(folder)
    assert list(digests) == ["event.csv"]
    assert left_out == (
        "metadata.yaml: cannot be read (No such file or directory)",
        "pipe.csv: cannot be read (no plain file)",
        "run_0.mcap: cannot be read (it is a link)",
        "sparse.csv: cannot be read (20.0 GB, too much for a digest)",
    )
    assert digests_of(tmp_path / "gone")[0] == {}


def references_in(schema: object) -> set[str]:
    """Every `$ref` of a schema, at any depth."""
    text = msgspec.json.encode(schema).decode()
    return set(re.findall(r'"\$ref":"([^"]+)"', text))


@pytest.mark.parametrize("schema", [result_schema(), *state_schemas().values()])
def test_a_schema_is_valid_and_its_references_lead_somewhere(schema: dict[str, Any]) -> None:
    jsonschema.Draft202012Validator.check_schema(schema)
    assert references_in(schema) <= {f"#/$defs/{name}" for name in schema["$defs"]}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({}, schema)


def test_results_that_were_stored_earlier_are_valid_by_the_schema(tmp_path: Path) -> None:
    runs = unpack(tmp_path)
    results = [path for run in runs.values() for path in run.rglob("result*.json")]
    assert len(results) > 20
    for path in results:
        jsonschema.validate(json.loads(path.read_bytes()), result_schema())
