"""Inputs of the benchmarks: scenes and films with ground truth, disturbances of them, and recordings."""
