"""Check and correct calibrations with recordings of a known object."""
