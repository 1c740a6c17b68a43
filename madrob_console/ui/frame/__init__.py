"""What is always there: the screen around the panes, its lines on top and at the bottom.

What comes and goes with a key is in panes.
"""
