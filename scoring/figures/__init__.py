"""The figures of a result, drawn by matplotlib.

In the terminal they are drawn by madrob_console.
"""
