"""Errors of the generator of synthetic images that its user can mend."""

from __future__ import annotations

from tracker.errors import TrackerError


class AssetError(TrackerError):
    """The robot's description or meshes cannot be had."""


class EffectError(TrackerError):
    """There is no such effect."""


class RendererError(TrackerError):
    """A renderer cannot be had on this machine, or there is none of this name."""
