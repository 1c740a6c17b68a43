"""SHOW: the screens. They hold no rule and no state of a run."""
