"""About how many functions and modes a scene's plate takes, and how long, known before anything is computed."""

import math
from dataclasses import dataclass

from warp_plate.effects.effect import attachments
from warp_plate.modal.eigenproblem import SPARSE
from warp_plate.modal.modes import FURTHER, REACH
from warp_plate.modal.poles import COUPLED
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.knots import intervals_for, outline_splines
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.plate.section import laminate_of
from warp_plate.scene.model import Scene

# Time of a core [s]: of any solution; of each pair of functions, and how many times as long that takes on an outline;
# of the energies of each pair of modes, and again for each so many actuators; and of the poles of COUPLED modes.
LEAST_SECONDS, PAIR_SECONDS, ON_OUTLINE = 0.05, 5e-7, 12.0
ENERGY_SECONDS, ACTUATORS, POLE_SECONDS = 2e-7, 10, 2.0


@dataclass(frozen=True)
class ExpectedModes:
    """Size and time of a solution by modes."""

    functions: float  # functions that solve_modes takes
    modes: float  # modes that it returns
    seconds: float  # time of a core for them and for the responses of all actuators, within a factor of four


def expected_modes(scene: Scene, highest: float, density: float = 1.0) -> ExpectedModes:
    """Return the size and time of modes for responses up to a frequency [Hz]; ``density`` as for ``solve_modes``."""
    finer, laminate, size = scene.grid.modal_density, laminate_of(scene), scene.plate.size
    wave, area = mean_wave_frequency(laminate), scene.plate.area
    sides = intervals_for(size, scene.outline, finer * highest, wave, finer * density, not scene.steady)
    if scene.outline is None:
        space = TensorSplines(scene, sides)
        attached = scene.layers or scene.effects.factor_maps or attachments(scene.terms)
        functions, parities = float(space.unknowns), 1 if attached else len(space.parity_bases())
        pairs = functions**2 / parities
    else:
        splines = (outline_splines(scene, laminate, axis, sides[axis]) for axis in (0, 1))
        functions = math.prod(along.functions for along in splines) * area / math.prod(size)
        pairs = ON_OUTLINE * functions**2
    wanted = 1.1 * math.pi / 4 * area * REACH * finer * highest / wave + FURTHER
    modes = wanted if scene.outline is None and wanted * SPARSE < functions else functions
    energies = ENERGY_SECONDS * modes**2 * (1 + len(scene.actuators) / ACTUATORS)
    poles = 0.0
    if not scene.steady and _may_couple(scene):
        poles = POLE_SECONDS * min(modes / COUPLED, 1.0) ** 3
    return ExpectedModes(functions, modes, LEAST_SECONDS + PAIR_SECONDS * pairs + energies + poles)


def _may_couple(scene: Scene) -> bool:
    """Return whether damping couples the modes: it is not one multiple of the mass or of the whole stiffness."""
    uneven = bool(scene.layers or scene.effects.factor_maps)
    stiff = any(term.role == "stiffness" for term in scene.terms)
    lossy = [term for term in scene.terms if term.role in ("damping", "hysteretic") and term.multiple_of != "modes"]
    return any(term.place or (stiff if term.multiple_of == "bending" else uneven) for term in lossy)
