"""An engine is found by what it owns, and ended by name: real processes, lost folders, hangs."""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, redirect_stdout
from pathlib import Path

import pytest

from madrob_console.cli import running_engines
from madrob_console.cli import running_engines as console_command
from madrob_console.cli.attaching import TAKEN, attach, owned_testbed
from madrob_console.cli.main import build_parser, main
from madrob_console.common.errors import MadrobError
from madrob_console.config import load_settings
from madrob_console.engine import wire
from madrob_console.engine.client import RemoteEngine
from madrob_console.engine.discovery import FoundEngine
from madrob_console.engine.discovery import running_engines as running_engines_of_all
from madrob_console.engine.requests import Perform, Role, TakeOver
from madrob_console.referee.acts import Abort, SetUp
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.small_disk import disk_image
from tests.madrob_console.stranger import stranger
from tests.terminal import Terminal
from tests.watching import until

pytestmark = pytest.mark.timeout(240)  # some start three engines, on whatever machine

ROOT = Path(__file__).parents[3]
MADROB = "import sys; from madrob_console.cli.main import main; sys.exit(main())"
OTHER_VERSION = "from madrob_console.engine import wire; wire.VERSION = 900;"
HANGS = """
import time
from madrob_console.engine.core import Engine
Engine.step = lambda *_: time.sleep(600)
"""
CUT_OFF = "--force ends it all the same"


class Bench:
    """Engines in processes of their own, and the commands that look after them.

    Other engines may run on this machine: they are looked away from.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results = folder / "runs"
        self.processes: list[subprocess.Popen[str]] = []

    def serve(
        self, *options: str, patched: str = "", results: Path | None = None
    ) -> subprocess.Popen[str]:
        """An engine, once it answers."""
        process = self.start(*options, patched=patched, results=results)
        until(lambda: self._ready(process), 60.0)
        return process

    def start(
        self, *options: str, patched: str = "", results: Path | None = None
    ) -> subprocess.Popen[str]:
        """An engine that starts."""
        named = ("--testbed", "simulated", f"--results={results or self.results}", *options)
        process = subprocess.Popen(
            [sys.executable, "-c", patched + MADROB, "engine", "serve", "--idle-time=600", *named],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            cwd=ROOT,
            text=True,
            stderr=subprocess.PIPE,
        )
        self.processes.append(process)
        return process

    def _ready(self, process: subprocess.Popen[str]) -> bool:
        """It admits screens; one that has just begun may still be silent."""
        found = [one.answer for one in self.only_its_own() if one.pid == process.pid]
        return any(answer and answer.phase != "starting" for answer in found)

    def only_its_own(self) -> tuple[FoundEngine, ...]:
        """All engines that this test started."""
        pids = {process.pid for process in self.processes}
        return tuple(one for one in running_engines_of_all() if one.pid in pids)

    def listed(self) -> str:
        """What `madrob engine status` says."""
        with redirect_stdout(io.StringIO()) as said:
            main(["engine", "status"])
        return said.getvalue()

    def status(self, process: subprocess.Popen[str]) -> str | None:
        """What it says of one engine."""
        lines = [line for line in self.listed().splitlines() if f"pid {process.pid}," in line]
        return lines[0] if lines else None

    def stop(self, *options: str) -> tuple[int, str]:
        """`madrob engine stop`: its exit code, and what it says."""
        with redirect_stdout(io.StringIO()) as said:
            code = main(["engine", "stop", *options])
        return code, said.getvalue()

    def attach(self, *options: str) -> RemoteEngine:
        """What `madrob console` does before it shows anything."""
        words = ["console", "--testbed", "simulated", f"--results={self.results}", *options]
        return attach(build_parser().parse_args(words), load_settings(None), Role.REFEREE)

    def close(self) -> None:
        """End what is left."""
        for process in self.processes:
            process.kill()
            process.communicate()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    monkeypatch.setattr(running_engines, "running_engines", bench.only_its_own)
    monkeypatch.setattr(running_engines, "HANGING_TIME", 60.0)  # of a busy machine
    monkeypatch.setattr(running_engines, "ENDING_TIME", 60.0)
    yield bench
    bench.close()


# ------------------------------------------------------------------ what is lost is found


def test_a_run_whose_folders_are_removed_is_seen_and_aborted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = {"XDG_STATE_HOME": str(tmp_path / "state"), "XDG_RUNTIME_DIR": str(tmp_path / "run")}
    with EngineProcess(tmp_path / "runs", "no-touch", environment=own) as engine:
        engine.start(make_setup(timeout=600.0))
        for folder in own.values():
            shutil.rmtree(folder, ignore_errors=True)
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))  # of another login
        words = ["console", "--testbed", "simulated", "--scenario=no-touch"]
        arguments = build_parser().parse_args([*words, f"--results={tmp_path / 'runs'}"])
        console = attach(arguments, load_settings(None), Role.REFEREE)
        with closing(console):
            assert console.pid == engine.process.pid  # no second one
            assert console.snapshot().run.phase is Phase.RUNNING
            assert console.send_request(TakeOver()) is None
            assert console.send_request(Perform.of(Abort("enough"))) is None
        assert engine.result()["outcome"] == "aborted"  # its first screen is still attached


def test_a_console_by_another_path_to_the_results_finds_the_same_engine(bench: Bench) -> None:
    process = bench.serve()
    link = bench.folder / "link"
    link.symlink_to(bench.results)
    with closing(bench.attach(f"--results={link}")) as console:
        assert console.pid == process.pid


def test_a_second_engine_on_the_results_folder_is_refused_and_names_the_first(
    bench: Bench,
) -> None:
    first = bench.serve()
    link = bench.folder / "link"
    link.symlink_to(bench.results)
    second = bench.start("--scenario=slow", results=link)
    _, said = second.communicate(timeout=60.0)
    assert second.returncode == 2
    assert said.count("\n") == 1, said
    assert f"an engine already (SIMULATED nominal, pid {first.pid}, since " in said
    assert f"`madrob console --testbed simulated --results={bench.results}` attaches" in said
    assert f"`madrob engine stop --results {bench.results}` ends it" in said
    with pytest.raises(MadrobError, match=f"pid {first.pid}, since .* attaches to it"):
        bench.attach("--scenario=slow")
    again = bench.start()
    assert again.wait(60.0) == TAKEN


# ------------------------------------------------------------------ coming back


def test_a_console_without_arguments_comes_back_to_the_engine_of_its_results_folder(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console_command, "running_engines", bench.only_its_own)

    def meant(*words: str) -> tuple[FoundEngine, ...]:
        arguments = build_parser().parse_args(["console", *words])
        return console_command.engines_meant(arguments, bench.results)

    assert meant() == ()  # none runs: the live testbed is looked for
    process = bench.serve("--scenario=slow", "--latency=20ms,door=50ms")
    assert meant("--latency=20ms") == ()
    assert meant("--testbed", "ros") == meant("--domain=3") == meant(f"--results={ROOT}") == ()
    (only,) = meant("--ascii")
    arguments = build_parser().parse_args(["console"])
    console_command.mean(arguments, only)
    assert (arguments.testbed, arguments.scenario) == (["simulated"], "slow")
    assert (arguments.latency, arguments.jitter) == ("20ms,door=50ms", None)
    assert arguments.results == bench.results
    with closing(attach(arguments, load_settings(None), Role.REFEREE)) as console:
        assert console.pid == process.pid

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("madrob_console.ui.terminal.check_terminal", lambda *_: None)
    own, two = bench.folder / "own", bench.folder / "two"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(bench.folder / "config"))
    settings = bench.folder / "config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(f"[results]\nfolder = '{own}'\n")
    first = f"--testbed simulated --results={bench.results} --scenario=slow"
    first += " --latency=20ms,door=50ms"

    def asked(command: str) -> list[str]:
        """What to type for each engine, after the first line."""
        assert main([command]) == 2
        said = capsys.readouterr().err.splitlines()
        lines = [line.strip() for line in said if line.startswith("    ")]
        return [said[0], *sorted(lines)]

    one_runs = "madrob: 1 engine runs: type the line of the one that you mean"
    starts = f"madrob console --results {own}"
    assert asked("console") == [one_runs, starts, f"madrob console {first}"]

    bench.serve(results=two)
    (again,) = meant()  # its own goes before all others
    assert again.pid == process.pid
    both = "madrob: 2 engines run: type the line of the one that you mean"
    other = f"--testbed simulated --results={two}"
    assert asked("console") == [
        both, starts, f"madrob console {first}", f"madrob console {other}"
    ]  # fmt: skip
    assert asked("watch") == [both, f"madrob watch {first}", f"madrob watch {other}"]


# ------------------------------------------------------------------ status and stop


def test_each_form_of_stop_ends_what_it_names_and_nothing_else(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = bench.serve()
    two = bench.serve("--scenario=slow", results=bench.folder / "two")
    three = bench.serve(results=bench.folder / "three")
    settings = bench.folder / "madrob.toml"
    settings.write_text(f"[results]\nfolder = '{bench.results}'\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(bench.folder / "none"))

    code, said = bench.stop("--force")
    assert code == 1
    assert said.startswith("3 engines run: name one of them, or end them with --all\n")
    for process, folder in ((one, bench.results), (two, bench.folder / "two")):
        assert f"pid {process.pid}, " in said
        assert f"`madrob engine stop --results {folder}` ends it" in said
    for other in (
        ("--testbed", "ros", "--domain", "0"),
        ("--domain", "16"),
        ("--results", str(bench.folder / "four")),
        ("--testbed", "simulated", "--results", str(bench.folder / "four")),
        ("--testbed", "replay", "bag"),
        ("--testbed", "ros", "--results", str(bench.results)),
        ("--pid", str(os.getpid())),
    ):
        code, said = bench.stop("--force", *other)
        assert (code, said.partition("\n")[0]) == (
            1,
            "the engine that is named does not run; these do:",
        )
    assert [process.poll() for process in (one, two, three)] == [None] * 3

    assert bench.stop("--results", str(bench.folder / "two")) == (0, "SIMULATED slow: ended\n")
    assert two.wait(1.0) == 0
    assert one.poll() is three.poll() is None
    named = ("--testbed", "simulated", f"--settings={settings}")  # the folder of the settings
    assert bench.stop(*named) == (0, "SIMULATED nominal: ended\n")
    assert one.wait(1.0) == 0
    assert three.poll() is None
    assert bench.stop() == (0, "SIMULATED nominal: ended\n")  # the only one
    assert three.wait(1.0) == 0
    assert bench.stop() == (0, "no engine runs\n")
    assert bench.stop(*named) == (1, "the engine that is named does not run\n")


def test_all_engines_end_only_when_all_are_named(bench: Bench) -> None:
    both = bench.serve(), bench.serve(results=bench.folder / "two")
    code, said = bench.stop("--all")
    assert (code, said) == (0, 2 * "SIMULATED nominal: ended\n")
    assert [process.wait(1.0) for process in both] == [0, 0]


def test_an_engine_with_a_screen_goes_on_and_its_referee_keeps_the_right_to_act(
    bench: Bench,
) -> None:
    process = bench.serve()
    with closing(bench.attach()) as console:
        code, said = bench.stop()
        assert code == 1
        assert said.startswith(f"SIMULATED nominal: goes on, a screen is attached; {CUT_OFF}")
        assert console.snapshot().refusal("set up") is None
        argv = [sys.executable, "-c", MADROB, "engine", "stop", f"--results={bench.results}"]
        for typed, code in (("\r", 1), ("n\r", 1), ("y\r", 0)):
            assert process.poll() is None
            with Terminal(argv, 160, env={"PYTHONPATH": str(ROOT)}, cwd=ROOT) as terminal:
                terminal.wait_for("a screen is attached. End it all the same? [y/N]")
                terminal.send(typed)
                assert terminal.wait_exit(60.0) == code
    assert process.wait(1.0) == 0


def test_a_replay_that_nobody_sees_is_listed_and_ended(bench: Bench, tmp_path: Path) -> None:
    with EngineProcess(tmp_path / "recorded", "no-touch") as engine:
        engine.start(make_setup(timeout=600.0))
        engine.act(Abort("enough"))
        engine.result()
        folder = engine.folder
    process = bench.start("--testbed", "replay", str(folder))
    until(lambda: "REPLAY" in (bench.status(process) or ""), 60.0)
    assert bench.stop("--testbed", "replay", str(folder))[0] == 0
    assert process.wait(1.0) == 0


# ------------------------------------------------------------------ other versions, and hangs


def test_an_engine_of_another_version_is_ended_by_the_line_that_the_console_says(
    bench: Bench,
) -> None:
    process = bench.serve(patched=OTHER_VERSION)
    assert ", of another version (" in str(bench.status(process))
    line = f"madrob engine stop --results {bench.results}"
    with pytest.raises(MadrobError, match=rf"speaks version 900, this console .*`{line}` ends it"):
        bench.attach()
    assert bench.stop(*line.split()[3:]) == (0, "SIMULATED nominal: ended\n")
    assert process.wait(1.0) == 0
    assert process.stderr is not None
    refused = f"a console of version {wire.VERSION} was rejected: this engine speaks version 900"
    assert process.stderr.read().count(refused) == 1


def test_a_screen_and_a_new_console_are_told_that_an_engine_is_ending(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = bench.serve(patched=HANGS)
    with closing(bench.attach()) as console:
        process.send_signal(signal.SIGTERM)
        until(lambda: gone(console), 60.0)
        with pytest.raises(MadrobError, match="the engine is ending: it closes its files"):
            console.snapshot()
        assert ", ending, " in str(bench.status(process))
        monkeypatch.setattr("madrob_console.cli.attaching.STARTING_TIME", 1.0)
        with pytest.raises(MadrobError, match=r"is ending and not gone yet: .*ends it"):
            bench.attach()
        process.kill()
        process.wait(60.0)
        with pytest.raises(MadrobError, match="the engine has ended"):
            console.snapshot()


def gone(console: RemoteEngine) -> bool:
    """Whether nothing more comes of the engine."""
    try:
        console.snapshot()
    except MadrobError:
        return True
    return False


def test_another_user_who_has_its_names_stops_no_engine_and_is_ended_by_nobody(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["console", "--testbed", "simulated", f"--results={bench.results}"]
    owned = owned_testbed(build_parser().parse_args(words), load_settings(None))
    with stranger(f"{owned.testbed}/1", f"{owned.testbed}/x", full=True) as process:
        first = bench.serve()
        with closing(bench.attach()) as console:
            assert (console.pid, console.results) == (first.pid, bench.results)
            second = bench.start()
            _, said = second.communicate(timeout=60.0)
            assert (second.returncode, said.count("\n")) == (TAKEN, 1)
            assert f"pid {first.pid}, since" in said
            monkeypatch.setattr(running_engines, "running_engines", running_engines_of_all)
            line = bench.listed()
            assert f"SIMULATED nominal: pid {console.pid}, since" in line
            assert f"pid {process.pid}" not in line
            code, said = bench.stop(f"--pid={process.pid}", "--force")
            assert (code, "the engine that is named does not run" in said) == (1, True)
        assert bench.stop(f"--pid={first.pid}", "--force")[0] == 0


def test_an_engine_that_was_stopped_by_a_signal_is_there_but_silent(bench: Bench) -> None:
    process = bench.serve()
    process.send_signal(signal.SIGSTOP)
    assert "since " in str(bench.status(process))
    assert str(bench.status(process)).endswith(f", there, but silent, runs in {bench.results}")
    line = f"madrob engine stop --results {bench.results}"
    with pytest.raises(MadrobError, match=rf"there, but silent \(.*since .*`{line}` ends it"):
        bench.attach()
    code, said = bench.stop(*line.split()[3:])
    assert (code, CUT_OFF in said) == (1, True)
    assert process.poll() is None
    assert bench.stop(f"--pid={process.pid}", "--force")[0] == 0
    assert process.wait(1.0) == 0  # in order: it went on for that


def test_an_engine_that_is_told_to_end_once_more_while_it_ends_keeps_its_run(
    tmp_path: Path,
) -> None:
    with EngineProcess(tmp_path / "runs", "no-touch") as engine:
        engine.start(make_setup(timeout=600.0))
        folder = engine.folder
        engine.process.send_signal(signal.SIGTERM)
        until(lambda: gone(engine.client), 60.0)
        engine.process.send_signal(signal.SIGTERM)
        engine.process.wait(60.0)
    assert '"outcome": "interrupted"' in (folder / "result.json").read_text()


def test_an_engine_that_hangs_says_so_and_is_killed_when_it_does_not_end(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = bench.serve(patched=HANGS)
    until(lambda: "  the engine has not moved for " in bench.listed())
    monkeypatch.setattr(running_engines, "ENDING_TIME", 1.0)
    code, said = bench.stop("--results", str(bench.results))
    assert code == 0
    assert "has not ended within 1 s, it is killed" in said
    assert said.endswith("ended; the next engine asks about a run that went on\n")
    assert process.wait(1.0) == -signal.SIGKILL


@pytest.mark.needs("mkfs.ext4")
def test_what_a_disk_holds_back_is_said_to_go_on_until_it_has_ended(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running_engines, "ENDING_TIME", 1.0)
    monkeypatch.setattr(running_engines, "HANGING_TIME", 1.0)
    monkeypatch.setattr(running_engines, "KILLING_TIME", 1.0)
    with disk_image(bench.folder / "disk") as disk:
        results = disk.folder / "runs"
        process = bench.serve("--scenario=no-touch", results=results)
        with closing(bench.attach("--scenario=no-touch", f"--results={results}")) as console:
            assert console.send_request(Perform.of(SetUp(make_setup()))) is None
            until(lambda: "recorder" in {check.name for check in console.snapshot().checks})
            with disk.stalled():
                until(lambda: console.snapshot().pulse.disk >= 1)
                code, said = bench.stop(f"--results={results}", "--force")
                assert code == 1
                assert "has not ended within 1 s, it is killed" in said
                assert said.endswith(
                    "the machine waits for a disk, and ends it when that answers\n"
                )
                assert process.poll() is None
                assert ", killed: it ends when a disk answers" in str(bench.status(process))
                until(lambda: gone(console))
                with pytest.raises(MadrobError, match="the engine is ending: it closes its files"):
                    console.snapshot()
                again = bench.start(results=results)
                assert f"pid {process.pid}, since " in again.communicate(timeout=60.0)[1]
                assert bench.stop(f"--results={results}", "--force")[0] == 1
                assert process.poll() is None
        assert process.wait(60.0) in (0, -signal.SIGKILL)  # it may have been on its way out
        assert bench.stop(f"--results={results}")[0] == 1


def test_a_run_without_screens_is_listed_refused_to_a_console_and_stopped(bench: Bench) -> None:
    flags = ["--subject=3", "--scenario=no-touch", "--countdown=1", "--timeout=600", "--no-report"]
    process = subprocess.Popen(
        [sys.executable, "-c", MADROB, "run", "--testbed", "simulated",
         f"--results={bench.results}", *flags],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, cwd=ROOT, text=True, stdout=subprocess.PIPE,
    )  # fmt: skip
    bench.processes.append(process)
    until(lambda: "RUNNING, run 1 of subject 3, " in (bench.status(process) or ""), 60.0)
    with pytest.raises(MadrobError, match="a `madrob run` has the testbed"):
        bench.attach("--scenario=no-touch")
    code, said = bench.stop("--results", str(bench.results))
    assert (code, "a run that goes on is aborted and does not count" in said) == (1, True)
    code, _ = bench.stop("--results", str(bench.results), "--force")
    assert (code, process.wait(1.0)) == (0, 4)
