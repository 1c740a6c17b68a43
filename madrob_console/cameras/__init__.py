"""What cameras saw: the frames nearest to an event, decoded, and how their clocks stand.

Nothing is scored from it.
"""

from __future__ import annotations

SIDE = 960
"""Of a picture that is kept, the most pixels in a row and in a column."""
