from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import LONGEST_NAME, clean_name
from madrob_console.referee.lists import LARGEST_FILE, MOST_PROBLEMS
from madrob_console.referee.team_list import TeamList, TeamSource, merge_teams, read_teams
from tests.madrob_console.ui.prepared import a_setup


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "teams.csv"


def read(file: Path, text: str | bytes) -> TeamList:
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_teams(file)


WALKERS = {3: "Walk-Man", 12: "Team Walker"}
SCRIPTS = {
    1: "門ロボット",
    2: "🤖 Bots 👩‍👩‍👧",
    3: "Bots; Delft, NL",
    4: 'The "A" Team',
    5: "Zürich",
}


@pytest.mark.parametrize(
    "text",
    [
        "3,Walk-Man\n12,Team Walker\n",
        "subject,team\n3,Walk-Man\n12,Team Walker",
        "Subject number ; Team\r\n3;Walk-Man\r\n12;Team Walker\r\n",
        "\ufeff3,Walk-Man\r12,Team Walker\r",
        '\n# ours\n  "3" , "Walk-Man" \n\n  # theirs\n\t012\t,\tTeam   Walker\t\n\n',
        '"subject","team"\n"3","Walk-Man",,\n12,Team Walker,\n',
        "Subject,City,Team name\n3,Genoa,Walk-Man\n12,,Team Walker\n",
    ],
)
def test_every_usual_way_to_write_the_list_is_read(file: Path, text: str) -> None:
    assert read(file, text) == TeamList(WALKERS)


def test_names_of_every_script_and_with_separators_in_quotes_are_kept(file: Path) -> None:
    quoted = (f'{n},"{name.replace(chr(34), chr(34) * 2)}"\n' for n, name in SCRIPTS.items())
    assert read(file, "".join(quoted)) == TeamList(SCRIPTS)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x,Late", "subject 'x' is no number from 1 to 999: write one"),
        ("0,Late", "subject '0' is no number from 1 to 999: write one"),
        ("1000,Late", "subject '1000' is no number from 1 to 999: write one"),
        ("-4,Late", "subject '-4' is no number from 1 to 999: write one"),
        ("4.0,Late", "subject '4.0' is no number from 1 to 999: write one"),
        ("٤,Late", "subject '٤' is no number from 1 to 999: write one"),
        (
            "9" * 5000 + ",Late",
            "subject '99999999999999999...' is no number from 1 to 999: write one",
        ),
        (",Late", "subject '' is no number from 1 to 999: write one"),
        (",", "subject '' is no number from 1 to 999: write one"),
        ("4", "subject 4 has no team: add it"),
        ("4,", "subject 4 has no team: add it"),
        ('4," "', "subject 4 has no team: add it"),
        ("4,\u200d", "subject 4 has no team: add it"),
        ("4;Late", "subject '4;Late' is no number from 1 to 999: write one"),
        ("4,Late,Delft", "3 values, use subject, team; quote one with a separator"),
        ("4," + "x" * 200_000, "field larger than field limit (131072): shorten it"),
        ('4,"Late', 'a quote (") is not closed: close it'),
        ("subject,team", "subject 'subject' is no number from 1 to 999: write one"),
        ("\x004\x00,Late", "subject '4' is no number from 1 to 999: write one"),
    ],
)
def test_a_broken_line_is_named_and_the_others_count(file: Path, text: str, problem: str) -> None:
    teams = read(file, f"subject,team\n3,Walk-Man\n\n{text}\n5,Next\n")
    assert teams.names == {3: "Walk-Man", 5: "Next"}
    assert teams.problems == (f"teams.csv line 4: {problem}",)
    assert teams.unread == 1


@pytest.mark.parametrize(
    ("value", "name", "problem"),
    [
        ("Bo\x00ts\x1b[31m!", "Bots!", "characters that cannot be shown are left out"),
        ("Bo\u202ets", "Bots", "characters that cannot be shown are left out"),
        ("../Bots", "Bots", "/ and \\ become blanks"),
        (".Bots", "Bots", "dots at the beginning are left out"),
        ("x" * 200, "x" * 59 + "…", "more than 60 characters, cut"),
        ("門" * 61, "門" * 59 + "…", "more than 60 characters, cut"),
    ],
)
def test_what_is_taken_from_a_name_is_said(file: Path, value: str, name: str, problem: str) -> None:
    teams = read(file, f"3,{value}\n")
    assert teams.names == {3: name}
    shown = name if len(name) <= 20 else f"{name[:17]}..."
    assert teams.remarks == (f"teams.csv line 1: {problem}: the team is '{shown}'",)


@pytest.mark.parametrize(
    ("text", "names", "problem"),
    [
        (
            "3,Walk-Man\n# later\n3,Runner\n",
            {3: "Walk-Man"},
            "line 3: subject 3 is 'Runner' here, 'Walk-Man' in line 1, which counts: cut one",
        ),
        (
            "3,Walk-Man\n4,WALK-MAN\n",
            {3: "Walk-Man", 4: "WALK-MAN"},
            "line 2: 'WALK-MAN' is subject 4 here and 3 in line 1, both count: correct one",
        ),
        (
            b"3,Walk-Man\n4,Z\xfcrich\n5,Next\n",
            {3: "Walk-Man", 5: "Next"},
            "line 2: not in UTF-8; save the file as CSV in UTF-8",
        ),
    ],
)
def test_what_two_lines_say_differently_is_named(
    file: Path, text: str | bytes, names: dict[int, str], problem: str
) -> None:
    teams = read(file, text)
    assert (teams.names, teams.notes) == (names, (f"teams.csv {problem}",))


def test_many_problems_are_counted(file: Path) -> None:
    problems = read(file, "x\n" * 1000).problems
    assert len(problems) == MOST_PROBLEMS + 1
    assert problems[-1] == f"and {1000 - MOST_PROBLEMS} more such lines"


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"\xff\xfe3\x00,\x00", "no text; save it as CSV in UTF-8"),
        (bytes(range(256)) * 10, "no text; save it as CSV in UTF-8"),
        (b"1,a\n" * (LARGEST_FILE // 4 + 1), "over 1 MB, no list"),
    ],
)
def test_what_is_no_list_is_refused(file: Path, data: bytes, problem: str) -> None:
    with pytest.raises(MadrobError, match="teams file ") as caught:
        read(file, data)
    assert str(caught.value) == f"teams file {file}: {problem}; correct teams_file of [competition]"


def test_a_huge_file_is_not_taken_into_memory(file: Path) -> None:
    with file.open("wb") as sparse:
        sparse.truncate(2 * 10**9)
    with pytest.raises(MadrobError, match="over 1 MB"):
        read_teams(file)


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, problem in (
        (tmp_path / "none.csv", "No such file or directory"),
        (tmp_path, "Is a directory"),
        (tmp_path / "pipe", "no file"),
        (tmp_path / "a\0b", "embedded null byte"),
    ):
        with pytest.raises(MadrobError, match=f"cannot be read \\({problem}\\); correct teams_"):
            read_teams(path)


@given(
    st.binary(max_size=80)
    | st.text(alphabet='0123,;"# \n\rx門\x00\x1b', max_size=80).map(str.encode)
    | st.text(max_size=80).map(lambda text: text.encode(errors="replace"))
)
def test_no_content_is_too_strange(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    try:
        teams = read(tmp_path_factory.getbasetemp() / "any.csv", data)
    except MadrobError as error:
        assert "no text" in str(error)  # noqa: PT017  either is right, a traceback is not
        return
    for subject, name in teams.names.items():
        assert 1 <= subject <= 999
        assert 0 < len(name) <= LONGEST_NAME
        assert name == clean_name(name, "team")
    assert all("\n" not in problem and problem.isprintable() for problem in teams.problems)


def test_the_settings_win_over_the_file_and_the_difference_is_said() -> None:
    file = TeamList({3: "Walk-Man", 4: "Runner"}, ("teams.csv line 9: subject 9 has no team",))
    merged = merge_teams({3: "Walker", 4: "Runner", 5: "Own"}, file)
    assert merged.names == {3: "Walker", 4: "Runner", 5: "Own"}
    assert merged.notes == (
        "teams.csv line 9: subject 9 has no team",
        "subject 3 is 'Walker' in the settings and 'Walk-Man' in the file: the settings count",
    )


SETTINGS = {9: "Own"}
"""The teams of the settings."""


NO_REASON = "subject 3 is 'Delft Walkers' in the list of teams: another name needs a reason"
NOT_IN_IT = "subject 4 is not in the list of teams: a name needs a reason"


@pytest.mark.parametrize(
    ("subject", "team", "reason", "problem"),
    [
        (3, "Delft Walkers", "", None),
        (3, "delft walkers", "", NO_REASON),
        (3, "", "", NO_REASON),
        (3, "Delft", "renamed", None),
        (3, "Delft", "  ", NO_REASON),
        (4, "Late", "", NOT_IN_IT),
        (4, "", "", None),
    ],
)
def test_another_name_than_the_list_has_needs_a_reason(
    subject: int, team: str, reason: str, problem: str | None
) -> None:
    setup = replace(a_setup(), subject=subject, team=team, team_reason=reason)
    assert TeamList({3: "Delft Walkers"}).problem(setup) == problem
    assert TeamList().problem(setup) is None
    assert not TeamList().differs(subject, team)


def test_the_file_and_the_settings_are_one_list(file: Path) -> None:
    (missing,) = TeamSource(SETTINGS, file).read().problems
    assert missing.endswith("No such file or directory); correct teams_file of [competition]")
    file.write_text("3,Walk-Man\n")
    listed = TeamSource(SETTINGS, file).read()
    assert listed == TeamList({3: "Walk-Man", 9: "Own"}, (), str(file))
    assert TeamSource(SETTINGS).read() == TeamList(SETTINGS)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (None, "cannot be read (No such file or directory); correct --teams"),
        (b"", "it names no team"),
        (b"subject,team\n", "it names no team"),
        (b"\xff\xfe3\x00,\x00", "no text; save it as CSV in UTF-8; correct --teams"),
    ],
)
def test_a_file_that_cannot_be_read_any_more_leaves_the_list_as_it_was(
    file: Path, data: bytes | None, problem: str
) -> None:
    source = TeamSource(SETTINGS, file, "correct --teams")
    file.write_text("3,Walk-Man\n")
    before = source.read()
    if data is None:
        file.unlink()
    else:
        file.write_bytes(data)
    listed = source.read(before)
    assert listed.names == before.names
    assert listed.problems == (f"teams file {file}: {problem}; the list stays as it was",)
    assert source.read(listed) == listed
    file.write_text("3,Walkers\n")
    assert source.read(listed) == TeamList({3: "Walkers", 9: "Own"}, (), str(file))


def test_a_line_that_cannot_be_read_any_more_costs_no_team_its_name(file: Path) -> None:
    source = TeamSource({}, file)
    file.write_text("3,Walk-Man\n4,Runner\n5,Next\n")
    before = source.read()
    file.write_text("3,Walkers\n4;Runner\n")
    listed = source.read(before)
    assert listed.names == {3: "Walkers", 4: "Runner", 5: "Next"}
    assert "line 2: subject '4;Runner' is no number" in listed.problems[0]
    file.write_text("3,Walkers\n4,Runner\n")
    assert source.read(listed).names == {3: "Walkers", 4: "Runner"}
