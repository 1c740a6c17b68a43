"""The reference recordings that `madrob doctor --reference` scores: how they are made.

`python -m tests.madrob_console.references` makes the shipped files anew.
"""
