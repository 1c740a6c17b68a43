"""The colours of the figures, the protocol document's; a page may put others in their place."""

ORANGE, BLUE, RED, GREY = "#d95f02", "#1f4e9e", "#c00000", "#555555"
"""Position, what follows from it, what makes the indicator, and all the rest."""

BAND = "#e0e0e0"
"""Of what lies behind curves and points."""
