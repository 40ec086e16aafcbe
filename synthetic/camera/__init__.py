"""From a scene to an image: lens, sensor, noise."""
