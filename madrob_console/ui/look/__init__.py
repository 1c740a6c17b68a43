"""Colours, signs and words of the screens.

Where they are used is in cells, panes and frame.
"""
