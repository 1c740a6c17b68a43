"""The figures of a result, curves drawn by matplotlib.

In the terminal they are drawn by madrob_console.
"""
