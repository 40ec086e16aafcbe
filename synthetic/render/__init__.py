"""Renderers: from a scene and a pinhole view to exact labels and linear light."""
