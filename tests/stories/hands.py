"""The hands of the stories: one function an act.

This file alone knows keys, options of commands and names of files in a run.
"""

from __future__ import annotations

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fcntl import LOCK_EX, LOCK_NB, flock
from importlib.util import find_spec
from itertools import count, pairwise
from pathlib import Path
from typing import Any, Self, TypeAlias

import pytest

from tests.stories.terminal import PATIENCE, Terminal, wait_until

MADROB = str(Path(sys.executable).with_name("madrob"))
_HALLS = count()
_READING = 0.5  # s that a person takes to read why a key was left out
_FORGOTTEN = 2.0  # s after which the words about a key that was left out may be about this one
_LEFT_OUT = (" left out: ", "Refused: ", ": look again.", "Not set up yet")
CORRECTED, RULED, SIGNED, TAKEN_BACK = "correct", "rule on a step", "finalise", "take back"
"""Names of acts in the journal of a run."""
_DEFAULTS: Mapping[str, Mapping[str, object]] = {
    "competition": {"name": "Euro Door Cup", "referee": "R. Eferee"},
    "run": {"countdown": 1.0},
    "checks": {"disk_space": 0},
    "results": {"reports": False},
}
_SENT_OVER_SSH = ("HOME", "LC_ALL", "PATH", "ROS_", "TERM", "XDG_")
# A program of its own, so that the tests themselves need no ROS.
_HAND = """\
import sys, time, rclpy
from geometry_msgs.msg import WrenchStamped
rclpy.init()
node = rclpy.create_node("hand")
for line in sys.stdin:
    publisher = node.create_publisher(WrenchStamped, "/madrob/handle/force", 10)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    message = WrenchStamped()
    message.header.stamp = node.get_clock().now().to_msg()
    message.wrench.force.x = 60.0
    publisher.publish(message)
"""
_NOT_INHERITED = (
    "COLORTERM",
    "COLUMNS",
    "LINES",
    "NO_COLOR",
    "TMUX",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)


needs_ros = pytest.mark.skipif(find_spec("rclpy") is None, reason="needs ROS: pip install '.[ros]'")
"""Marks stories that need ROS 2."""


def _own_domain() -> tuple[int, int]:
    """A ROS domain that no other test of this machine has, and the lock that keeps it."""
    for _ in range(100):
        domain = 1 + (os.getpid() + next(_HALLS)) % 100
        lock = os.open(f"{tempfile.gettempdir()}/madrob-test-domain-{domain}", os.O_CREAT)
        try:
            flock(lock, LOCK_EX | LOCK_NB)
        except BlockingIOError:
            os.close(lock)
        else:
            return domain, lock
    pytest.fail("every ROS domain is in use by tests")


def system_program(name: str) -> str:
    """Return where a program of the system lies, also in a folder that only root searches."""
    return shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin:/sbin") or name


@dataclass(frozen=True)
class Done:
    """A command that has run to its end, with all that it printed."""

    code: int
    output: str
    errors: str


class Hall:
    """One machine of a competition: a home, settings, results, and the programs that run there.

    Args:
        folder: an empty folder for all of it.
    """

    def __init__(self, folder: Path) -> None:
        self.home = folder
        self.results = folder / "madrob_runs"
        # The path of a socket is short, and the folders of pytest are long.
        self.state = Path(tempfile.mkdtemp(prefix="madrob-"))
        self.settings_file = folder / ".config" / "madrob" / "madrob.toml"
        self.domain, self._lock = _own_domain()
        inherited = {k: v for k, v in os.environ.items() if k not in _NOT_INHERITED}
        self.environment = inherited | {
            "HOME": str(folder),
            "XDG_CONFIG_HOME": str(folder / ".config"),
            "XDG_STATE_HOME": str(self.state),
            "XDG_CACHE_HOME": str(folder / ".cache"),
            "XDG_DATA_HOME": str(folder / ".local"),
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "LC_ALL": "C.UTF-8",
            "TERM": "xterm-256color",
            "TEXTUAL_ANIMATIONS": "none",
        }
        self._programs: list[subprocess.Popen[bytes]] = []
        self._terminals: list[Terminal] = []
        self._hand: subprocess.Popen[bytes] | None = None
        self._teams = folder / "teams.csv"
        self.write_teams({1: "Alpha", 2: "Beta"})
        self.set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end_programs()
        os.close(self._lock)
        shutil.rmtree(self.state, ignore_errors=True)

    def end_programs(self) -> None:
        """End all that was started here, whatever state it is in."""
        for terminal in self._terminals:
            terminal.close()
        wait_until(self._kill_all, "the end of all programs of this hall")
        for program in self._programs:
            program.wait()
        if self._hand is not None and self._hand.stdin is not None:
            self._hand.stdin.close()
        self._terminals.clear()

    # --- settings, teams, plan

    def set(self, more: str = "", **tables: Mapping[str, object]) -> None:
        """Write the settings: what stories need, over it these tables, then this TOML text."""
        lines: list[str] = []
        for name in {**_DEFAULTS, **tables}:
            values = {**_DEFAULTS.get(name, {}), **tables.get(name, {})}
            if name == "competition":
                values = {"teams_file": str(self._teams), **values}
            if name == "results":
                values = {"folder": str(self.results), **values}
            lines += [f"[{name}]", *(f"{key} = {json.dumps(v)}" for key, v in values.items())]
        self.settings_file.parent.mkdir(parents=True, exist_ok=True)
        self.settings_file.write_text("\n".join([*lines, more]), encoding="utf-8")

    def write_teams(self, teams: Mapping[int, str]) -> None:
        """Write the list of teams."""
        rows = [f"{subject},{team}" for subject, team in teams.items()]
        self._teams.write_text("\n".join(["subject,team", *rows, ""]), encoding="utf-8")

    def put_results(self, folder: Path) -> None:
        """Keep the runs in another folder."""
        self.results = folder
        self.set()

    # --- programs

    def madrob(self, *arguments: object, timeout: float = PATIENCE) -> Done:
        """Run a command of `madrob` to its end."""
        argv = [MADROB, *map(str, arguments)]
        done = subprocess.run(
            argv,
            env=self.environment,
            cwd=self.home,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=timeout,
            check=False,
        )
        return Done(done.returncode, done.stdout.decode(), done.stderr.decode())

    def begin(self, *arguments: object, output: Path | None = None) -> subprocess.Popen[bytes]:
        """Start a command of `madrob` in the background; what it prints goes into a file."""
        with (output or self.home / "output.txt").open("wb") as file:
            program = subprocess.Popen(
                [MADROB, *map(str, arguments)],
                env=self.environment,
                cwd=self.home,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._programs.append(program)
        return program

    def console(
        self,
        command: str = "console",
        *,
        rehearsal: bool = False,
        testbed: str = "simulated",
        scenario: str = "nominal",
        speed: float = 8.0,
        columns: int = 120,
        lines: int = 40,
    ) -> Console:
        """Open the referee's screens, as a person at a terminal does.

        Args:
            command: `console` for a referee, `watch` for a spectator.
            rehearsal: whether it is that of the rehearsal; otherwise a simulated run is practice.
            testbed: `simulated`, or `ros` for what is heard over ROS.
            scenario: what the simulated robot does.
            speed: of the simulation; 1 is real time.
            columns: width of the terminal.
            lines: height of the terminal.
        """
        argv = [MADROB, command, "--testbed", testbed]
        if testbed == "simulated":
            argv += ["--scenario", scenario, "--speed", str(speed)]
        if rehearsal:
            argv.append("--rehearsal")
        return self.console_of(argv, columns, lines)

    def over_ssh(self, speed: float) -> list[str]:
        """The command that opens the referee's screens at the other end of a connection."""
        own = [f"{k}={v}" for k, v in self.environment.items() if k.startswith(_SENT_OVER_SSH)]
        return ["env", *own, MADROB, "console", "--testbed", "simulated", "--speed", str(speed)]

    def console_of(self, argv: Sequence[str], columns: int = 120, lines: int = 40) -> Console:
        """Open the referee's screens with a command line of your own."""
        console = Console(argv, self.environment, columns, lines)
        self._terminals.append(console)
        return console

    def standings(self) -> str:
        """What `madrob standings` prints of the rehearsal, with one blank between its words."""
        return " ".join(self.madrob("standings", "--rehearsal").output.split())

    def check(self) -> Done:
        """Compare all stored results with what their recordings give."""
        return self.madrob("score", "--check", *self._results_folders())

    # --- the simulated testbed over ROS, and a hand that touches its handle

    def open_testbed(self) -> None:
        """Publish a simulated testbed over ROS, and have a hand ready at its handle."""
        self.begin("testbed", "--repeat", "0")
        self._hand = subprocess.Popen(
            [sys.executable, "-c", _HAND], env=self.environment, stdin=subprocess.PIPE
        )
        self._programs.append(self._hand)

    def touch_handle(self) -> None:
        """Touch the handle once."""
        assert self._hand is not None
        assert self._hand.stdin is not None
        self._hand.stdin.write(b"touch\n")
        self._hand.stdin.flush()

    # --- processes

    def engines(self) -> list[int]:
        """The processes of the engines of this hall."""
        words = self.madrob("engine", "status").output.replace(",", " ").split()
        return [int(pid) for word, pid in pairwise(words) if word == "pid"]

    def kill_engine(self) -> None:
        """End the engine as kill -9 does."""
        (pid,) = wait_until(self.engines, "an engine")
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: pid not in self.pids(), "the end of the engine")

    def scorers(self) -> list[int]:
        """The processes that the engine has started to score runs."""
        (engine,) = self.engines()
        stats = {pid: Path(f"/proc/{pid}/stat").read_text() for pid in self.pids()}
        parents = {pid: stat.rpartition(")")[2].split()[1] for pid, stat in stats.items()}
        return [pid for pid, parent in parents.items() if parent == str(engine)]

    def stop_scorers(self) -> None:
        """Let the scoring processes stand still."""
        for pid in wait_until(self.scorers, "a scoring process"):
            os.kill(pid, signal.SIGSTOP)

    def kill_scorers(self) -> None:
        for pid in self.scorers():
            os.kill(pid, signal.SIGKILL)

    def recover(self) -> Done:
        """Repair all recordings that were cut off."""
        return self.madrob("recover", *self._results_folders())

    def pids(self) -> dict[int, str]:
        """The command lines of all processes that were started here, also by others."""
        mark = f"XDG_STATE_HOME={self.state}\0".encode()
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if mark in (folder / "environ").read_bytes():
                    words = (folder / "cmdline").read_text(errors="replace").replace("\0", " ")
                    found[int(folder.name)] = words
        return found

    def _kill_all(self) -> bool:
        left = self.pids()
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for program in self._programs:
            program.poll()
        return not left

    # --- runs and their files

    def _results_folders(self) -> list[Path]:
        rehearsal = self.results.with_name(f"{self.results.name}_rehearsal")
        return [folder for folder in (self.results, rehearsal) if folder.exists()]

    def runs(self) -> list[Run]:
        """All runs, also practice and those of the rehearsal, in the order of their names."""
        results = self._results_folders()
        places = [place for folder in results for place in (folder, folder / "practice")]
        runs = [Run(folder) for place in places for folder in place.glob("subject_*")]
        begun = [run for run in runs if run.countdowns()]  # others were withdrawn at their start
        return sorted(begun, key=lambda run: run.folder.name)

    def run(self) -> Run:
        """The only run there is, once it is there."""
        (run,) = wait_until(self.runs, "a run")
        return run

    def zips(self) -> list[Path]:
        """What was packed for teams."""
        return [path for folder in self._results_folders() for path in folder.glob("exports/*.zip")]


@dataclass(frozen=True)
class Run:
    """A folder with one run."""

    folder: Path

    @property
    def bag(self) -> Path:
        """The recording."""
        return self.folder / f"{self.folder.name}_0.mcap"

    def has_result(self) -> bool:
        return (self.folder / "result.json").exists()

    def result(self, after: str = "", timeout: float = PATIENCE) -> dict[str, Any]:
        """The result on the disk, once it is there and later than the last act of this name."""
        wait_until(lambda: self._has_result_after(after), f"result.json in {self.folder}", timeout)
        content: dict[str, Any] = json.loads((self.folder / "result.json").read_bytes())
        return content

    def _has_result_after(self, act: str) -> bool:
        acts = self.acts()
        return "result written" in acts[_last(acts, act) :] and self.has_result()

    def outcome(self) -> str:
        return str(self.result()["outcome"])

    def level(self, after: str = "") -> int:
        """The capability level in the result that is later than the last act of this name."""
        return int(self.result(after)["indicators"]["capability_level"]["value"])

    def is_signed(self) -> bool:
        """Whether the result becomes final."""
        return self.result(after=SIGNED)["closure"] is not None

    def journal(self) -> list[dict[str, Any]]:
        """What was done and what happened, in order; a line that is being written is left out."""
        file = self.folder / "journal.jsonl"
        lines = file.read_bytes().split(b"\n")[:-1] if file.exists() else []
        return [json.loads(line) for line in lines]

    def acts(self) -> list[str]:
        """The names of what was done and what happened, in order."""
        return [line["what"] for line in self.journal()]

    def countdowns(self) -> int:
        """How often the countdown has begun."""
        return self.acts().count("countdown begins")

    def has_begun(self) -> bool:
        """Whether the clock of the run has started."""
        return "run starts" in self.acts()

    def events(self) -> list[str]:
        """What the sensors have seen since the start, in order."""
        return [line["details"]["event"] for line in self.journal() if line["what"] == "event"]

    def wait_for_event(self) -> None:
        """Wait until the sensors have seen something."""
        wait_until(self.events, "an event")


def _last(acts: list[str], act: str) -> int:
    """Where the last act of this name stands; a name that is not there yet is at the end."""
    if not act:
        return 0
    return len(acts) - acts[::-1].index(act) - 1 if act in acts else len(acts)


class Console(Terminal):
    """The screens of a referee in a terminal, and what a referee does there."""

    def do(self, keys: str, *words: str) -> None:
        """Press a key until these words stand on the screen."""
        self._repeat(lambda: self.press(keys), lambda: self.shows(*words), f"{keys}: {words}")

    def type_words(self, text: str, *words: str) -> None:
        """Type into the field that waits, then Enter until these words stand on the screen."""
        self._repeat(lambda: self.send(text), lambda: self._has_line(text), text)
        self.do("Enter", *words)

    def _has_line(self, text: str) -> bool:
        """Whether a line has this text alone, perhaps within a frame."""
        return any(line.strip("│ ") == text for line in self.lines())

    def click_on(self, label: str, *words: str) -> None:
        """Click on a label until these words stand on the screen."""
        self._repeat(lambda: self.click(label), lambda: self.shows(*words), f"{label}: {words}")

    def _repeat(self, act: Callable[[], None], is_done: Callable[[], bool], what: str) -> None:
        """Act until it is done.

        What comes before a person could have read what is new is left out. The screen says so,
        and a person does it again.
        """
        for _ in range(10):
            said = self._left_out()
            late = time.monotonic() + _FORGOTTEN

            def is_answered(said: set[str] = said, late: float = late) -> bool:
                new = self._left_out() - said
                return is_done() or bool(new) or bool(said and time.monotonic() > late)

            act()
            self.wait_until(is_answered, what)
            if is_done():
                return
            time.sleep(_READING)
        raise AssertionError("\n".join([f"{what} was left out again and again", *self.lines()]))

    def _left_out(self) -> set[str]:
        """The lines that say that a key was not taken."""
        return {line for line in self.lines() for words in _LEFT_OUT if words in line}

    # --- before a run

    def set_up(self) -> None:
        """Set up the run that the form proposes."""
        self.wait_for("F7 zeroes the handle", "checks fail")
        self.do("Enter", "is set up")

    def zero(self) -> None:
        self.do("F7", "handle zeroed")

    def confirm_pose(self) -> None:
        self.do("F6", "all passed or waived")

    def set_up_again(self) -> None:
        """Set up another run after a start that was refused."""
        self.do("Enter", "Run 2 of subject 1 is set up")
        self.confirm_pose()

    def start(self) -> None:
        """Start, and wait until the recording is open.

        A busy machine may need more than the 2 s that a start has for the disk. The run gets
        another number then, and the referee confirms the pose again.
        """
        self.press("F5")
        if self.wait_for_one(["REC"], ["Refused: start"]) == 1:
            self.confirm_pose()
            self.do("F5", "REC")

    def make_ready(self) -> None:
        """From the first screen to all that a start needs."""
        self.set_up()
        self.zero()
        self.confirm_pose()

    def start_in_vain(self) -> None:
        """Start while the disk does not answer, until the start is refused."""
        self.press("F5")
        self.wait_for("Refused: start")

    def open_run(self) -> None:
        """From the first screen to a run that goes on."""
        self.make_ready()
        self.start()

    def complete_run(self) -> None:
        """From the first screen to the result of a run whose robot did all it had to."""
        self.open_run()
        self.wait_for("COMPLETED", "not final")

    # --- in a run

    def wait_for_run(self) -> None:
        """Wait until a run goes on."""
        self.wait_for("RUNNING")

    def wait_for_stop(self, outcome: str = "COMPLETED") -> None:
        """Wait until the run has stopped in this way."""
        self.wait_for(outcome)

    def abort(self) -> None:
        """Abort from wherever the referee is: F8, then y."""
        self.press("F8")
        self.wait_for("ABORT now")
        self.press("y")
        self.wait_until(lambda: not self.shows("ABORT now"), "an abort")

    def question_by_mouse(self) -> None:
        """Open a question with the mouse, and choose an answer that waits for words."""
        self.click_on("Incident", "collision")
        self.click_on("other", "What happened?")

    def restart_countdown(self) -> None:
        self.do("r", "starts in")

    def accept_false_start(self) -> None:
        self.do("a", "Why")
        self.do("Space", "starts in")

    # --- after a run

    def open_menu(self, key: str, *words: str) -> None:
        """Choose a line from the menu of the run."""
        self.do("Enter", "What do you want to do")
        self.do(key, *words)

    def deny_step(self, step: int) -> None:
        self.do(str(step), f"Step {step}: ")
        self.do("d", f"step {step} denied")

    def confirm_step(self, step: int) -> None:
        self.do(str(step), f"Step {step}: ")
        self.do("c", f"step {step} confirmed")

    def take_back(self) -> None:
        """Take the last decision back."""
        self.do("z", "Take back the last decision")
        self.do("Space", "taken back")

    def correct_team(self, subject: int) -> None:
        """The run was that of another team."""
        self.open_menu("c", "Correct what was set up")
        self.do("s", "Correct the subject")
        self.type_words(str(subject), "Why?")
        self.do("1", "corrected")

    def protest(self, step: int, words: str) -> None:
        """File a protest of the team of this run about a step."""
        self.open_menu("P", "What is it about?")
        self.do(str(step), "Who protests?")
        self.do("1", "What does the team say?")
        self.type_words(words, "waits for a decision")

    def uphold_protest(self, words: str) -> None:
        """Decide the open protest for the team, in words."""
        self.open_menu("P", "What becomes of it?")
        self.do("d", "How is it decided?")
        self.do("u", "In words, for the team")
        self.type_words(words, f"upheld ({words})")

    def try_to_sign(self, refusal: str) -> None:
        """Look for the signature in the menu, which says why there is none."""
        self.do("Enter", "Not now: f", refusal)
        self.press("Escape")
        self.wait_until(lambda: not self.shows(refusal), "the end of the menu")

    def sign(self) -> None:
        """Sign the result. The team acknowledges it."""
        self.open_menu("f", "Sign the result")
        if self.wait_for_one(["Sign it all the same?"], ["What does the team say?"]) == 0:
            self.do("y", "What does the team say?")
        self.do("a", "Note")
        self.do("Enter", "signed by")

    # --- after a failure

    def wait_for_full_disk(self) -> None:
        """Wait until the recorder says that the disk is full."""
        self.wait_for("No space left")

    def wait_for_unwritten_result(self) -> None:
        """Wait until the screen says that the result is not on the disk yet."""
        self.wait_for("NOT ON DISK")

    def start_engine_again(self) -> None:
        self.do("Ctrl+R", "WAS CUT OFF")

    def score_as_interrupted(self) -> None:
        """Answer the question that opens by itself about a run that was cut off."""
        self.do("s", "INTERRUPTED")

    # --- lists, files, the end

    def open_history(self, *words: str) -> None:
        """Look at the list of all runs until it has these words."""
        self.press("Escape")  # no letter goes into a field
        self.do("h", *words)

    def open_standings(self, *words: str) -> None:
        """Look at the standings until they have these words."""
        self.do("s", *words)

    def open_result(self) -> None:
        self.do("F4", "version")

    def open_replay(self) -> None:
        """Show the recording of this run in place of the testbed."""
        self.open_menu("R", "REPLAY")

    def export_zip(self) -> None:
        """Pack all runs of the team of this run."""
        self.open_menu("e", "Packed")

    def leave(self) -> int:
        """Leave while no run goes on; the exit code."""
        self.press("F10")
        return self.wait_exit()


# --- commands, ROS and files: what stories do without screens

RUN_MADROB = str(Path(sys.executable).with_name("run_madrob"))
SIMULATED = ("--testbed", "simulated", "--speed", "0")
_LAB_TOPICS = """
[[topics]]
signal = "door angle"
topic = "/lab/joints"
type = "sensor_msgs/msg/JointState"
field = "position[name=door]"
unit = "deg"

[[topics]]
signal = "handle force"
topic = "/lab/load_cell"
type = "geometry_msgs/msg/WrenchStamped"
field = "wrench.force.z"
unit = "gf"
"""
_LAB_STRIP = """
[[topics]]
signal = "passage {side} {end}"
topic = "/lab/ranges/{side}_{end}"
type = "sensor_msgs/msg/LaserScan"
field = "ranges"
unit = "mm"
"""


def call(hall: Hall, *arguments: object) -> Done:
    """Run a command of `madrob` to its end, also beside others that take the processor."""
    return hall.madrob(*arguments, timeout=60.0)


def check(hall: Hall) -> Done:
    """Compare all stored results with what their recordings give."""
    return call(hall, "score", "--check", *hall._results_folders())


def recover(hall: Hall) -> Done:
    """Repair all recordings that were cut off."""
    return call(hall, "recover", *hall._results_folders())


def simulate(
    hall: Hall,
    scenario: str = "nominal",
    *more: object,
    subject: int = 1,
    rehearsal: bool = True,
    timeout: float = 60.0,
) -> Done:
    """Make a run without screens on the simulated testbed, as fast as possible.

    Args:
        hall: where.
        scenario: what the robot does.
        more: further options.
        subject: the number of the team.
        rehearsal: whether it counts in the rehearsal; otherwise it is practice.
        timeout: of the run, s.
    """
    day = ["--rehearsal"] if rehearsal else []
    robot = ["--scenario", scenario, "--timeout", timeout, "--subject", subject]
    return call(hall, "run", *SIMULATED, *day, *robot, *more)


def make_run(
    hall: Hall,
    scenario: str = "nominal",
    *more: object,
    subject: int = 1,
    rehearsal: bool = True,
    timeout: float = 60.0,
) -> Run:
    """As `simulate`, and return the run that it names in its last line."""
    done = simulate(hall, scenario, *more, subject=subject, rehearsal=rehearsal, timeout=timeout)
    assert "run folder: " in done.output, done.errors
    return Run(Path(done.output.rpartition("run folder: ")[2].strip()))


def begin_run(hall: Hall) -> subprocess.Popen[bytes]:
    """Begin a run without screens on the simulated testbed, in real time."""
    return hall.begin("run", "--testbed", "simulated")


def begin_run_over_ros(hall: Hall, *more: object) -> subprocess.Popen[bytes]:
    """Begin a run without screens on the testbed that is heard over ROS."""
    return hall.begin("run", "--testbed", "ros", *more)


def interrupt(program: subprocess.Popen[bytes]) -> int:
    """Press Ctrl+C, and return the exit code."""
    program.send_signal(signal.SIGINT)
    return program.wait(60.0)


def publish(hall: Hall, *speeches: str) -> subprocess.Popen[bytes]:
    """Publish over ROS what `publisher.py` calls so, until it is killed or the hall ends."""
    root = Path(__file__).parents[2]
    program = subprocess.Popen(
        [sys.executable, "-m", "tests.stories.publisher", *speeches],
        env=hall.environment,
        cwd=root,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    hall._programs.append(program)
    return program


def expect_lab(hall: Hall) -> None:
    """Set topics and units of the laboratory: degrees, grams, mm, one joint by its name."""
    ends = [(side, end) for side in ("cw", "ccw") for end in ("left", "right")]
    hall.set(_LAB_TOPICS + "".join(_LAB_STRIP.format(side=s, end=e) for s, e in ends))


def expect_cameras(hall: Hall) -> None:
    """Record all cameras beside the runs."""
    cameras = [f"/camera/{name}/image/compressed" for name in ("front", "evil")]
    hall.set(evidence={"topics": cameras})


def kill_camera_recorder(hall: Hall) -> None:
    """End the process that records cameras, as kill -9 does."""

    def find() -> list[int]:
        return [pid for pid, words in hall.pids().items() if "evidence_worker" in words]

    for pid in wait_until(find, "a recorder of cameras"):
        os.kill(pid, signal.SIGKILL)


def value_of(run: Run, indicator: str) -> float:
    """Return a stored value with all its digits."""
    return float(run.result()["indicators"][indicator]["value"])


def place_of(hall: Hall, run: Run) -> str:
    """Return where a run lies: among the official runs, in practice or in the rehearsal."""
    rehearsal = hall.results.with_name(f"{hall.results.name}_rehearsal")
    places = {hall.results: "official", hall.results / "practice": "practice"}
    return (places | {rehearsal: "rehearsal"})[run.folder.parent]


def values_of(run: Run) -> dict[str, float | None]:
    """Return all stored values; None for a missing one."""
    return {name: one["value"] for name, one in run.result()["indicators"].items()}


def replay(hall: Hall, run: Run) -> Console:
    """Show a recorded run on the screens of a referee, as fast as possible."""
    return hall.console_of(
        [MADROB, "console", "--testbed", "replay", str(run.folder), "--speed", "0"]
    )


REPLAYED_ALIKE = "equals the stored result to the last digit"
"""What the screen says at the end of a replay."""


REISSUED = "re-issued after a rule change"
"""What the journal calls it."""


def reissue(hall: Hall, run: Run, reason: str, rules: str) -> Done:
    """Score a run by other rules from now on."""
    return call(hall, "score", "--reissue", reason, "--ruleset", rules, run.folder)


def earlier_issue(run: Run, number: int) -> bytes:
    """Return a result that was replaced, as it is on the disk."""
    return (run.folder / f"result_issue_{number}.json").read_bytes()


def result_bytes(run: Run) -> bytes:
    return (run.folder / "result.json").read_bytes()


def edit_result(run: Run) -> None:
    """Make the stored time to the handle a little better."""
    document = run.result()
    document["indicators"]["time_to_handle"]["value"] -= 0.5
    (run.folder / "result.json").write_text(json.dumps(document), encoding="utf-8")


def edit_journal(run: Run) -> None:
    """Let the journal say that the run had stopped earlier."""
    file = run.folder / "journal.jsonl"
    lines = run.journal()
    (stop,) = [line for line in lines if line["what"] == "run stops"]
    stop["details"]["time"] -= 3.0
    file.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")


def edit_recording(run: Run) -> None:
    """Turn a byte in the middle of the recording."""
    content = bytearray(run.bag.read_bytes())
    content[len(content) // 2] ^= 0xFF
    run.bag.write_bytes(content)


def copy_journal(run: Run, folder: Path) -> None:
    """Put the journal of a run beside a recording of it that another tool has written."""
    shutil.copy(run.folder / "journal.jsonl", folder)


def write_plan(hall: Hall, lines: Sequence[str]) -> None:
    """Write a plan, lines of subject, condition and attempts, and name it in the settings."""
    plan = hall.home / "plan.csv"
    plan.write_text("\n".join(["subject,condition,attempts", *lines, ""]), encoding="utf-8")
    hall.set(plan={"file": str(plan)})


def plan(hall: Hall) -> dict[str, Any]:
    """Return what `madrob plan` says of the rehearsal."""
    content: dict[str, Any] = json.loads(call(hall, "plan", "--rehearsal", "--json").output)
    return content


def standings_values(
    hall: Hall, indicator: str, *, rehearsal: bool = True, practice: bool = False
) -> dict[str, float]:
    """Return the mean of each team in the standings, with all digits."""
    which = ["--rehearsal"] * rehearsal + ["--practice"] * practice
    text = call(hall, "standings", "--csv", *which).output
    rows = [row for row in csv.DictReader(text.splitlines()) if row["indicator"] == indicator]
    return {row["team"]: float(row["mean"]) for row in rows if row["condition"] != "all"}


def site_values(hall: Hall, indicator: str) -> dict[str, float]:
    """Publish the web pages of the rehearsal, and return the values in their tables."""
    done = call(hall, "publish", hall.home / "site", "--rehearsal")
    assert done.code == 0, done.errors
    (table,) = (hall.home / "site_rehearsal").rglob("indicators.csv")
    return _values_in(table.read_text(encoding="utf-8"), indicator)


def zip_values(hall: Hall, subject: int, indicator: str) -> dict[str, float]:
    """Pack the runs of a team for it, and return the values in the tables of the zip."""
    done = call(hall, "export", "--rehearsal", "--subject", subject)
    assert done.code == 0, done.errors
    with zipfile.ZipFile(done.output.strip().splitlines()[-1]) as packed:
        (name,) = [name for name in packed.namelist() if name.endswith("indicators.csv")]
        return _values_in(packed.read(name).decode(), indicator)


def _values_in(table: str, indicator: str) -> dict[str, float]:
    rows = [row for row in csv.DictReader(table.splitlines()) if row["indicator"] == indicator]
    return {row["team"]: float(row["value"]) for row in rows}


def scores_of(hall: Hall, *, jobs: int | None = None, scheduler: str = "") -> str:
    """Score all runs of the rehearsal again, and return all that is said of them.

    Args:
        hall: where.
        jobs: so many processes.
        scheduler: the address of a Dask cluster that does it.
    """
    (results,) = hall._results_folders()
    how = ["--jobs", jobs] if jobs else ["--scheduler", scheduler]
    done = call(hall, "score", "--json", results, *how)
    assert done.code == 0, done.errors
    return done.output


def eurobench_files(run: Run) -> list[Path]:
    """Return events, forces, angles and condition of a run in EUROBENCH's files."""
    patterns = ("*_event.csv", "*_wrench.csv", "*_jointState.csv", "condition_*.yaml")
    return [next(run.folder.glob(pattern)) for pattern in patterns]


def run_madrob(hall: Hall, files: Sequence[Path], output: Path) -> int:
    """Score EUROBENCH's files by the program that its runner calls, and return its exit code."""
    command = [RUN_MADROB, *map(str, files), str(output)]
    return subprocess.run(
        command, env=hall.environment, cwd=hall.home, capture_output=True, check=False, timeout=60.0
    ).returncode


def eurobench_values(folder: Path) -> dict[str, str]:
    """Return the value in each of EUROBENCH's YAML files by its name, as it is written."""
    return {
        file.stem: file.read_text(encoding="utf-8").rpartition("value: ")[2].strip()
        for file in folder.glob("*.yaml")
    }


def title_of(console: Console) -> str:
    """Return the title that the window of a terminal has."""
    return str(console._screen.title)


NO_PATIENCE = ("--wait", "1")
BY_EUROBENCH = ("--ruleset", "eurobench-2020")
Spoil: TypeAlias = Callable[[Sequence[Path]], None]


def remove_first(files: Sequence[Path]) -> None:
    files[0].unlink()


def empty_first(files: Sequence[Path]) -> None:
    files[0].write_bytes(b"")


def address_in(file: Path) -> str:
    """Return the address of a Dask scheduler; nothing while its file is not there yet."""
    with contextlib.suppress(OSError, ValueError):
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    return ""


def watch_lines(hall: Hall) -> Path:
    """Watch beside the console without screens, and return the file with all that is printed."""
    file = hall.home / "lines.txt"
    hall.begin("watch", "--plain", "--testbed", "ros", output=file)
    return file


def faults_of(run: Run) -> int:
    """Return how many testbed faults the journal of a run has."""
    return sum("fault" in line["what"] for line in run.journal())
