"""A new testbed: what is installed and found, whether that scores right, calibration.

No run needs it: what is found becomes lines of the settings, which are in config.
"""
