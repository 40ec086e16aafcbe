"""Renderers: from a scene and a pinhole view to exact label maps and linear light."""
