"""An engine is found by what it owns, and ended by name: real processes, lost folders, hangs."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing, redirect_stdout
from pathlib import Path

import pytest

from madrob_console.cli import running_engines
from madrob_console.cli.attaching import TAKEN, attach
from madrob_console.cli.main import build_parser, main
from madrob_console.common.errors import MadrobError
from madrob_console.config import load_settings
from madrob_console.engine.ipc import wire
from madrob_console.engine.ipc.client import RemoteEngine
from madrob_console.engine.ipc.discovery import FoundEngine, find_engine
from madrob_console.engine.ipc.discovery import running_engines as running_engines_of_all
from madrob_console.engine.ipc.engine_lock import this_user
from madrob_console.engine.requests import Perform, Role, TakeOver
from madrob_console.referee.acts import Abort, SetUp
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.served import told_by
from tests.madrob_console.engine_process import MADROB, ROOT, EngineProcess, start_madrob
from tests.madrob_console.recorded_runs import final
from tests.madrob_console.small_disk import disk_image
from tests.terminal import Terminal
from tests.watching import stop_process, until

pytestmark = pytest.mark.timeout(240)  # some start three engines, on whatever machine

OTHER_VERSION = "from madrob_console.engine.ipc import wire; wire.VERSION = 900;"
HANGS = """
import time
from madrob_console.engine.runtime.testbed_engine import Engine
Engine.step = lambda *_: time.sleep(600)
"""
CUT_OFF = "--force ends it all the same"
ENDED = "the engine has ended"
NOBODY = "the engine that is named does not run"


class Bench:
    """Engines in processes of their own, and the commands that look after them.

    Other engines may run on this machine: they are looked away from.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results = folder / "runs"
        self.processes: list[subprocess.Popen[str]] = []

    def start(self, *words: object, before: str = "") -> subprocess.Popen[str]:
        """A program that may be an engine."""
        self.processes.append(start_madrob(*words, before=before))
        return self.processes[-1]

    def serve(
        self, *options: str, before: str = "", results: Path | None = None
    ) -> subprocess.Popen[str]:
        """An engine that starts."""
        testbed = ("--testbed", "simulated", f"--results={results or self.results}")
        return self.start("engine", "serve", "--idle-time=600", *testbed, *options, before=before)

    def served(
        self, *options: str, before: str = "", results: Path | None = None
    ) -> subprocess.Popen[str]:
        """An engine, once it admits screens."""
        process = self.serve(*options, before=before, results=results)

        def ready() -> bool:
            answers = [one.answer for one in self.only_its_own() if one.pid == process.pid]
            return any(answer and answer.phase != "starting" for answer in answers)

        until(ready, 60.0)
        return process

    def only_its_own(self) -> tuple[FoundEngine, ...]:
        """All engines that this test started."""
        pids = {process.pid for process in self.processes}
        return tuple(one for one in running_engines_of_all() if one.pid in pids)

    def engine(self, *words: str) -> tuple[int, str]:
        """What `madrob engine` ends with, and what it says."""
        with redirect_stdout(io.StringIO()) as said:
            code = main(["engine", *words])
        return code, said.getvalue()

    def status(self, process: subprocess.Popen[str]) -> str:
        """What `madrob engine status` says of one engine; empty = nothing."""
        lines = self.engine("status")[1].splitlines()
        return next((line for line in lines if f"pid {process.pid}," in line), "")

    def attach(self, *options: str) -> RemoteEngine:
        """What `madrob console` does before it shows anything."""
        words = ["console", "--testbed", "simulated", f"--results={self.results}", *options]
        return attach(build_parser().parse_args(words), load_settings(None), Role.REFEREE)

    def refused(self, *options: str) -> str:
        """Why a console does not attach."""
        with pytest.raises(MadrobError) as refused:
            self.attach(*options)
        return str(refused.value)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    monkeypatch.setattr(running_engines, "running_engines", bench.only_its_own)
    monkeypatch.setattr(running_engines, "HANGING_TIME", 60.0)  # of a busy machine
    monkeypatch.setattr(running_engines, "ENDING_TIME", 60.0)
    yield bench
    for process in bench.processes:
        process.kill()
        process.communicate()


def test_a_run_is_aborted_after_its_login_and_has_no_rival_without_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    own = {"XDG_RUNTIME_DIR": str(tmp_path / "run")}
    with EngineProcess(tmp_path / "runs", "no-touch", environment=own) as engine:
        engine.start(make_setup(timeout=600.0))
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        bench = Bench(tmp_path)
        with closing(bench.attach("--scenario=no-touch")) as console:
            assert console.pid == engine.process.pid  # no second one
            shutil.rmtree(tmp_path / "state")
            refused = bench.refused("--scenario=no-touch")
            assert f"(user {this_user()}, pid {console.pid} on " in refused
            assert console.snapshot().run.phase is Phase.RUNNING
            assert console.send_request(TakeOver()) is None
            assert console.send_request(Perform.of(Abort("enough"))) is None
        assert engine.result()["outcome"] == "aborted"  # its first screen is still attached


def test_an_idle_simulated_engine_makes_way_for_the_live_testbed(
    bench: Bench, ros_domain: int
) -> None:
    """Not while a screen is attached."""
    process = bench.served()
    live = [f"--results={bench.results}", "--testbed", "ros", "--idle-time=0.5"]
    argv = [*MADROB, "console", *live]
    with closing(bench.attach()), Terminal(argv, 160, cwd=ROOT) as refused:
        refused.wait_for(f"an engine already (SIMULATED nominal, pid {process.pid}, ", timeout=60.0)
        assert refused.wait_exit(60.0) == 2
    until(lambda: "screen" not in bench.status(process))
    with Terminal(argv, 160, cwd=ROOT) as console:
        console.wait_for(f"LIVE ros domain {ros_domain}", timeout=60.0)
        assert process.wait(60.0) == 0
    until(lambda: find_engine(f"ros_domain_{ros_domain}") is None, 60.0)


def test_a_results_folder_has_one_engine_by_whatever_path_and_a_screen_keeps_it(
    bench: Bench,
) -> None:
    first = bench.served()
    link = bench.folder / "link"
    link.symlink_to(bench.results)
    second, again = bench.serve("--scenario=slow", results=link), bench.serve()
    said = second.communicate(timeout=60.0)[0]
    assert (second.returncode, said.count("\n")) == (2, 1)
    assert f"an engine already (SIMULATED nominal, pid {first.pid}, since " in said
    assert f"`madrob console --testbed simulated --results={bench.results}` attaches" in said
    assert f"`madrob engine stop --pid {first.pid}` ends it" in said
    assert f"pid {first.pid}, since " in bench.refused("--scenario=slow")
    assert again.wait(60.0) == TAKEN
    with closing(bench.attach(f"--results={link}")) as console:
        assert console.pid == first.pid
        code, said = bench.engine("stop")
        assert code == 1
        assert said.startswith(f"SIMULATED nominal: goes on, a screen is attached; {CUT_OFF}")
        assert console.snapshot().refusal("set up") is None  # its referee may still act
        argv = [*MADROB, "engine", "stop", f"--results={bench.results}"]
        for typed, code in (("\r", 1), ("y\r", 0)):
            assert first.poll() is None
            with Terminal(argv, 160, cwd=ROOT) as terminal:
                terminal.wait_for("a screen is attached. End it all the same? [y/N]")
                terminal.send(typed)
                assert terminal.wait_exit(60.0) == code
    assert first.wait(1.0) == 0


def test_a_console_without_arguments_comes_back_to_the_engine_of_its_results_folder(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("madrob_console.ui.terminal.check_terminal", lambda *_: None)
    monkeypatch.setenv("TERM", "xterm")
    own, two = bench.folder / "own", bench.folder / "two"
    settings = bench.folder / "config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(f"[results]\nfolder = '{own}'\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(bench.folder / "config"))

    def meant(*words: str) -> list[int]:
        arguments = build_parser().parse_args(["console", *words])
        return [one.pid for one in running_engines.engines_meant(arguments, bench.results)]

    def lines(command: str) -> list[str]:
        """What to type for each engine, after the first line."""
        assert main([command]) == 2
        head, *rest = capsys.readouterr().err.splitlines()
        return [head, *sorted(line.strip() for line in rest if line.startswith("    "))]

    assert meant() == []  # none runs: the live testbed is looked for
    process = bench.served("--scenario=slow", "--seed=5")
    for other in (["--seed=6"], ["--testbed", "ros"], ["--domain=3"], [f"--results={ROOT}"]):
        assert meant(*other) == []
    assert meant("--no-bell") == [process.pid]
    arguments = build_parser().parse_args(["console"])
    running_engines.mean(arguments, *bench.only_its_own())
    with closing(attach(arguments, load_settings(None), Role.REFEREE)) as console:
        assert console.pid == process.pid
    first = f"--testbed simulated --results={bench.results} --scenario=slow"
    first += " --seed=5"
    starts = f"madrob console --results {own}"
    head = "madrob: 1 engine runs: type the line of the one that you mean"
    assert lines("console") == [head, starts, f"madrob console {first}"]
    bench.served(results=two)
    assert meant() == [process.pid]  # its own goes before all others
    second = f"--testbed simulated --results={two}"
    head = "madrob: 2 engines run: type the line of the one that you mean"
    watches = [f"madrob watch {first}", f"madrob watch {second}"]
    assert lines("watch") == [head, *watches]


def test_each_form_of_stop_ends_what_it_names_and_nothing_else(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(bench.folder / "none"))
    two, run = bench.folder / "two", final()
    served = [bench.served(), bench.served("--scenario=slow", results=two)]
    replay = bench.start("engine", "serve", "--idle-time=600", "--testbed", "replay", run)
    until(lambda: "REPLAY" in bench.status(replay), 60.0)  # nobody sees it
    settings = bench.folder / "madrob.toml"
    settings.write_text(f"[results]\nfolder = '{bench.results}'\n")

    def going_on() -> list[bool]:
        return [process.poll() is None for process in (*served, replay)]

    code, said = bench.engine("stop", "--force")
    assert (code, said.partition("\n")[0]) == (
        1,
        "3 engines run: name one of them, or end them with --all",
    )
    for process, folder in zip(served, (bench.results, two), strict=True):
        assert f", runs in {folder}: `madrob engine stop --pid {process.pid}` ends it" in said
    for other in (
        ("--domain", "16"),
        ("--results", str(bench.folder / "four")),
        ("--testbed", "simulated", "--results", str(bench.folder / "four")),
        ("--testbed", "replay", "bag"),
        ("--testbed", "ros", "--results", str(bench.results)),
        ("--pid", str(os.getpid())),
    ):
        code, said = bench.engine("stop", "--force", *other)
        assert (code, said.partition("\n")[0]) == (1, f"{NOBODY}; these do:")
    assert going_on() == [True, True, True]

    assert bench.engine("stop", "--results", str(two)) == (0, "SIMULATED slow: ended\n")
    assert going_on() == [True, False, True]
    assert bench.engine("stop", "--testbed", "replay", str(run))[0] == 0
    assert going_on() == [True, False, False]
    assert bench.engine("stop", "--testbed", "simulated", f"--settings={settings}")[0] == 0
    assert going_on() == [False, False, False]
    assert bench.engine("stop") == (0, "no engine runs\n")
    assert bench.engine("stop", "--results", str(two)) == (1, f"{NOBODY}\n")


def test_an_engine_of_another_version_is_ended_by_the_line_that_the_console_says(
    bench: Bench,
) -> None:
    process, other = bench.served(before=OTHER_VERSION), bench.served(results=bench.folder / "two")
    assert f"pid {process.pid}, " in bench.status(process)
    refused = bench.refused()
    assert "speaks version 900, this console " in refused
    assert f"`madrob engine stop --pid {process.pid}` ends it" in refused
    assert bench.engine("stop", "--all") == (0, 2 * "SIMULATED nominal: ended\n")
    assert other.wait(1.0) == 0
    told = f"a console of version {wire.VERSION} was rejected: this engine speaks version 900"
    assert process.communicate(timeout=60.0)[0].count(told) == 1


def test_an_engine_that_was_stopped_by_a_signal_is_there_but_silent(bench: Bench) -> None:
    process = bench.served()
    stop_process(process.pid)
    silent, line = "there, but silent", f"madrob engine stop --pid {process.pid}"
    assert bench.status(process).endswith(f", {silent}, runs in {bench.results}")
    assert '"phase": null' in bench.engine("status", "--json")[1]
    assert re.search(rf"{silent} \(.*since .*`{line}` ends it", bench.refused())
    code, said = bench.engine("stop", *line.split()[3:])
    assert (code, CUT_OFF in said, process.poll()) == (1, True, None)
    assert bench.engine("stop", f"--pid={process.pid}", "--force")[0] == 0
    assert process.wait(1.0) == 0  # in order: it went on for that


def test_an_engine_that_hangs_says_so_and_is_killed_when_it_does_not_end(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = bench.served(before=HANGS)
    until(lambda: "  the engine has not moved for " in bench.engine("status")[1])
    with closing(bench.attach()) as console:
        process.send_signal(signal.SIGTERM)
        assert until(lambda: told_by(console), 60.0).startswith(ENDED)
        assert ", ending, " in bench.status(process)
        monkeypatch.setattr("madrob_console.cli.attaching.STARTING_TIME", 1.0)
        assert "is ending and not gone yet: " in bench.refused()
        monkeypatch.setattr(running_engines, "ENDING_TIME", 1.0)
        code, said = bench.engine("stop", "--results", str(bench.results), "--force")
        assert code == 0
        assert "has not ended within 1 s, it is killed" in said
        assert said.endswith("ended; the next engine asks about a run that went on\n")
        assert process.wait(1.0) == -signal.SIGKILL


def test_an_engine_that_is_told_to_end_once_more_while_it_ends_keeps_its_run(
    tmp_path: Path,
) -> None:
    with EngineProcess(tmp_path / "runs", "no-touch") as engine:
        engine.start(make_setup(timeout=600.0))
        folder = engine.folder
        engine.process.send_signal(signal.SIGTERM)
        until(lambda: told_by(engine.client), 60.0)
        engine.process.send_signal(signal.SIGTERM)
        engine.process.wait(60.0)
    assert '"outcome": "interrupted"' in (folder / "result.json").read_text()


@pytest.mark.needs("mkfs.ext4")
def test_what_a_disk_holds_back_is_said_to_go_on_until_it_has_ended(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    for time in ("ENDING_TIME", "HANGING_TIME", "KILLING_TIME"):
        monkeypatch.setattr(running_engines, time, 1.0)
    with disk_image(bench.folder / "disk") as disk:
        bench.results = disk.folder / "runs"
        process = bench.served("--scenario=no-touch")
        with closing(bench.attach("--scenario=no-touch")) as console:
            assert console.send_request(Perform.of(SetUp(make_setup()))) is None
            until(lambda: "recorder" in {check.name for check in console.snapshot().checks})
            with disk.hanging():
                until(lambda: console.snapshot().pulse.disk >= 1)
                code, said = bench.engine("stop", f"--results={bench.results}", "--force")
                assert code == 1
                assert "has not ended within 1 s, it is killed" in said
                assert "the machine waits for a disk, and ends it when that answers" in said
                assert ", there, but silent, " in bench.status(process)
                assert until(lambda: told_by(console)).startswith(ENDED)
                again = bench.serve()
                assert f"pid {process.pid}, since " in again.communicate(timeout=60.0)[0]
                assert process.poll() is None
        assert process.wait(60.0) in (0, -signal.SIGKILL)  # it may have been on its way out


def test_a_run_without_screens_is_listed_refused_to_a_console_and_stopped(bench: Bench) -> None:
    testbed = ("--testbed", "simulated", f"--results={bench.results}", "--scenario=no-touch")
    flags = ("--subject=3", "--countdown=1", "--timeout=600", "--wait=60", "--no-report")
    process = bench.start("run", *testbed, *flags)
    until(lambda: "RUNNING, run 1 of subject 3, " in bench.status(process), 60.0)
    assert "a `madrob run` has the testbed" in bench.refused("--scenario=no-touch")
    code, said = bench.engine("stop", "--results", str(bench.results))
    assert (code, "a run that goes on is aborted and does not count" in said) == (1, True)
    code, _ = bench.engine("stop", "--results", str(bench.results), "--force")
    assert (code, process.wait(1.0)) == (0, 4)
