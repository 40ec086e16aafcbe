"""Errors of the generator of synthetic images that its user can correct."""

from __future__ import annotations

from tracker.errors import TrackerError


class AssetError(TrackerError):
    """The robot's description or meshes are not available."""


class EffectError(TrackerError):
    """An effect does not exist."""
