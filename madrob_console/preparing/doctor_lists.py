"""What the doctor says of a competition's lists: its teams and its plan."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.preparing.finding import Finding, Severity
from madrob_console.referee.competition_plan import PlanSource, unknown_teams
from madrob_console.referee.teams import TeamSource


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
    for words in unknown_teams(tasks, listed.names):
        yield Finding(Severity.WARNING, "plan", words)
