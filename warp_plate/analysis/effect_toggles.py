"""Scenes with one effect left out or added with a typical value, and without any effect."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from warp_plate.plate.signals import carrier_frequencies
from warp_plate.plate.weights import REGIONS, region_weights
from warp_plate.scene.drive import Burst, Chirp, Drive, Electrostatic, MovingLoad
from warp_plate.scene.effects import (
    Damping,
    Effects,
    Foundation,
    Layer,
    MaterialDamping,
    Orthotropic,
    Oscillator,
    Stretching,
    Tension,
    Variation,
)
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Area, Edges, ElasticEdge, Scene

# Loss factor at the drive's frequency of both kinds of damping, typical of plastics and glued joints.
LOSS_FACTOR = 0.02
# A film of polyvinylidene fluoride, glued on as an actuator [m], [Pa], [kg/m³].
FILM_THICKNESS, FILM_MODULUS, FILM_DENSITY = 110e-6, 2.5e9, 1780.0
# Tables of the drive, and a second frequency relative to the drive's.
DRIVES, OTHER_FREQUENCY = ("burst", "chirp", "signal", "electrostatic"), 0.9

# Returns the changed scene and a description of the change.
Change = Callable[[Scene], tuple[Scene, str]]


def names() -> list[str]:
    """Return the names of all effects."""
    return ["edges", *Effects.model_fields, "own_frequencies", *DRIVES]


def is_on(scene: Scene, name: str) -> bool:
    """Return whether a scene names an effect or a table of its drive; "edges" if a side is free or on springs."""
    if name == "edges":
        return any(edge not in ("clamped", "supported") for _, edge in scene.edges)
    if name == "own_frequencies":
        return len(carrier_frequencies(scene)) > 1
    value = getattr(scene.drive if name in DRIVES else scene.effects, name)
    return value is not None and value != ()


def bare_scene(scene: Scene) -> Scene:
    """Return the scene without effects: clamped or supported edges, a tone, and a time step that suits them."""
    tables = {"effects": Effects(), "drive": Drive(frequency=scene.drive.frequency)}
    tables["grid"] = scene.grid.model_copy(update={"time_step": None})
    return _with_one_frequency(_clamped(scene)).model_copy(update=tables)


def without(name: str) -> Change:
    """Return the change that leaves an effect out."""
    if name == "edges":
        return lambda scene: (_clamped(scene), "free and elastic edges clamped")
    if name == "own_frequencies":
        return lambda scene: (_with_one_frequency(scene), "all at the drive's frequency")
    empty = None if name in DRIVES else Effects.model_fields[name].default
    return lambda scene: (with_value(scene, name, empty), "left out")


def with_value(scene: Scene, name: str, value: object) -> Scene:
    """Return the scene with another value, which is not checked, of an effect or of a table of the drive."""
    table = "drive" if name in DRIVES else "effects"
    return scene.model_copy(update={table: getattr(scene, table).model_copy(update={name: value})})


def _with_one_frequency(scene: Scene) -> Scene:
    actuators = tuple(actuator.model_copy(update={"frequency": None}) for actuator in scene.actuators)
    return scene.model_copy(update={"actuators": actuators})


def _clamped(scene: Scene) -> Scene:
    edges = {side: edge if edge in ("clamped", "supported") else "clamped" for side, edge in scene.edges}
    return scene.model_copy(update={"edges": Edges.model_validate(edges)})


def rigidity(scene: Scene) -> float:
    """Return the bending rigidity EH³/12(1 − ν²) [N·m] of the isotropic plate."""
    plate = scene.plate
    return plate.young_modulus * plate.thickness**3 / (12 * (1 - plate.poisson_ratio**2))


def film(scene: Scene) -> tuple[Layer, ...]:
    """Return a piezoelectric film on one face under each actuator."""
    return tuple(
        Layer(area=actuator.area, thickness=FILM_THICKNESS, young_modulus=FILM_MODULUS, density=FILM_DENSITY)
        for actuator in scene.actuators
    )


def _springs(scene: Scene) -> tuple[Scene, str]:
    side, bending = min(scene.plate.size), rigidity(scene)
    edge = ElasticEdge(translation=1000 * bending / side**3, rotation=10 * bending / side)
    edges = Edges(left=edge, bottom=edge, right=edge, top=edge)
    text = f"all edges on springs of {edge.translation:.2g} N/m² and {edge.rotation:.2g} N"
    return scene.model_copy(update={"edges": edges}), text + " (1000 D/L³ and 10 D/L)"


def _two_frequencies(scene: Scene) -> tuple[Scene, str]:
    if len(scene.actuators) == 1:
        raise SceneError("one actuator has one frequency")
    other, (*rest, last) = OTHER_FREQUENCY * scene.drive.frequency, scene.actuators
    actuators = (*rest, last.model_copy(update={"frequency": other}))
    return scene.model_copy(update={"actuators": actuators}), f"the last actuator at {other:.3g} Hz"


def _damping(scene: Scene) -> tuple[Damping, str]:
    viscous = LOSS_FACTOR * scene.drive_angular_frequency * scene.plate.density * scene.plate.thickness
    return Damping(viscous=viscous), f"{viscous:.2g} N·s/m³ (loss factor {LOSS_FACTOR:g})"


def _material_damping(scene: Scene) -> tuple[MaterialDamping, str]:
    retardation = LOSS_FACTOR / scene.drive_angular_frequency
    text = f"{retardation:.2g} s (loss factor {LOSS_FACTOR:g} at the drive's frequency)"
    return MaterialDamping(time=retardation), text


def _tension(scene: Scene) -> tuple[Tension, str]:
    tension = 0.1 * math.pi**2 * rigidity(scene) / min(scene.plate.size) ** 2
    text = f"{tension:.2g} N/m along x and y (a tenth of π²D/L², the buckling load of a supported strip)"
    return Tension(x=tension, y=tension), text


def _orthotropic(scene: Scene) -> tuple[Orthotropic, str]:
    bending, ratio = rigidity(scene), scene.plate.poisson_ratio
    table = Orthotropic(Dx=1.1 * bending, Dy=bending, D1=ratio * bending, Dxy=(1 - ratio) / 2 * bending)
    return table, "Dx a tenth above that of the isotropic plate"


def _oscillators(scene: Scene) -> tuple[tuple[Oscillator, ...], str]:
    x0, x1, y0, y1 = scene.target.area or _middle_of_target(scene)
    half = min(5e-3, (x1 - x0) / 2, (y1 - y0) / 2)
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    finger = Oscillator(area=(x - half, x + half, y - half, y + half), mass=5e-3, stiffness=500.0, damping=2.0)
    text = "a fingertip in the middle of the target: 5 g, 500 N/m, 2 N·s/m (orders of magnitude of a light touch)"
    return (finger,), text


def _middle_of_target(scene: Scene) -> Area:
    """Return a square of at most a quarter of the target's area around its centroid, on the plate."""
    weights = region_weights(scene)[REGIONS.index("target")]
    (width, height), (nx, ny) = scene.plate.size, scene.grid.nodes
    x = float(weights.sum(axis=0) @ np.linspace(0, width, nx) / weights.sum())
    y = float(weights.sum(axis=1) @ np.linspace(0, height, ny) / weights.sum())
    half = min(math.sqrt(weights.sum() * width * height / (nx - 1) / (ny - 1)) / 4, x, width - x, y, height - y)
    return x - half, x + half, y - half, y + half


def _moving_load(scene: Scene) -> tuple[MovingLoad, str]:
    width, height = scene.plate.size
    speed = width / scene.window.end
    load = MovingLoad(force=1e-3, start=(0.0, height / 2), velocity=(speed, 0.0))
    return load, f"1 mN on a point that crosses the plate along x at {speed:.2g} m/s"


def _burst(scene: Scene) -> tuple[Burst, str]:
    end, ramp = scene.window.end, scene.window.end / 10
    return Burst(duration=end, ramp=ramp), f"over the whole run, with ramps of {ramp:.2g} s"


def _chirp(scene: Scene) -> tuple[Chirp, str]:
    other = OTHER_FREQUENCY * scene.drive.frequency
    text = f"from {scene.drive.frequency:g} to {other:.3g} Hz over the run"
    return Chirp(end_frequency=other, duration=scene.window.end), text


def _electrostatic(scene: Scene) -> tuple[Electrostatic, str]:
    bias = max(abs(actuator.magnitude) for actuator in scene.actuators) or 1.0
    text = f"bias of {bias:.3g}, as large as the voltage, with the same tone"
    return Electrostatic(bias=bias, gain=1 / (2 * bias)), text


# Typical values of the tables under [effects] and [drive], with descriptions.
_TYPICAL_VALUES: dict[str, Callable[[Scene], tuple[object, str]]] = {
    "damping": _damping,
    "material_damping": _material_damping,
    "tension": _tension,
    "foundation": lambda scene: (Foundation(stiffness=1e7), "1e7 N/m³ (10 mm of foam of 0.1 MPa)"),
    "orthotropic": _orthotropic,
    "variation": lambda scene: (Variation(thickness=((0.95, 1.05),)), "thickness from 0.95 at x = 0 to 1.05"),
    "layers": lambda scene: (film(scene), "a piezoelectric film of 110 µm, 2.5 GPa, 1780 kg/m³ on each actuator"),
    "oscillators": _oscillators,
    "stretching": lambda scene: (Stretching(), "named"),
    "moving_load": _moving_load,
    "burst": _burst,
    "chirp": _chirp,
    "electrostatic": _electrostatic,
}


def _adding(name: str) -> Change:
    def change(scene: Scene) -> tuple[Scene, str]:
        value, text = _TYPICAL_VALUES[name](scene)
        return with_value(scene, name, value), text

    return change


# The changes that add an effect with a typical value.
TYPICAL_CHANGES: dict[str, Change] = {"edges": _springs, "own_frequencies": _two_frequencies}
TYPICAL_CHANGES |= {name: _adding(name) for name in _TYPICAL_VALUES}
