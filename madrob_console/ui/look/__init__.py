"""Colours, signs and words of the screens."""
