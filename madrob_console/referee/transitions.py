"""Changes of a run that acts, sensors and the clock bring about (protocol section 2)."""

from __future__ import annotations

from dataclasses import replace

from madrob_console.referee.on_record import Reissuing
from madrob_console.referee.run import Phase, Run
from scoring.protocol import Outcome
from scoring.rulesets import RulesetName

LEAST_PREROLL = 1.0
"""Recording begins at least this long before the start, s (protocol section 3)."""


def begin_countdown(run: Run, at: float) -> Run:
    """The countdown begins at `at` (s since the epoch); the start lies at least 1 s later."""
    assert run.setup is not None
    return replace(
        run,
        phase=Phase.COUNTDOWN,
        countdown_began=at,
        start=at + max(run.setup.countdown, LEAST_PREROLL),
    )


def begin_run(run: Run) -> Run:
    """The planned start has come."""
    return replace(run, phase=Phase.RUNNING)


def decide_false_starts(run: Run, reason: str) -> Run:
    """All undecided false starts are let pass with `reason`."""
    decided = tuple(replace(f, accepted=f.accepted or reason) for f in run.false_starts)
    return replace(run, false_starts=decided)


def time_out(run: Run, at: float, reason: str) -> Run:
    """The timeout came at `at`, elapsed or declared (section 2)."""
    return replace(run, timeout_at=at, outcome_reason=reason)


def stop(run: Run, outcome: Outcome, at: float, reason: str) -> Run:
    """The run ends at `at` (s since the epoch)."""
    return replace(
        run,
        phase=Phase.STOPPED,
        outcome=outcome,
        stop=at,
        outcome_reason=reason,
        timeout_at=None,
    )


def changed(run: Run, at: float) -> Run:
    """What the result says is another one since `at`: teams have all the time for a protest."""
    return replace(run, changed=at, signed=None)


def reissued(
    run: Run, at: float, what: str, reason: str, referee: str, rules: RulesetName | None = None
) -> Run:
    """The result gets another issue, final or not; it is open afterwards.

    Args:
        run: before it, and over.
        at: when, s since the epoch.
        what: the act or change that does it, in the journal's word.
        reason: why.
        referee: who says so; empty where no name is known.
        rules: by which its result is made from now on; None = by those that made it.
    """
    issue = max(1, run.issue) + 1
    return replace(
        run,
        phase=Phase.STOPPED,
        closure=None,
        issue=issue,
        reissues=(*run.reissues, Reissuing(at, issue, what, reason, referee, rules)),
        ruleset=rules or run.ruleset,
    )
