"""The questions before acts on a result, protests among them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, relative_text, seconds_of
from madrob_console.common.names import clean_name
from madrob_console.referee.acts import (
    AcceptDoubts,
    Correct,
    DecideProtest,
    FileProtest,
    Finalise,
    Reissue,
    TakeBack,
    Void,
    WithdrawProtest,
)
from madrob_console.referee.acts.after import NAMELESS, NO_DOUBT
from madrob_console.referee.acts.correct import (
    NO_RUN,
    NOTHING_TO_TAKE_BACK,
    corrected_words,
    last_decision,
)
from madrob_console.referee.acts.protest import NONE_OPEN, WHOLE_RUN, outside_recording
from madrob_console.referee.competition_plan import TESTBED_FAULT
from madrob_console.referee.flags import Doubts, doubted_words, undecided, waiting_doubts
from madrob_console.referee.protests import Protest, ProtestEnd, open_protests
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_setup import RunSetup
from madrob_console.ui.keys.questions import (
    Ask,
    Intent,
    Option,
    Pick,
    Question,
    Sure,
    Write,
    ask_why,
    reasons,
)
from scoring.indicator_table import IndicatorName
from scoring.protocol import BenchmarkType, Condition

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.referee.team_list import TeamList

_TEAM = Pick(
    "What does the team say?",
    (
        Option("n", "nothing yet: do not sign", None),
        Option("a", "acknowledged", TeamWord.ACKNOWLEDGED),
        Option("b", "absent", TeamWord.ABSENT),
    ),
    below=("If it protests: Escape, then Enter P files the protest.",),
)
_NAME = Write("Referee's name:", missing=NAMELESS)
_UNDECIDED = (
    Option("n", "no: decide first", None),
    Option("y", "yes, sign it as it is: that stays on record", "sign"),
)


def ask_signature(snapshot: Snapshot, _pressed: str) -> Ask:
    """Asks for the team's word, a note and a missing name; first lists open questions."""
    referee, waiting = snapshot.run.referee, undecided(snapshot.flags)
    listed = _checklist(snapshot)
    questions: list[Question] = [Write("Note (Enter for none):")]
    if not referee:
        questions.append(_NAME)
    if waiting:
        questions[:0] = [Pick("Sign it all the same?", _UNDECIDED, listed), _TEAM]
    else:
        questions.insert(0, replace(_TEAM, listed=listed))
    open_questions = tuple(flag.words for flag in waiting)

    def signed(*answers: str) -> Finalise:
        word, note, by = (*answers[bool(waiting) :], referee)[:3]
        return Finalise(TeamWord(word), by, note, open_questions)

    return Ask("Sign the result", tuple(questions), signed)


def _checklist(snapshot: Snapshot) -> tuple[str, ...]:
    flags, unchanged = snapshot.flags, _without_effect(snapshot.run)
    steps = ", ".join(f"{record.step:d}" for record in snapshot.steps if record.done)
    main = (IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME)
    values = [
        f"{n.words} {indicator.text}" for n, indicator in snapshot.indicators.items() if n in main
    ]
    rows = ["; ".join((f"{snapshot.run.outcome}, steps {steps or 'none'}", *values))]
    rows += [f"! {flag.words}" for flag in undecided(flags)]
    rows += [f"! {protest.title} was upheld: nothing was changed since" for protest in unchanged]
    if others := [flag.words for flag in flags if not flag.undecided]:
        rows.append(f"- {'; '.join(others)}")
    return tuple(rows)


def _without_effect(run: Run) -> list[Protest]:
    """Upheld protests after whose filing nothing about the result has changed."""
    changed = -math.inf if run.changed is None else run.changed
    upheld = (ProtestEnd.UPHELD, ProtestEnd.PARTLY)
    return [
        protest
        for protest in run.protests
        if protest.answer is not None and protest.answer.end in upheld and changed < protest.time
    ]


_ALL = "all"
_MOST_LISTED = 4
"""Sentences of two rows that fit in a dialog, in 80 x 24 cells."""
_WHY_ACCEPTED = ask_why("seen on video: right", "no effect on the ranking", "the run is repeated")


def ask_doubts(snapshot: Snapshot, _pressed: str) -> Intent:
    waiting = waiting_doubts(snapshot.indicators, snapshot.run.accepted_doubts)
    if not waiting:
        return NO_DOUBT
    if len(waiting) == 1:
        return _ask_to_accept(waiting)
    each = (
        Option(str(number), f"{name.words}: {counted(len(doubts), 'doubt')}", name)
        for number, (name, doubts) in enumerate(waiting.items(), 1)
    )
    every = (Option("a", "on all of them", _ALL), *each)

    def chosen(which: str) -> Ask:
        return _ask_to_accept({name: waiting[name] for name in waiting if which in (_ALL, name)})

    question = Pick("On which indicator?", every, quick=True)
    return Ask("Accept doubts: the values stand as they are", (question,), chosen)


def _ask_to_accept(doubts: Doubts) -> Ask:
    listed = [f"? {words}" for words in dict.fromkeys(chain(*doubts.values()))]
    if (more := len(listed) - _MOST_LISTED) > 1:
        listed[_MOST_LISTED:] = [f"? and {more} more: the result has all of them"]
    title = f"Accept what is doubted of {doubted_words(doubts)}"
    question = replace(_WHY_ACCEPTED, listed=tuple(listed))
    return Ask(title, (question,), lambda reason: AcceptDoubts(doubts, reason))


REISSUE = Ask(
    "Re-issue the final result; the old version stays",
    (
        Pick("Why?", reasons("a step was ruled wrongly", "found out later")),
        Sure("Re-issue the result?"),
    ),
    Reissue,
)

VOID = Ask(
    "VOID this run: it does not count, and gives its attempt back",
    (
        ask_why("robot unsafe", TESTBED_FAULT, "referee's mistake", "protest upheld"),
        Sure("Void it? z takes it back."),
    ),
    Void,
)


def ask_void_instead(reason: str) -> Ask:
    """The run was over before its abort took effect."""
    return Ask(
        f"The run was over before the abort ({reason}). {VOID.title}",
        (Sure("Void it? z takes it back."),),
        lambda: Void(reason),
    )


_WHY_CORRECTED = replace(
    ask_why("typed wrongly", "the set-up of the run before was kept"),
    text="Why? The run gets the next number of the right subject and condition.",
)


def ask_correction(snapshot: Snapshot, _pressed: str) -> Intent:
    setup = snapshot.run.setup
    if setup is None:
        return NO_RUN
    condition = setup.condition
    opening, starting = condition.opening_side, condition.starting_side
    types = [kind for kind in BenchmarkType if kind is not condition.benchmark_type]
    right: dict[str, Condition] = {
        "opening": replace(condition, opening_side=opening.opposite),
        "starting": replace(condition, starting_side=starting.opposite),
        **{kind.value: replace(condition, benchmark_type=kind) for kind in types},
    }
    options = (
        Option("s", f"subject: it is not {setup.subject}", "subject"),
        Option("o", f"opening side: it is {opening.opposite.upper()}", "opening"),
        Option("t", f"starting side: it is {starting.opposite.upper()}", "starting"),
        *(Option(str(n), f"type: it is {kind}", kind.value) for n, kind in enumerate(types, 1)),
    )

    def chosen(what: str) -> Ask:
        if what == "subject":
            return _ask_subject(setup, snapshot.teams)
        after = replace(setup, condition=right[what])
        return Ask(
            f"Correct the {corrected_words(setup, after)}",
            (_WHY_CORRECTED,),
            lambda reason: Correct(setup.subject, right[what], reason),
        )

    title = "Correct what was set up: the run is scored again"
    return Ask(title, (Pick("What was wrong? Its folder keeps its name.", options),), chosen)


def _ask_subject(setup: RunSetup, teams: TeamList) -> Ask:
    def typed(text: str) -> Ask | str:
        if not (text.isascii() and text.isdigit() and len(text) < 4):
            return f"subject '{text[:20]}': use a number from 1 to 999"
        number = int(text)
        title = f"Correct the {corrected_words(setup, replace(setup, subject=number))}"
        if teams.names:
            listed = teams.names.get(number, "which is not in the list of teams!")
            return Ask(
                f"{title}, {listed}",
                (_WHY_CORRECTED,),
                lambda reason: Correct(number, setup.condition, reason),
            )

        def named(name: str, reason: str) -> Correct | str:
            try:
                return Correct(number, setup.condition, reason, clean_name(name, "team"))
            except MadrobError as error:
                return str(error)

        return Ask(title, (Write("Team (Enter for no name):"), _WHY_CORRECTED), named)

    return Ask(
        f"Correct the subject, which is {setup.subject}",
        (Write("Subject:", missing="a number is needed"),),
        typed,
    )


def ask_take_back(snapshot: Snapshot, _pressed: str) -> Ask | str:
    last = last_decision(snapshot.run)
    if last is None:
        return NOTHING_TO_TAKE_BACK
    opens = ", which opens the signed result again" * (snapshot.run.phase is Phase.FINAL)
    return Ask(
        f"Take back the last decision{opens}: {last.words}",
        (ask_why("my mistake", "seen on video", "protest upheld"),),
        lambda reason: TakeBack(last.kind, last.time, reason),
    )


_FILE, _DECIDE, _WITHDRAW = "file", "decide", "withdraw"


def ask_protest(snapshot: Snapshot, pressed: str) -> Intent:
    waiting = open_protests(snapshot.run.protests)
    if not waiting:
        return _ask_about(snapshot)
    first = waiting[0]
    listed = (f"! {first.title} of {first.team}: {first.text}",)

    def chosen(what: str) -> Intent:
        if what == _FILE:
            return _ask_about(snapshot)
        return (ask_decision if what == _DECIDE else ask_withdrawal)(snapshot, pressed)

    options = (
        Option("d", "decide it", _DECIDE),
        Option("w", "the team withdraws it", _WITHDRAW),
        Option("a", "another protest is filed", _FILE),
    )
    question = Pick("What becomes of it?", options, listed)
    count = f"{len(waiting)} protests are open" if len(waiting) > 1 else "A protest is open"
    return Ask(count, (question,), chosen)


_FILING = "PROTEST: the result stays open until it is decided"


def _ask_about(snapshot: Snapshot) -> Ask:
    run = snapshot.run
    steps = {f"step {step.step:d}: {step.step.text}": step for step in snapshot.steps}
    options = (
        Option("w", WHOLE_RUN, WHOLE_RUN),
        *(Option(str(step.step.value), step.step.text, words) for words, step in steps.items()),
        Option("i", "an indicator", "indicator"),
        Option("t", "a time of the run: type it", "time"),
    )

    def chosen(what: str) -> Intent:
        if what == "indicator":
            return _ask_indicator(snapshot)
        if what == "time":
            question = Write("Seconds from the start of the run (12.5, -3, 1:05):")
            return Ask(_FILING, (question,), lambda typed: _ask_at(snapshot, typed))
        step = steps.get(what)
        time = None if step is None else step.final or step.sensors
        at = None if time is None or run.start is None else time - run.start
        return _ask_words(snapshot, what, at)

    return Ask(_FILING, (Pick("What is it about?", options),), chosen)


def _ask_indicator(snapshot: Snapshot) -> Ask:
    options = tuple(
        Option(chr(ord("a") + number), name.words, name.words)
        for number, name in enumerate(
            [each for each in IndicatorName if each in snapshot.indicators] or list(IndicatorName)
        )
    )
    question = Pick("Which indicator?", options)
    return Ask(_FILING, (question,), lambda words: _ask_words(snapshot, words, None))


def _ask_at(snapshot: Snapshot, typed: str) -> Intent:
    at = seconds_of(typed)
    if at is None:
        return f"{typed!r} is no time: 12.5, -3 or 1:05 is one"
    if outside := outside_recording(at, snapshot.run):
        return outside
    return _ask_words(snapshot, f"{relative_text(at, 0.0)} s", at)


def _ask_words(snapshot: Snapshot, about: str, at: float | None) -> Ask:
    setup = snapshot.run.setup
    own = "" if setup is None else setup.team or f"subject {setup.subject}"
    team = (Option("1", own, own),) if own.strip() else ()
    who = Pick("Who protests?", (*team, Option("o", "another team: type it", None, free=True)))
    words = Write("What does the team say?", missing=FileProtest.missing)
    return Ask(
        f"PROTEST about {about}",
        (who, words),
        lambda team, text: FileProtest(text, team, about, at),
    )


def _ask_which(snapshot: Snapshot, title: str, then: Callable[[Protest], Ask]) -> Intent:
    """Asks which protest is meant, where several are open; `then` makes the next dialog."""
    waiting = {str(protest.number): protest for protest in open_protests(snapshot.run.protests)}
    if not waiting:
        return NONE_OPEN
    if len(waiting) == 1:
        return then(*waiting.values())
    options = tuple(
        Option(chr(ord("a") + at), f"{protest.title} of {protest.team}", number)
        for at, (number, protest) in enumerate(list(waiting.items())[:9])
    )
    question = Pick("Which one?", options)
    return Ask(title, (question,), lambda number: then(waiting[number]))


_HOW = Pick(
    "How is it decided? It changes no value: rule, correct or void for that.",
    (
        Option("u", "upheld", ProtestEnd.UPHELD),
        Option("p", "partly upheld", ProtestEnd.PARTLY),
        Option("r", "rejected", ProtestEnd.REJECTED),
    ),
)
_WHY_DECIDED = Write("In words, for the team:", missing=DecideProtest.missing)


def ask_decision(snapshot: Snapshot, _pressed: str) -> Intent:
    referee = snapshot.run.referee

    def decision(protest: Protest) -> Ask:
        how = replace(_HOW, listed=(f"! {protest.team}: {protest.text}",))
        questions: list[Question] = [how, _WHY_DECIDED]
        if not referee:
            questions.append(_NAME)

        def decided(end: str, why: str, by: str = referee) -> DecideProtest:
            return DecideProtest(protest.number, ProtestEnd(end), why, by)

        return Ask(f"Decide {protest.title}", tuple(questions), decided)

    return _ask_which(snapshot, "Decide a protest", decision)


def ask_withdrawal(snapshot: Snapshot, _pressed: str) -> Intent:
    def withdrawal(protest: Protest) -> Ask:
        listed = (f"! {protest.team}: {protest.text}",)
        why = ask_why("satisfied by the explanation", "filed by mistake")
        question = replace(why, text="What does the team say?", listed=listed)
        return Ask(
            f"The team withdraws {protest.title}",
            (question,),
            lambda reason: WithdrawProtest(protest.number, reason),
        )

    return _ask_which(snapshot, "The team withdraws a protest", withdrawal)
