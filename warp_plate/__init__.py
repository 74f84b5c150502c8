"""warp-plate: thousands of thin vibrating panels at once, and the drive that moves only the chosen part.

    >>> from warp_plate import PlateSolver, Scene
    >>> scene = Scene.load("paper")
    >>> run = PlateSolver(scene, "cpu").run([[1, 0, 0, 0], [1, 1, 1, 1]])
    >>> run.energy.shape          # plates, regions
    (2, 2)

The names below are imported when they are first used, so that ``warp-plate --help`` stays quick.
"""

import importlib
import os
import sys

__version__ = "0.1.0"

# In a bare checkout the folders `kernels` and `viz` lie beside this package instead of inside it.
if not os.path.isdir(os.path.join(__path__[0], "kernels")):
    __path__.append(os.path.dirname(__path__[0]))

_HOME = {
    "Scene": "warp_plate.scene",
    "SceneError": "warp_plate.scene",
    "PlateSolver": "warp_plate.solve.solver",
    "localize": "warp_plate.studies.localize",
    "resume": "warp_plate.studies.localize",
    "CheckpointFile": "warp_plate.studies.checkpointing",
    "load_checkpoint": "warp_plate.result.checkpoint",
    "Result": "warp_plate.result",
    "load_result": "warp_plate.result",
    "save_result": "warp_plate.result",
    "load_sweep": "warp_plate.result.sweep",
    "sweep": "warp_plate.studies.sweep",
    "view": "warp_plate.notebook",
}
__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'warp_plate' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def load_ipython_extension(shell: object) -> None:
    """Show scenes and results as HTML in an IPython shell (the hook of ``%load_ext warp_plate``)."""
    from warp_plate.notebook import register

    register(shell)


if "IPython" in sys.modules and (_shell := sys.modules["IPython"].get_ipython()) is not None:
    load_ipython_extension(_shell)
