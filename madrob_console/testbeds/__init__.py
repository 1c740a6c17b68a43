"""SOURCE: where messages come from, live over ROS, simulated, or recorded in a bag.

What is done with them is in engine.
"""
