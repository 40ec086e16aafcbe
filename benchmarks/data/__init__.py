"""Inputs for the benchmarks: scenes and films with ground truth, disturbances of these, and recordings."""
