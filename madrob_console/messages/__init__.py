"""Bytes of a message to samples and back: mappings, fields, message types.

Where messages come from is in testbeds; what samples mean is in scoring.
"""
