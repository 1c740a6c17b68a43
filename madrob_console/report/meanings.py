"""What the words of a page mean: the indicators by the protocol, and the phases of a run."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.report.explanations import BIAS_NOTE
from madrob_console.report.markup import Content, Markup, element, link, section
from scoring.figure_table import FigureName, FigurePart
from scoring.figures.phases import TimedPhase
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import Result
from scoring.rulesets import ruleset

PASSAGE = "passage"
"""The name under which links find the figure of the passage sensors."""


def anchor(name: IndicatorName) -> str:
    """The name under which links find what an indicator means."""
    return f"explained-{name}"


def definitions(result: Result) -> Markup:
    """All indicators, by the rules of the result."""
    rules = ruleset(result.ruleset)
    drawn = result.outcome is not Outcome.ABORTED

    def entries() -> Iterator[Markup]:
        for name in IndicatorName:
            said = rules.explanation(name)
            own = said != name.spec.explanation  # these rules have it otherwise than the protocol
            text = said if own else name.spec.definition
            what: list[Content] = [f"{text[0].upper()}{text[1:]} "]
            what.append(f"In {unit_text(name.spec.unit)}; {name.spec.better} is better.")
            if drawn and (figure := _figure_of(name)) is not None:
                what += " ", link(f"#figure-{figure.number}", f"Figure {figure.number}"), "."
            elif drawn and name is IndicatorName.DOOR_OCCUPATION_TIME:
                what += " ", link(f"#{PASSAGE}", "The passage sensors"), " show it."
            term = element("dt", name.words)
            yield element("div", term, element("dd", what), id=anchor(name))

    ends = [phase.words for phase in TimedPhase if phase.step is not None]
    return section(
        "What the words mean",
        element("dl", entries(), class_="definitions"),
        element(
            "p",
            f"Phases: {', '.join(ends)}. Each ends when its step counts (the six steps), by the "
            "sensors or by the referee; the rest, until the stop, brought no further step.",
        ),
        element("p", BIAS_NOTE),
        name="explained",
    )


def _figure_of(name: IndicatorName) -> FigureName | None:
    whole = (one for one in FigureName if one.spec.part is FigurePart.WHOLE)
    return next((one for one in whole if one.spec.indicator is name), None)
