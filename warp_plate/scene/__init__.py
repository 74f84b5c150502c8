"""The input of a run as users describe it: the plate, its edges, the actuators, the target and the effects in play."""

from warp_plate.scene.actuator import Actuator
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import preset_names, preset_text
from warp_plate.scene.model import Scene

__all__ = ["Actuator", "Scene", "SceneError", "preset_names", "preset_text"]
