"""SHOW: the screens. They hold no rule and no state of a run.

What may be done when is in referee; what is shown comes from engine as plain data.
"""
