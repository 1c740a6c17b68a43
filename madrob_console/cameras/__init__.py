"""What cameras saw: the frames nearest to an event, decoded, and how their clocks stand.

Nothing is scored from it.
"""
