"""A version that names the release, and the commit where there is one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from madrob_console.common.version import RELEASE

ROOT = Path(__file__).parents[3]
TELL = "from madrob_console.common.version import software_version as told; print(told())"
JUNK = shutil.ignore_patterns("__pycache__", ".*")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A plain copy of the source tree, without git."""
    return Path(shutil.copytree(ROOT, tmp_path / "copy", ignore=JUNK))


def run(*command: str | Path, cwd: Path) -> str:
    return subprocess.check_output(list(map(str, command)), cwd=cwd, text=True).strip()


def told_from(path: Path) -> str:
    """What the code at a path says of itself."""
    command = [sys.executable, "-P", "-c", TELL]
    environment = {"PYTHONPATH": str(path), "PATH": os.environ["PATH"]}
    return subprocess.check_output(command, env=environment, text=True).strip()


@pytest.mark.needs("git")
def test_a_checkout_names_its_commit_and_whether_it_is_changed(tree: Path) -> None:
    name = ("-c", "user.name=x", "-c", "user.email=x@y.z")
    run("git", "init", "-q", cwd=tree)
    run("git", "add", "madrob_console/common", cwd=tree)
    run("git", *name, "commit", "-q", "-m", "x", cwd=tree)
    commit = run("git", "rev-parse", "--short=10", "HEAD", cwd=tree)
    assert told_from(tree) == f"{RELEASE}+{commit}"
    (tree / "madrob_console/common/formatting.py").write_text("# changed\n")
    assert told_from(tree) == f"{RELEASE}+{commit}.dirty"


@pytest.mark.needs("git")
def test_code_without_git_names_the_release_alone(tree: Path, tmp_path: Path) -> None:
    run("git", "init", "-q", cwd=tmp_path)  # around it, as around an environment in a checkout
    assert told_from(tree) == RELEASE
    (tree / ".git").mkdir()  # and one that git refuses
    assert told_from(tree) == RELEASE


@pytest.mark.slow
def test_a_wheel_by_way_of_a_source_archive_has_the_release(tree: Path, tmp_path: Path) -> None:
    python = tmp_path / "build/bin/python"
    run(sys.executable, "-m", "venv", tmp_path / "build", cwd=tree)
    run(python, "-m", "pip", "install", "-q", "build", "twine", cwd=tree)
    run(python, "-m", "build", "-o", tmp_path / "dist", tree, cwd=tmp_path)
    source, wheel = sorted((tmp_path / "dist").iterdir(), key=lambda path: path.suffix)
    assert source.name == f"madrob_console-{RELEASE}.tar.gz"
    assert wheel.name == f"madrob_console-{RELEASE}-py3-none-any.whl"
    assert told_from(wheel) == RELEASE
    run(python, "-m", "twine", "check", "--strict", source, wheel, cwd=tmp_path)
