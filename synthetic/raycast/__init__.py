"""An exact ray-cast renderer of one cuboid before calibrated cameras: the independent reference of poses."""

from synthetic.raycast.renderer import Rendering, render

__all__ = ["Rendering", "render"]
