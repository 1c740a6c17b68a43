"""One file a pane, and the views that only panes use.

What knows no run is in cells; what is there beside every pane is in frame.
"""
