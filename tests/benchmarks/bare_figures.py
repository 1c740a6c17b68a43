"""What a report is compared with: as many plain figures as a run has, as SVG.

python -m tests.benchmarks.bare_figures <runs>
"""

from __future__ import annotations

import io
import sys

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

FIGURES, POINTS = 6, 1000


def main(runs: int) -> None:
    """Draw one line in each."""
    points = range(POINTS)
    for _ in range(FIGURES * runs):
        figure = Figure(figsize=(10, 4))
        axes = figure.add_subplot()
        axes.plot(points, [point % 97 for point in points])
        axes.set_xlabel("time, s")
        axes.set_ylabel("force, N")
        FigureCanvasSVG(figure).print_svg(io.StringIO())  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main(int(sys.argv[1]))
