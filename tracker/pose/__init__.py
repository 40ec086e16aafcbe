"""From label maps and images to a pose: hypotheses, alignment, refinement, uncertainty, acceptance."""

from tracker.pose.result import Observation, PoseEstimate, Status

__all__ = ["Observation", "PoseEstimate", "Status"]
