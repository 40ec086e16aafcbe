"""The simulated platform: robot, objects, their poses and motions."""
