"""Files and folders that are there whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.errors import MadrobError
from madrob_console.files.whole import replaced_folder, write_new_folder


def test_a_new_folder_has_all_of_its_files(tmp_path: Path) -> None:
    write_new_folder(tmp_path / "far" / "new", {"one": b"1", "two": b"22"})
    assert {path.name: path.read_bytes() for path in (tmp_path / "far" / "new").iterdir()} == {
        "one": b"1",
        "two": b"22",
    }
    assert [path.name for path in (tmp_path / "far").iterdir()] == ["new"]


def test_of_a_folder_that_cannot_be_written_nothing_stays(tmp_path: Path) -> None:
    with pytest.raises(MadrobError, match="not written"):
        write_new_folder(tmp_path / "new", {"one": b"1", "no/two": b"2"})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_there_stays_as_it_is(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine"
    match kind:
        case "file":
            path.write_text("mine")
        case "folder":
            path.mkdir()
        case "link":
            path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(MadrobError, match="is there already; move it away"):
        write_new_folder(path, {"one": b"1"})
    assert [found.name for found in tmp_path.iterdir()] == ["mine"]
    assert path.is_symlink() or path.is_file() or not list(path.iterdir())


def test_a_folder_is_replaced_with_all_of_its_files(tmp_path: Path) -> None:
    for files in ({"one": b"1", "two": b"2"}, {"two": b"22"}):
        replaced_folder(tmp_path / "it", files)
        assert {path.name: path.read_bytes() for path in (tmp_path / "it").iterdir()} == files
        assert [path.name for path in tmp_path.iterdir()] == ["it"]


def test_a_folder_that_cannot_be_replaced_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replaced_folder(tmp_path / "it", {"one": b"1"})
    rename = Path.rename

    def refused(path: Path, target: Path) -> Path:
        if target == tmp_path / "it" and (path / "two").exists():
            raise OSError(5, "Input/output error")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(MadrobError, match="it: not written"):
        replaced_folder(tmp_path / "it", {"two": b"2"})
    assert [path.name for path in tmp_path.iterdir()] == ["it"]
    assert (tmp_path / "it" / "one").read_bytes() == b"1"
