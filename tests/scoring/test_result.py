"""How values and their uncertainties are written."""

from __future__ import annotations

import pytest

from scoring.result import Uncertainty, uncertainty_text, value_text


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
        (13.4, 0.0, "13.4000", ""),
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
