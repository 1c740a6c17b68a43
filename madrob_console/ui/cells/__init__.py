"""Parts of a screen that know no run: lines, fields, tables, plots.

What shows a run is in panes and frame.
"""
