"""Calibrated cameras: reading, writing and changing them."""
