"""From a scene to a picture: lens, sensor, noise."""
