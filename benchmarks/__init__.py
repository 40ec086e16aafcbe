"""Workloads, metrics and baselines that measure the tracker."""
