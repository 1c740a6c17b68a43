"""Forty recorded runs score to the numbers that are stored beside them.

`runs.tar.xz` holds the runs, `numbers.json` what they score to. `doubts.json` holds what is said in
words and how far the values can be trusted: reasons, uncertainties and doubts of the own runs.
`python -m tests.corpus` writes both JSON files anew.

The own runs are as the console leaves them: bag, journal, result and EUROBENCH's files. Three are
bags alone. The bags of `nominal` and of the killed runs are compressed, the others are not, so that
the archive is small. The simulated sensors read in coarse steps for the same reason.

| own run | what it is |
| --- | --- |
| `aborted` | the referee aborted it after 6 s |
| `corrected_team_and_sides` | team, starting side and benchmark type were corrected afterwards |
| `cup_rehearsal` | a run of a rehearsal on the simulated testbed, signed |
| `false_start_accepted` | the handle was touched in the countdown, the referee accepted it |
| `gaps_and_doubts` | the door is silent for 0.3 s, a strip says NaN, the handle slows to 5 Hz |
| `joints_by_name_deg_mm_kgf` | one joint among others in degrees, ranges in mm, force in -kgf |
| `killed_then_scored` | `madrob run` killed by SIGKILL, then scored as interrupted and signed |
| `killed_undecided` | `madrob run` killed by SIGKILL, nobody has decided: there is no result |
| `nominal` | pulled open to CCW, compressed, signed |
| `original_door` | messages of the original door: angle, force in grams, ranges in mm |
| `practice_without_touch` | practice, nobody touches the handle, timeout |
| `protest_decided` | protested, step 4 denied, protest upheld, step 4 confirmed, three issues |
| `pulled_to_cw` | Sudden Force, opens CW, starts CW, the team was absent |
| `pushed_to_ccw_against_wind` | Wind Ramp, opens CCW, starts CW |
| `pushed_to_cw_latch_decides` | Constant Force, opens CW, starts CCW, a latch decides step 6 |
| `reference_both_sides_at_stop` | shipped reference: a robot on both sides at the timeout |
| `reference_force_pulses` | shipped reference: half sines of force, a handle that rests at 4 N |
| `reference_minimum_jerk_encoder` | shipped reference: minimum jerk, read by an encoder |
| `reissued_by_other_rules` | re-issued by the rules of `eurobench-2020` |
| `slam` | Sudden Ramp, the door is slammed |
| `slow_until_timeout` | a slow robot, timeout while it opens |
| `stamps_step_back` | stamps of the handle step back by 0.3 s, one stamp of the door is old |
| `steps_denied` | steps 2 and 4 denied, step 6 confirmed, timeout |
| `torn_in_a_chunk` | `nominal`, cut off within a compressed chunk |
| `torn_with_zeros` | `pulled_to_cw`, the last three tenths are zeros |
| `torn_without_summary` | `pushed_to_ccw_against_wind`, cut off before its summary |
| `touched_then_given_up` | the handle is touched, the referee declares a timeout |
| `void` | completed, signed and void |
| `waiver_incident_timeout` | handle not zeroed (waived), incident, timeout, ruling taken back |
| `worn` | the worn door: rests of angle and force that change, lost messages |

The foreign runs are bags of own runs that other libraries wrote in other orders, and bags in which
messages were received late.

| foreign run | what it is |
| --- | --- |
| `blocks_backwards_with_journal` | `protest_decided` by mcap, blocks of 500, the last first |
| `by_topic_zstd` | `slam` by mcap, topic after topic, zstd |
| `door_0_15_s_late` | `corrected_team_and_sides` by mcap, door received 0.15 s late |
| `handle_0_2_s_late_by_topic` | `slow_until_timeout` by mcap, by topic, handle 0.2 s late |
| `jittered_reception` | `false_start_accepted` by mcap, reception up to 15 ms late |
| `reversed_within_0_2_s_lz4` | `pulled_to_cw` by mcap, backwards within 0.2 s, lz4, small chunks |
| `rosbags_by_topic` | `slam` by rosbags, topic after topic |
| `rosbags_topics_backwards` | `worn` by rosbags, the last topic first |
| `strips_0_1_to_0_2_s_late` | `pushed_to_cw_latch_decides` by mcap, passage 0.1 to 0.2 s late |
| `without_chunks_and_index` | `worn` by mcap, without chunks, index and statistics |
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import tarfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from madrob_console.archive import score
from recorder import Bag
from scoring import Result, RulesetName

HERE = Path(__file__).parent
RULES = [RulesetName("protocol"), RulesetName("eurobench-2020")]
LIBRARIES = ("numpy", "scipy")
"""The values hang on these: other versions add in other orders."""
NOT_OF_SENSORS = ("/madrob/referee/", "/tf")

Numbers: TypeAlias = dict[str, Any]
Runs: TypeAlias = Mapping[str, Path]
"""`own/NAME` or `foreign/NAME`, and the folder that holds the one run."""


def unpack(folder: Path) -> Runs:
    """Unpack the archive and return its runs by name."""
    with tarfile.open(HERE / "runs.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return {f"{path.parent.name}/{path.name}": path for path in sorted(folder.glob("*/*"))}


def stored(name: str) -> Numbers:
    content: Numbers = json.loads((HERE / name).read_text(encoding="utf-8"))
    return content


def score_one(path: Path, rules: RulesetName | None = None) -> Result:
    (scored,) = score(path, rules)
    return scored.result


def values_of(result: Result) -> Numbers:
    """Return the eight values with all digits; None for one that is missing."""
    return {str(name): one.value for name, one in result.indicators.items()}


def events_of(result: Result) -> list[Numbers]:
    return [
        {"event": str(one.event), "time": one.time, "since_start": one.since_start}
        for one in result.events
    ]


def level_of(result: Result) -> float | None:
    """Return how many steps count; None for a run that is invalid."""
    level: float | None = values_of(result)["capability_level"]
    return level


def numbers_of(path: Path) -> Numbers:
    """Return what one run scores to under both rulesets, and the digests of its topics."""
    own = score_one(path)
    numbers: Numbers = {"own_rules": str(own.ruleset), "outcome": str(own.outcome)}
    for rules in RULES:
        result = score_one(path, rules)
        numbers[str(rules)] = {
            "level": level_of(result),
            "events": events_of(result),
            "values": values_of(result),
        }
    numbers["topics"] = digests_of(messages_by_topic(path))
    return numbers


def interval_numbers_of(path: Path) -> Numbers:
    """Return what a foreign run scores to: each value with its U, the half of its interval.

    U is None where no uncertainty is known. The value then stays to 1e-9 of itself.
    """
    numbers = numbers_of(path)
    for rules in RULES:
        values = numbers[str(rules)]["values"]
        for name, one in score_one(path, rules).indicators.items():
            worth = one.uncertainty
            expanded = None if worth is None else worth.expanded
            values[str(name)] = {"value": one.value, "U": expanded}
    return numbers


def uncertainties_of(path: Path) -> Numbers:
    """Return reason, uncertainty and doubts of each value of one run by the ruleset `protocol`."""
    uncertainties = {}
    for name, one in score_one(path, RULES[0]).indicators.items():
        worth = one.uncertainty
        uncertainties[str(name)] = {
            "reason": one.reason,
            "u": None if worth is None else worth.u,
            "U": None if worth is None else worth.expanded,
            "rest": None if worth is None else worth.rest,
            "doubts": list(one.doubts),
        }
    return uncertainties


def bag_in(path: Path) -> Path:
    """Return the one recording of a run."""
    (recording,) = path.rglob("*.mcap")
    return recording


def messages_by_topic(path: Path) -> dict[str, list[bytes]]:
    """Return the CDR bytes of each sensor topic in the order of log time."""
    topics = defaultdict(list)
    for message in Bag(bag_in(path)).messages():
        if not message.topic.startswith(NOT_OF_SENSORS):
            topics[message.topic].append((message.receive_ns, message.data))
    return in_order_of_time(topics)


def in_order_of_time(topics: Mapping[str, list[tuple[int, bytes]]]) -> dict[str, list[bytes]]:
    """Sort the messages of each topic by log time; of equal ones the first in the bag is first."""
    ordered = {}
    for topic, messages in sorted(topics.items()):
        messages.sort(key=lambda message: message[0])
        ordered[topic] = [data for _, data in messages]
    return ordered


def digests_of(topics: Mapping[str, Iterable[bytes]]) -> dict[str, str]:
    """Return the SHA-256 of each topic.

    It runs over the messages of the topic in the order of log time. Of each message come first its
    length as eight bytes, little endian, then its CDR bytes with the encapsulation header.
    """
    digests = {}
    for topic, messages in topics.items():
        digest = hashlib.sha256()
        for data in messages:
            digest.update(struct.pack("<Q", len(data)))
            digest.update(data)
        digests[topic] = digest.hexdigest()
    return digests


def check_by_mcap(path: Path) -> None:
    """Compare what the bag gives with what the reader of the mcap library gives.

    That reader leaves out the chunk in which a torn file ends, so what it gives may be less there.
    """
    topics = defaultdict(list)
    whole = True
    with bag_in(path).open("rb") as file:
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                if not channel.topic.startswith(NOT_OF_SENSORS):
                    topics[channel.topic].append((message.log_time, message.data))
        except (McapError, struct.error, EOFError):
            whole = False
    ours, theirs = messages_by_topic(path), in_order_of_time(topics)
    if whole and ours != theirs:
        raise ValueError(f"{path}: mcap reads other messages than recorder")
    for topic, messages in theirs.items():
        if not messages or ours[topic][: len(messages)] != messages:
            raise ValueError(f"{path}: mcap reads other messages of {topic} than recorder")


def numbers_text(runs: Runs) -> str:
    """Return the content of `numbers.json` after a check of all bags by the mcap library."""
    numbers = {}
    for name, path in runs.items():
        check_by_mcap(path)
        numbers[name] = interval_numbers_of(path) if is_foreign(name) else numbers_of(path)
    libraries = {library: version(library) for library in LIBRARIES}
    return to_text({"format": "corpus 1", "libraries": libraries, "runs": numbers})


def doubts_text(runs: Runs) -> str:
    doubts = {name: uncertainties_of(path) for name, path in runs.items() if not is_foreign(name)}
    return to_text({"format": "corpus 1", "ruleset": str(RULES[0]), "runs": doubts})


def is_foreign(name: str) -> bool:
    return name.startswith("foreign/")


def to_text(content: Numbers) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def differences(expected: object, found: object, rel: float, at: str = "") -> Iterator[str]:
    """Name each place at which two JSON values differ by more than `rel` of a number."""
    if isinstance(expected, dict) and isinstance(found, dict) and expected.keys() == found.keys():
        for key in expected:
            yield from differences(expected[key], found[key], rel, f"{at}/{key}")
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for number, pair in enumerate(zip(expected, found, strict=True)):
            yield from differences(*pair, rel, f"{at}/{number}")
    elif isinstance(expected, float) and isinstance(found, float):
        if not math.isclose(expected, found, rel_tol=rel, abs_tol=rel):
            yield f"{at}: {expected!r} is stored, {found!r} found"
    elif expected != found:
        yield f"{at}: {expected!r} is stored, {found!r} found"


def outside(expected: Numbers, found: Numbers) -> Iterator[str]:
    """Name each value that is not within its interval, value +- U."""
    for name, one in expected.items():
        value, other = one["value"], found[name]
        if value is None or other is None:
            if value != other:
                yield f"{name}: {value!r} is stored, {other!r} found"
            continue
        room = one["U"] or 1e-9 * abs(value)
        if abs(value - other) > room:
            yield f"{name}: {value!r} +- {room} is stored, {other!r} found"


def tolerance(otherwise: float) -> float:
    """Return 0 with the libraries that computed the numbers, else a relative difference."""
    head: Numbers = stored("numbers.json")["libraries"]
    locked = all(version(library) == head[library] for library in LIBRARIES)
    return 0.0 if locked else otherwise


OWN = [name for name in stored("numbers.json")["runs"] if not is_foreign(name)]
FOREIGN = [name for name in stored("numbers.json")["runs"] if is_foreign(name)]


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    return unpack(tmp_path_factory.mktemp("corpus"))


def test_archive_holds_the_forty_runs(runs: Runs) -> None:
    assert [*runs] == [*FOREIGN, *OWN]
    assert (len(OWN), len(FOREIGN)) == (30, 10)


@pytest.mark.parametrize("name", OWN)
def test_own_run_scores_to_its_digits(name: str, runs: Runs) -> None:
    found = numbers_of(runs[name])

    expected = stored("numbers.json")["runs"][name]
    assert [*differences(expected, found, tolerance(1e-9))] == []


@pytest.mark.parametrize("name", OWN)
def test_own_run_has_its_doubts(name: str, runs: Runs) -> None:
    found = uncertainties_of(runs[name])

    # U has two digits: another version of a library may round the second one differently.
    expected = stored("doubts.json")["runs"][name]
    assert [*differences(expected, found, tolerance(0.1))] == []


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_run_scores_within_its_uncertainties(name: str, runs: Runs) -> None:
    expected = stored("numbers.json")["runs"][name]

    found = numbers_of(runs[name])

    assert found["topics"] == expected["topics"]
    assert found["outcome"] == expected["outcome"]
    for rules in map(str, RULES):
        assert found[rules]["level"] == expected[rules]["level"]
        names, others = ([e["event"] for e in n[rules]["events"]] for n in (expected, found))
        assert names == others
        assert [*outside(expected[rules]["values"], found[rules]["values"])] == []
