"""A new testbed: what is installed and found, and its calibration."""
