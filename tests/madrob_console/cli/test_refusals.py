"""What cannot be done is one line on the error output that says why; nothing else happens."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from madrob_console.testbeds.simulated import Scenario
from recorder.writer import BagWriter
from scoring.indicator_table import RulesetName
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import completed, publish, recorded
from tests.madrob_console.run_folders import summary, write
from tests.recorder.samples import all_within, door_messages, door_topics

WORDS = [
    ("consol", "madrob: COMMAND: there is no 'consol', use console, watch"),
    ("calibrate mask", "there is no 'mask', use masks or handle"),
    ("engine stat", "there is no 'stat', use status, stop or serve"),
    ("console --theme blue", "--theme: there is no 'blue', use dark, light or high-contrast"),
    ("run --opening-side left", "--opening-side: there is no 'left', use cw or ccw"),
    ("run --scenario nominall", "--scenario: there is no 'nominall', use nominal, slam"),
    ("run --subject Delft", "--subject: 'Delft' is no whole number"),
    ("run --timeout long", "--timeout: 'long' is no number"),
    ("standings --bets 3", "madrob: unrecognized arguments: --bets"),
    ("export --subject 3 --bag", "madrob: unrecognized arguments: --bag"),
    ("settings all", "madrob: unrecognized arguments: all"),
    ("watch --plain --big", "--big: not allowed with argument --plain"),
    ("console --testbed sim", "--testbed: there is no 'sim', use ros, simulated or replay"),
    ("console --testbed ros 3", "--testbed: ros takes nothing more, not '3'"),
    ("watch --testbed replay", "--testbed: replay needs the path of one bag"),
    ("run --speed -1", "--speed: -1: use 0 to 1000"),
    ("run --speed nan", "--speed: nan: use 0 to 1000"),
    ("run --wait -3", "--wait: -3: use 0 or more"),
    ("run --timeout 0.5", "--timeout: 0.5: use 1 to 86400"),
    ("run --countdown inf", "--countdown: 'inf' is no number"),
    ("run --subject 1000", "--subject: 1000: use 1 to 999"),
    ("run --start-pose here", "--start-pose"),
    ("run --start-pose 1.5,0,nan", "--start-pose"),
    ("standings --best -1", "--best: -1: use 0 or more"),
    ("score --jobs 0 x", "--jobs: 0: use 1 or more"),
    ("score --jobs many x", "--jobs: "),
    ("score --ruleset best x", f"use {', '.join(RulesetName)} or all"),
    ("score x --write y --check", "--check"),
    ("score x --reissue y --json", "--json: not allowed with --reissue"),
    ("score --json", "the following arguments are required: PATH"),
    ("score one --bets 3 two", "madrob: unrecognized arguments: --bets 3 two"),
    ("publish --best 3", "the following arguments are required: FOLDER"),
    ("recover", "the following arguments are required: PATH"),
]


@pytest.mark.parametrize(("line", "words"), WORDS)
def test_a_wrong_word_is_named_in_one_line(line: str, words: str, madrob: Madrob) -> None:
    said = madrob.refusal(line)
    assert words in said
    assert said.endswith("--help`\n")


SCREENS = [
    ("console --testbed replay /nowhere/at_all", "/nowhere/at_all"),
    ("console --testbed replay empty", "the folder holds no recording"),
    ("console --testbed replay foreign", "a bag without a MADROB run: score and replay need one"),
    ("console --testbed replay run --at 900", "--at 900: the recording goes from -"),
    ("console --testbed replay run --at lunch", "--at: 'lunch' is no time and no event"),
    ("console --testbed simulated --at stop", "--at: give it with `--testbed replay PATH`"),
    ("console --testbed simulated --teams none.csv", "correct --teams"),
    ("console --testbed simulated --plan none.csv", "correct --plan"),
    ("console --settings none.toml", "no such settings file"),
    ("watch --testbed ros --speed 5", "--speed: a live testbed has its own"),
    ("watch --testbed replay run", "no engine runs here to be watched"),
    ("watch --testbed simulated", "no engine runs here to be watched"),
]
"""Nothing is painted before the command line is known to be good."""
RUN = "run --testbed simulated --speed 0 --countdown 1 --results new"
LINES = [
    ("watch --plain --testbed simulated", "no engine runs here to be watched"),
    ("watch --json --testbed simulated", "no engine runs here to be watched"),
    (f"{RUN} --start-pose -1,0,0 --results results", "CCW side"),
    (f"{RUN} --plan none.csv", "correct --plan"),
    (f"{RUN} --results results --team-name {'x' * 200}", "--team-name"),
    (f"{RUN} --results file", "file"),
    (f"{RUN} --settings wrong.toml", "timeuot"),
    (f"{RUN} --settings foreign.toml", "no_msgs"),
    ("run --testbed replay run", "`madrob score --check RUN` compares its result"),
    ("settings --settings none.toml", "none.toml"),
    ("score empty", "empty is no bag"),
    ("score alone", "alone is no bag"),
    ("score none", "none"),
    ("score run --dry-run", "--dry-run: only with --reissue"),
    ("score run --check --ruleset protocol", "--ruleset: not allowed with --check"),
    ("score run --scheduler tcp://a:1 --jobs 2", "--jobs: not allowed with --scheduler"),
    ("score run --reissue ' '", "--reissue: give a reason"),
    ("score run --reissue x --ruleset all", "--reissue: with one ruleset, not all"),
    ("score run --write new --ruleset all", "--write: with one ruleset, not all"),
    ("score published --write new", "without a recording"),
    ("score run --write file", "file"),
    ("standings --results none", "none: no such results folder; name one with --results"),
    ("standings --json none", "none"),
    ("standings results --output s.csv", "--output: say what goes there with --csv, --json or"),
    ("standings results --csv --output /nowhere/s.csv", "/nowhere/s.csv: not written"),
    (
        "standings results --competition '\x1b[31mX'",
        "--competition 'X': no such runs; there are 'Autumn Cup'",
    ),
    ("plan --settings empty.toml", "no plan: name a file in [plan] of the settings, or with"),
    ("plan --plan none.csv", "cannot be read (No such file or directory); correct --plan"),
    ("plan --plan plan.csv --json plan.json", "plan.json: no such folder; name a folder with runs"),
    ("table runs results --testbed-name 'Hall B'", "no such runs; there are 'Hall A'"),
    ("table runs none --output file", "no such folder"),
    ("table samples run", "--output"),
    ("table samples run --output file", "file: "),
    ("recover empty", "choose a rosbag2 bag folder or an .mcap file"),
    ("calibrate masks none", "No such file"),
    ("calibrate masks '\x1b[31mred'", "is no bag"),
]


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the lines name; none of them changes it."""
    here = tmp_path_factory.mktemp("things")
    for name in ("empty", "alone"):
        (here / name).mkdir()
    for name, text in {
        "file": "",
        "junk.mcap": "not a bag at all",
        "\x1b[31mred": "text",
        "plan.csv": "3,1,2\n",
        "empty.toml": "",
        "wrong.toml": "[run]\ntimeuot = 3.0\n",
        "foreign.toml": "[[topics]]\nsignal = 'door angle'\ntype = 'no_msgs/msg/A'\nfield = 'x'\n",
    }.items():
        (here / name).write_text(text)
    shutil.copytree(completed(), here / "renamed" / "the final")
    (here / "run").symlink_to(completed())
    shutil.copy(completed() / "journal.jsonl", here / "alone")
    publish(recorded(Scenario.TOUCH_ONLY), here / "published")
    write(here / "results", summary(testbed="Hall A"))
    with BagWriter(here / "foreign", door_topics(), {}) as writer:
        writer.put_message(door_messages(rounds=1)[0])
    return here


@pytest.mark.parametrize(("line", "words"), [*SCREENS, *LINES])
def test_what_cannot_be_done_is_one_line_and_nothing_is_painted_or_written(
    line: str, words: str, things: Path, madrob: Madrob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(things)
    monkeypatch.setattr("madrob_console.ui.terminal.check_terminal", lambda *_: None)
    monkeypatch.setattr("madrob_console.ui.terminal.run_console", main)  # which takes no client
    before = all_within(things, "[!.]*")
    said = madrob.refusal(line)
    assert words in said
    assert "\x1b" not in said
    assert all_within(things, "[!.]*") == before
