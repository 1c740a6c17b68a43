"""How values and their uncertainties are written."""

from __future__ import annotations

import pytest

from scoring.result import Uncertainty, distinguishable, uncertainty_text, value_text


@pytest.mark.parametrize(
    ("value", "expanded", "value_words", "uncertainty_words"),
    [
        (13.8621, 0.018, "13.86", "+- 0.02"),
        (13.8621, 0.012, "13.86", "+- 0.02"),  # rounded up: never less than there is
        (13.4, 0.43, "13.4", "+- 0.5"),
        (1.0, 0.096, "1.0", "+- 0.1"),
        (130.4, 12.0, "130", "+- 20"),
        (0.0, 0.02, "0.00", "+- 0.02"),
        (0.001, 1e-5, "1.00e-03", "+- 1e-05"),
        (60.0, 0.0, "60", ""),  # a timeout: exact
        (47.12, 0.0, "47.12", ""),
        (0.0, 0.0, "0", ""),
        (1e-3, 0.0, "1.0000e-03", ""),
        (4, 0.0, "4", ""),
    ],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves(
    value: float, expanded: float, value_words: str, uncertainty_words: str
) -> None:
    uncertainty = Uncertainty(expanded / 2, expanded)
    assert value_text(value, uncertainty) == value_words
    assert uncertainty_text(uncertainty) == uncertainty_words


def test_a_value_of_which_no_uncertainty_is_known_has_four_decimals() -> None:
    assert value_text(13.86214) == "13.8621"
    assert uncertainty_text(None) == ""


@pytest.mark.parametrize(
    ("one", "two", "expanded", "apart"),
    [
        (10.0, 10.3, (0.1, 0.1), True),
        (10.0, 10.3, (0.1, 0.25), False),
        (10.0, 10.0, (0.1, 0.1), False),
        (5, 6, (0.0, 0.0), True),
        (6, 6, (0.0, 0.0), True),  # equal is more than not distinguishable
        (10.0, 10.3, (0.2, None), True),  # nothing is known of one
    ],
)
def test_values_whose_uncertainties_overlap_are_not_distinguishable(
    one: float, two: float, expanded: tuple[float, float | None], apart: bool
) -> None:
    first, second = (None if each is None else Uncertainty(each / 2, each) for each in expanded)
    assert distinguishable(one, two, first, second) is apart
    assert distinguishable(two, one, second, first) is apart


def test_a_mean_is_known_better_than_its_values() -> None:
    mean = Uncertainty.of_mean([Uncertainty(0.3, 0.6), Uncertainty(0.4, 0.8)])
    assert mean is not None
    assert mean.u == pytest.approx(0.25)
    assert mean.expanded == pytest.approx(0.5)
    assert Uncertainty.of_mean([Uncertainty(0.3, 0.6)]) == Uncertainty(0.3, 0.6)
    assert Uncertainty.of_mean([Uncertainty(0.3, 0.6), None]) is None
    assert Uncertainty.of_mean([]) is None


def test_a_mean_of_values_that_scatter_is_known_no_better_than_they_repeat() -> None:
    parts = [Uncertainty(0.01, 0.02)] * 4
    assert Uncertainty.of_mean(parts, 3.0) == Uncertainty(1.5, 3.0)
    measured = Uncertainty.of_mean(parts)
    assert measured == Uncertainty.of_mean(parts, 0.0) == Uncertainty.of_mean(parts, 0.0099)
    assert Uncertainty.of_mean([*parts, None], 3.0) is None
