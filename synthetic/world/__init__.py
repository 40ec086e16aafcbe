"""What happens on the simulated platform: robot, objects, where they are and how they move."""
