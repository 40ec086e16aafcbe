"""Calibrations checked and mended by what recordings of a known object show."""
