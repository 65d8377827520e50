"""Pictures and films of cars, without a screen."""

from qcar_twin.rendering.film import Film, Look, write_still, write_video
from qcar_twin.rendering.scene import scene

__all__ = ["Film", "Look", "scene", "write_still", "write_video"]
