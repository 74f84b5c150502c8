"""warp-plate: simulate thousands of thin vibrating panels, and find drives that move only a chosen part.

    >>> from warp_plate import PlateSolver, Scene
    >>> scene = Scene.load("paper")
    >>> run = PlateSolver(scene, "cpu").run([[1, 0, 0, 0], [1, 1, 1, 1]])
    >>> run.energy.shape          # plates, regions
    (2, 2)

The names are listed in ``__init__.pyi`` and imported when they are first used, so that ``warp-plate --help`` stays
quick.
"""

import os
import sys

import lazy_loader

# In a bare checkout the folders `kernels` and `viz` are beside this package, not inside it.
if not os.path.isdir(os.path.join(__path__[0], "kernels")):
    __path__.append(os.path.dirname(__path__[0]))

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def load_ipython_extension(shell: object) -> None:
    """Show scenes and results as HTML in an IPython shell (the hook of ``%load_ext warp_plate``)."""
    from warp_plate.notebook import register

    register(shell)


if "IPython" in sys.modules and (_shell := sys.modules["IPython"].get_ipython()) is not None:
    load_ipython_extension(_shell)
