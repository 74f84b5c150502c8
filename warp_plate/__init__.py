"""warp-plate: simulate thousands of thin vibrating panels, and find drives that move only a chosen part.

    >>> from warp_plate import PlateSolver, Scene
    >>> scene = Scene.load("paper")
    >>> run = PlateSolver(scene, "cpu").run([[1, 0, 0, 0], [1, 1, 1, 1]])
    >>> run.energy.shape          # plates, regions
    (2, 2)

The names below are imported when they are first used, so that ``warp-plate --help`` stays quick; type checkers
see them by the imports for ``TYPE_CHECKING``.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING

__version__ = "0.2.0"

# In a bare checkout the folders `kernels` and `viz` are beside this package, not inside it.
if not os.path.isdir(os.path.join(__path__[0], "kernels")):
    __path__.append(os.path.dirname(__path__[0]))

_HOME = {
    "Actuator": "warp_plate.scene.actuator:Actuator",
    "CheckpointFile": "warp_plate.studies.checkpointing:CheckpointFile",
    "Drive": "warp_plate.scene.drive:Drive",
    "Edges": "warp_plate.effects.edges:Edges",
    "Effects": "warp_plate.effects.table:Effects",
    "Grid": "warp_plate.scene.grid:Grid",
    "Plate": "warp_plate.scene.model:Plate",
    "PlateSolver": "warp_plate.solve.solver:PlateSolver",
    "Record": "warp_plate.scene.model:Record",
    "Result": "warp_plate.result.model:Result",
    "Scene": "warp_plate.scene.model:Scene",
    "SceneError": "warp_plate.scene.errors:SceneError",
    "Search": "warp_plate.scene.search:Search",
    "Target": "warp_plate.scene.target:Target",
    "Window": "warp_plate.scene.model:Window",
    "check": "warp_plate.analysis.check:check",
    "compare": "warp_plate.studies.compare:compare",
    "export": "warp_plate.analysis.export:export",
    "fit": "warp_plate.fitting.fit:fit",
    "focus": "warp_plate.focusing.focus:focus",
    "frf": "warp_plate.studies.frequency_response:compute_frequency_response",
    "load_checkpoint": "warp_plate.result.checkpoint:load_checkpoint",
    "load_comparison": "warp_plate.result.comparison:load_comparison",
    "load_focus": "warp_plate.result.focus:load_focus",
    "load_result": "warp_plate.result.model:load_result",
    "load_sweep": "warp_plate.result.sweep:load_sweep",
    "localize": "warp_plate.studies.localize:localize",
    "measure_accuracy": "warp_plate.accuracy.report:measure_configurations",
    "measure_effects": "warp_plate.analysis.influence:measure_influence",
    "modes": "warp_plate.modal.continuous_modes:modes",
    "motion": "warp_plate.analysis.motion:motion",
    "plan_measurement": "warp_plate.fitting.plan_measurement:plan_measurement",
    "plot": "warp_plate.notebook:plot",
    "render": "warp_plate.notebook:render",
    "resume": "warp_plate.studies.localize:resume",
    "save_comparison": "warp_plate.result.comparison:save_comparison",
    "save_focus": "warp_plate.result.focus:save_focus",
    "save_result": "warp_plate.result.model:save_result",
    "save_sweep": "warp_plate.result.sweep:save_sweep",
    "simulate": "warp_plate.studies.simulate:simulate",
    "sweep": "warp_plate.studies.sweep:sweep",
    "verify": "warp_plate.studies.verify:verify",
    "view": "warp_plate.notebook:view",
}
__all__ = [
    "Actuator",
    "CheckpointFile",
    "Drive",
    "Edges",
    "Effects",
    "Grid",
    "Plate",
    "PlateSolver",
    "Record",
    "Result",
    "Scene",
    "SceneError",
    "Search",
    "Target",
    "Window",
    "__version__",
    "check",
    "compare",
    "export",
    "fit",
    "focus",
    "frf",
    "load_checkpoint",
    "load_comparison",
    "load_focus",
    "load_result",
    "load_sweep",
    "localize",
    "measure_accuracy",
    "measure_effects",
    "modes",
    "motion",
    "plan_measurement",
    "plot",
    "render",
    "resume",
    "save_comparison",
    "save_focus",
    "save_result",
    "save_sweep",
    "simulate",
    "sweep",
    "verify",
    "view",
]

if TYPE_CHECKING:
    from warp_plate.accuracy.report import measure_configurations as measure_accuracy
    from warp_plate.analysis.check import check
    from warp_plate.analysis.export import export
    from warp_plate.analysis.influence import measure_influence as measure_effects
    from warp_plate.analysis.motion import motion
    from warp_plate.effects.edges import Edges
    from warp_plate.effects.table import Effects
    from warp_plate.fitting.fit import fit
    from warp_plate.fitting.plan_measurement import plan_measurement
    from warp_plate.focusing.focus import focus
    from warp_plate.modal.continuous_modes import modes
    from warp_plate.notebook import plot, render, view
    from warp_plate.result.checkpoint import load_checkpoint
    from warp_plate.result.comparison import load_comparison, save_comparison
    from warp_plate.result.focus import load_focus, save_focus
    from warp_plate.result.model import Result, load_result, save_result
    from warp_plate.result.sweep import load_sweep, save_sweep
    from warp_plate.scene.actuator import Actuator
    from warp_plate.scene.drive import Drive
    from warp_plate.scene.errors import SceneError
    from warp_plate.scene.grid import Grid
    from warp_plate.scene.model import Plate, Record, Scene, Window
    from warp_plate.scene.search import Search
    from warp_plate.scene.target import Target
    from warp_plate.solve.solver import PlateSolver
    from warp_plate.studies.checkpointing import CheckpointFile
    from warp_plate.studies.compare import compare
    from warp_plate.studies.frequency_response import compute_frequency_response as frf
    from warp_plate.studies.localize import localize, resume
    from warp_plate.studies.simulate import simulate
    from warp_plate.studies.sweep import sweep
    from warp_plate.studies.verify import verify
else:

    def __getattr__(name):
        if name not in _HOME:
            raise AttributeError(f"module 'warp_plate' has no attribute {name!r}")
        module, _, attribute = _HOME[name].partition(":")
        return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return __all__


def load_ipython_extension(shell: object) -> None:
    """Show scenes and results as HTML in an IPython shell (the hook of ``%load_ext warp_plate``)."""
    from warp_plate.notebook import register

    register(shell)


if "IPython" in sys.modules and (_shell := sys.modules["IPython"].get_ipython()) is not None:
    load_ipython_extension(_shell)
