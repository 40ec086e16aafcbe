"""Errors of the generator of synthetic images that its user can mend."""

from __future__ import annotations

from tracker.errors import TrackerError


class AssetError(TrackerError):
    """The robot's description or meshes cannot be had."""


class EffectError(TrackerError):
    """There is no such effect."""
