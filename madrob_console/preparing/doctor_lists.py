"""What the doctor says of a competition's lists: its teams and its plan."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.preparing.finding import Finding, Severity
from madrob_console.referee.competition_plan import PlanSource
from madrob_console.referee.teams import TeamSource

_SHOWN = 10


def look_at_lists(teams: TeamSource, plan: PlanSource) -> Iterator[Finding]:
    """Whether all of both lists can be used, and whether they know the same teams."""
    listed, planned = teams.read(), plan.read()
    for name, problems in (("teams", listed.problems), ("plan", planned.problems)):
        yield from (Finding(Severity.WARNING, name, problem) for problem in problems)
    if listed.names:
        yield Finding(Severity.OK, "teams", f"{len(listed.names)} in the list")
    if not planned.lines:
        return
    tasks = {line.task for line in planned.lines}
    subjects = sorted({task.subject for task in tasks})
    attempts = sum(line.attempts for line in planned.lines)
    text = f"{attempts} attempts, teams: {len(subjects)}, conditions: "
    text += str(len({task.condition for task in tasks}))
    yield Finding(Severity.OK, "plan", text)
    unknown = [str(subject) for subject in subjects if subject not in listed.names]
    if listed.names and unknown:
        more = len(unknown) - _SHOWN
        words = ", ".join(unknown[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
        text = f"subject {words}: not in the list of teams, so they have no name"
        yield Finding(Severity.WARNING, "plan", text)
