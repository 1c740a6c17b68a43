"""What may be done when: states of a run, acts, pre-start checks, journal.

Neither ROS nor terminal nor files of results are known here.
"""
