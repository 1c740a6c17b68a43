"""A version that tells one scorer from the other, however the program came here."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from packaging.version import Version

from madrob_console.cli.main import main
from madrob_console.common import version
from madrob_console.common.version import CODE, RELEASE, software_version, source_version

ROOT = Path(__file__).parents[3]
TELL = "from madrob_console.common.version import software_version as told; print(told())"
JUNK = shutil.ignore_patterns("__pycache__", ".*")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A plain copy of the source tree, without git."""
    return Path(shutil.copytree(ROOT, tmp_path / "copy", ignore=JUNK))


def version_of(tree: Path) -> str:
    return source_version({name: tree / name for name in CODE})


def change(file: Path) -> None:
    file.write_text(file.read_text() + "\n# a line more\n")


def told_from(path: str | Path, python: str | Path = sys.executable) -> str:
    """What the code at a path says of itself."""
    command = [str(python), "-P", "-c", TELL]
    environment = {"PYTHONPATH": str(path), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.check_output(command, env=environment, text=True).strip()


def zipped(tree: Path, target: Path) -> Path:
    with zipfile.ZipFile(target, "w") as archive:
        for name in CODE:
            for file in filter(Path.is_file, (tree / name).rglob("*")):
                archive.write(file, file.relative_to(tree))
    return target


def test_the_version_is_valid_and_names_the_release() -> None:
    parsed = Version(software_version())
    assert str(parsed) == software_version()
    assert parsed.public == RELEASE
    assert parsed.local is not None


JUNK_FILES = ("scoring/__pycache__/x.pyc", "tests/.x.swp", ".venv/y.py", ".git/HEAD", "dist/z")


def add_junk(tree: Path) -> None:
    change(tree / "README.md")
    for junk in JUNK_FILES:
        (tree / junk).parent.mkdir(parents=True, exist_ok=True)
        (tree / junk).write_text("junk")


def test_any_change_of_code_is_another_version_and_no_other_change_is(tree: Path) -> None:
    indicators = tree / "scoring/indicators.py"
    seen = [version_of(tree)]
    for act in (
        lambda: change(indicators),
        lambda: change(tree / "recorder/bag.py"),
        lambda: change(tree / "madrob_console/pages/templates/report.css"),
        lambda: indicators.rename(tree / "scoring/others.py"),
        lambda: (tree / "scoring/others.py").write_text(""),
    ):
        act()
        seen.append(version_of(tree))
    assert len({*seen}) == 6
    add_junk(tree)
    assert version_of(tree) == seen[-1]


def test_a_plain_copy_and_a_zip_of_the_packages_know_the_version_of_the_tree(
    tree: Path, tmp_path: Path
) -> None:
    assert told_from(tree) == version_of(tree)
    assert told_from(zipped(tree, tmp_path / "packages.zip")) == version_of(tree)


def test_code_put_before_the_installed_one_is_not_taken_for_it(tree: Path, tmp_path: Path) -> None:
    before = tmp_path / "before"
    shutil.copytree(tree / "scoring", before / "scoring")
    change(before / "scoring/indicators.py")
    assert told_from(f"{before}:{tree}") != version_of(tree)


def test_no_run_is_made_by_code_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(version, "CODE", (*CODE, "no_such_package"))
    software_version.cache_clear()
    try:
        flags = ["--testbed", "simulated", "--results", str(tmp_path / "results")]
        assert main(["run", *flags]) == 2
    finally:
        software_version.cache_clear()
    assert "no result could say which version made it" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


def run(*command: str | Path, cwd: Path) -> str:
    return subprocess.check_output(list(map(str, command)), cwd=cwd, text=True).strip()


def installed(tree: Path, environment: Path, *options: str) -> Path:
    """The Python of a new environment in which the tree is installed, without what it needs."""
    run(sys.executable, "-m", "venv", environment, cwd=tree)
    python = environment / "bin/python"
    run(python, "-m", "pip", "install", "-q", "--no-deps", *options, ".", cwd=tree)
    return python


def shown_by_pip(python: Path) -> str:
    shown = run(python, "-m", "pip", "show", "madrob-console", cwd=python.parent)
    return shown.partition("Version: ")[2].splitlines()[0]


@pytest.mark.slow
def test_an_installation_has_the_release_for_pip_and_says_which_code_it_is(
    tree: Path, tmp_path: Path
) -> None:
    python = installed(tree, tmp_path / "one")
    assert shown_by_pip(python) == RELEASE
    assert told_from(tmp_path, python) == version_of(tree)
    (code,) = (tmp_path / "one").glob("lib/*/site-packages/scoring/indicators.py")
    change(code)
    assert told_from(tmp_path, python) != version_of(tree)


@pytest.mark.slow
def test_a_checkout_knows_a_later_change_without_a_new_installation(
    tree: Path, tmp_path: Path
) -> None:
    python = installed(tree, tmp_path / "editable", "-e")
    first = told_from(tmp_path, python)
    change(tree / "scoring/indicators.py")
    assert told_from(tmp_path, python) == version_of(tree) != first


@pytest.mark.slow
def test_a_wheel_by_way_of_a_source_archive_keeps_the_version(tree: Path, tmp_path: Path) -> None:
    python = tmp_path / "build/bin/python"
    run(sys.executable, "-m", "venv", tmp_path / "build", cwd=tree)
    run(python, "-m", "pip", "install", "-q", "build", "twine", cwd=tree)
    run(python, "-m", "build", "-o", tmp_path / "dist", tree, cwd=tmp_path)
    source, wheel = sorted((tmp_path / "dist").iterdir(), key=lambda path: path.suffix)
    assert source.name == f"madrob_console-{RELEASE}.tar.gz"
    assert wheel.name == f"madrob_console-{RELEASE}-py3-none-any.whl"
    assert told_from(wheel) == version_of(tree)
    run(python, "-m", "twine", "check", "--strict", source, wheel, cwd=tmp_path)
