"""One file a pane, and the views that only panes use."""
