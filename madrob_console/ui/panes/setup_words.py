"""What the set-up pane says of the run in its fields: what is wrong with it, which key goes on."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING

from madrob_console.referee.acts import Start
from madrob_console.referee.competition_plan import PlanProgress, Task
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.standings.plan_table import task_words
from madrob_console.ui.cells.lines import Tone

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.referee.teams import TeamList

OPEN = (Phase.IDLE, Phase.READY)
"""What the fields say is set up; in other states it is a draft of the next run."""


class Focus(Enum):
    """Where keys go."""

    FIELD = auto()
    TEAM = auto()
    BUTTON = auto()
    ELSEWHERE = auto()


@dataclass(frozen=True, slots=True)
class SetupWords:
    """Words about a set-up.

    Args:
        snapshot: how things stand.
        setup: what the fields say, or what is wrong with them.
        plan: how much of the competition's plan is done.
        focus: where keys go.
    """

    snapshot: Snapshot
    setup: RunSetup | str
    plan: PlanProgress
    focus: Focus

    def state(self, problem: str) -> tuple[str, Tone]:
        """What becomes of it.

        Args:
            problem: what is wrong, besides what the fields say; it comes first. Empty = nothing.
        """
        snapshot, setup, run = self.snapshot, self.setup, self.snapshot.run
        if snapshot.playback is not None:
            return "A replay: nothing is set up here. F3 shows the run.", Tone.WARN
        if snapshot.pulse.gone:
            return f"x {snapshot.pulse.gone}", Tone.BAD
        if snapshot.right.only_watches:
            return "This screen only watches. F3 shows the run.", Tone.PLAIN
        if run.active:
            return f"Not editable now: {run.phase}. F3 shows the run.", Tone.WARN
        if problem or isinstance(setup, str):
            return f"x {problem or setup}", Tone.BAD
        checked = setup == run.setup and run.phase in OPEN  # the check `team` says the rest
        team = self._team(setup, snapshot.teams, checked=checked)
        planned = self._planned(setup, checked=checked)
        what = f"un {setup.run_number} of subject {setup.subject}{planned}"
        if run.phase not in OPEN:
            return f"Draft of r{what}: {self._next_key}.{team}", Tone.PLAIN
        if not checked:
            told = f"Not set up yet{planned}: Enter, here or in a field."
            return told + team, Tone.WARN
        then = "F5 starts." if snapshot.refusal(Start.name) is None else "See the checks."
        if not run.pose_confirmed:
            then = "F6 confirms its pose."
        return f"R{what} is set up. {then}{team}", Tone.GOOD

    @property
    def next(self) -> str:
        """That x sets this up, where it is the plan's next run; else empty."""
        following, setup = self.plan.next, self.setup
        if following is None or isinstance(setup, str) or setup.practice:
            return ""
        if task_of(setup) != following.task:
            return ""
        task = task_words(following.task, self.snapshot.teams.names)
        attempt = f"attempt {following.number} of {following.planned}"
        return f"x: {task}, {attempt}. X repeats, p shows the plan."

    @property
    def _next_key(self) -> str:
        """What sets a draft up, from where the focus is."""
        if self.focus in (Focus.FIELD, Focus.TEAM):
            return "Escape, then x sets it up"
        return "x or Enter sets it up" if self.focus is Focus.BUTTON else "x sets it up"

    def _team(self, setup: RunSetup, teams: TeamList, *, checked: bool) -> str:
        """What is odd about the team's name, and how to change it."""
        here = self.focus is Focus.TEAM
        if setup.team_reason:
            clears = " Del takes the list's." if here else ""
            return f" Other name than the list's: {setup.team_reason}.{clears}"
        if teams.lacks(setup.subject) and (setup.practice or not checked):
            return f" Subject {setup.subject} is not in the list of teams!"
        return " Type to look for a team." if here else ""

    def _planned(self, setup: RunSetup, *, checked: bool) -> str:
        """Which attempt of the plan it is, in words; empty where it is none."""
        if setup.out_of_plan:
            return "" if checked else ", OUT OF PLAN"
        of = next((one for one in self.plan.tasks if one.task == task_of(setup)), None)
        if setup.practice or of is None or not of.planned:
            return ""
        if not of.left:
            return ", an attempt repeated"
        return f", attempt {of.done + 1} of {of.planned}"


def task_of(setup: RunSetup) -> Task:
    """The team and the condition of a set-up."""
    return Task(setup.subject, setup.condition.number)
