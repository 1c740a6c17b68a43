"""Where messages come from: ROS, the simulated testbed, a bag."""
