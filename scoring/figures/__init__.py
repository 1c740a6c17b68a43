"""The figures of a result, drawn by matplotlib."""
