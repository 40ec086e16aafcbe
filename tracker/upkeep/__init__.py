"""Calibrations looked after, by what recordings of a known object show."""
