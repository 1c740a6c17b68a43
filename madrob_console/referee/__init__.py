"""What may be done when: states of a run, acts, pre-start checks, journal, a competition's lists.

Neither ROS nor terminal nor files of results are known here.
"""
