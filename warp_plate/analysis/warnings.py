"""What a scene calls for but does not name: a number, a threshold and a sentence each."""

from __future__ import annotations

import math
from dataclasses import dataclass

from warp_plate.analysis.effect_toggles import film, rigidity
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.sampled_signal import read_samples
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import carrier_frequencies, highest_frequency
from warp_plate.scene.drive import SampledSignal
from warp_plate.scene.model import Scene

# Peak displacement over thickness. Berger's equation for a supported square, of displacement a sin sin, has the extra
# stiffness 1.5 (a/H)² of the linear one, and so the frequency 1 + 0.56 (a/H)² (Berger 1955, Wah 1963): 2 % at 0.2.
MOST_AMPLITUDE = 0.2
# Wavelength over thickness. Rotary inertia and shear, which Kirchhoff and Love leave out, lower the squared frequency
# of a wave of number k by (kH)²/12 · (1 + 2/((1 − ν)κ)), κ = 5/6, to first order (Mindlin 1951): at 10 wavelengths to
# a thickness, with ν = 0.3, the frequency by 7 %.
FEWEST_THICKNESSES = 10.0
# Grid points a wavelength, by order of the differences. Their frequency of a wave is (kh)²/12 too low for second order
# and (kh)⁴/90 for fourth (Taylor series of the squared second difference): 3 % at 10 points, 1.3 % at 6.
FEWEST_POINTS = {2: 10.0, 4: 6.0}
# Mass of layers over the plate's. By Rayleigh's quotient it lowers frequencies by half of it: 2.5 %, about the half
# width of a resonance with a loss factor of 5 %.
MOST_ADDED_MASS = 0.05
# Part of the start-up motion that is left when the window opens. What it beats with is of the order of the steady
# motion, so that the energies averaged over the window are then wrong by some 1 %.
MOST_LEFT = 0.01
# Highest frequency of a signal's file over drive.frequency, which bounds the time step and the numbers above.
MOST_BEYOND = 1.2
# The lowest natural frequency is looked for on a grid of at most so many nodes a side, which is fine enough for it, and
# among so many modes: of a free plate three are rigid motions.
MOST_SIDE, MODES = 49, 6


@dataclass(frozen=True)
class Finding:
    """name: of the number; value, threshold: both without a unit, the value NaN where it is not judged; sentence: for
    people; exceeded: whether the value is on the wrong side of the threshold and the scene does not name what it calls
    for."""

    name: str
    value: float
    threshold: float
    sentence: str
    exceeded: bool


def find_warnings(scene: Scene, peak_displacement: float | None) -> list[Finding]:
    """All numbers of a scene with a grid, whose largest displacement is ``peak_displacement`` [m], if it is known.

    Raises:
        SceneError: the file of ``[drive.signal]`` cannot be read.
    """
    return [
        *([] if peak_displacement is None else [_amplitude(scene, peak_displacement)]),
        _thinness(scene),
        _points(scene),
        _added_mass(scene),
        _left_at_start(scene),
        *([] if scene.drive.signal is None else [_signal(scene, scene.drive.signal)]),
    ]


def warning_texts(scene: Scene, peak_displacement: float | None) -> list[str]:
    """The sentences of those that are exceeded; ``peak_displacement`` [m]."""
    return [warning.sentence for warning in find_warnings(scene, peak_displacement) if warning.exceeded]


def search_warnings(scene: Scene) -> list[str]:
    """Sentences about what a search finds that cannot be built."""
    if len(scene.targets) < 2 or scene.search.position is None:
        return []
    return [
        f"Each of the {len(scene.targets)} targets gets actuator places of its own, which one panel cannot have: in "
        "the scene found for one of them delete [search.position], and localize it for the drives of its places."
    ]


def wavelengths(scene: Scene) -> tuple[float, float]:
    """Lengths [m] of straight bending waves along x and y at the highest frequency, in the plate without layers."""
    stiff, own = rigidity(scene), scene.effects.orthotropic
    along = (own.Dx, own.Dy) if own else (stiff, stiff)
    inertia = scene.plate.density * scene.plate.thickness * (2 * math.pi * highest_frequency(scene)) ** 2
    x, y = (2 * math.pi * (one / inertia) ** 0.25 for one in along)
    return x, y


def decay_rate(scene: Scene) -> float:
    """Rate [1/s] at which start-up motion dies out: c/2ρH + time·ω²/2, oscillators' left out.

    It is strongest in the modes next to the tones' frequencies, so the lowest of these stands for theirs. The square of
    a voltage has a constant part, too, whose step at t = 0 rings the lowest modes.
    """
    effects = scene.effects
    viscous = effects.damping.viscous if effects.damping else 0.0
    viscous += effects.foundation.damping if effects.foundation else 0.0
    retardation = effects.material_damping.time if effects.material_damping else 0.0
    own = viscous / (2 * scene.plate.density * scene.plate.thickness)
    if not retardation:
        return own
    lowest = min(carrier_frequencies(scene))
    if scene.drive.electrostatic is not None:
        lowest = min(lowest, slowest_frequency(scene))
    return own + retardation * (2 * math.pi * lowest) ** 2 / 2


def slowest_frequency(scene: Scene) -> float:
    """The lowest natural frequency [Hz] that is not zero; 0 where none is."""
    nodes = tuple(min(count, MOST_SIDE) for count in scene.grid.nodes)
    grid = {"nodes": nodes, "load": scene.grid.load, "precision": "float64"}
    found = natural_modes(scene.with_tables(grid=grid), MODES).frequencies
    return float(found[found > 0].min(initial=math.inf)) if (found > 0).any() else 0.0


def _never_steady(scene: Scene) -> str | None:
    """The first table for which the motion never becomes steady, or None."""
    for name in ("burst", "chirp", "signal"):
        if getattr(scene.drive, name) is not None:
            return f"drive.{name}"
    return None if scene.effects.moving_load is None else "effects.moving_load"


def _amplitude(scene: Scene, peak: float) -> Finding:
    value = peak / scene.plate.thickness
    if not math.isfinite(value):
        return Finding("displacement / thickness", value, MOST_AMPLITUDE, explain_missing_energies(scene), True)
    named = scene.effects.stretching is not None
    high = value > MOST_AMPLITUDE
    sentence = f"The largest displacement seen over the run is {value:.2g} of the thickness (threshold "
    sentence += f"{MOST_AMPLITUDE:g}): "
    if named:
        sentence += "stretching is named and in the numbers."
    elif high:
        sentence += "stretching matters; name [effects.stretching]."
    else:
        sentence += "stretching does not matter."
    return Finding("displacement / thickness", value, MOST_AMPLITUDE, sentence, high and not named)


def explain_missing_energies(scene: Scene, status: str = "its numbers grew until they were none") -> str:
    """A sentence about a plate whose status is not "ok", with its likely cause.

    A linear plate cannot grow below the stability limit; the limit leaves out what stretching pulls with.
    """
    scheme = make_scheme(scene, allow_unstable=True)
    sentence = f"A plate has no energies, {status}: "
    if not scheme.stable:
        return sentence + (
            f"the time step of {scheme.time_step:.6g} s is above the stability limit of {scheme.limit:.6g} s; write a "
            "shorter grid.time_step."
        )
    if scene.effects.stretching is None:
        units = f"magnitudes are in {scene.drive_unit}, precision is {scene.grid.precision}"
        return f"{sentence}drive it otherwise ({units})."
    return sentence + (
        f"stretching pulled harder than the time step of {scheme.time_step:.3g} s allows; write a shorter "
        "grid.time_step, or drive it less."
    )


def _thinness(scene: Scene) -> Finding:
    value = min(wavelengths(scene)) / scene.plate.thickness
    low = value < FEWEST_THICKNESSES
    sentence = f"A bending wave of the drive's highest frequency is {value:.3g} thicknesses long (threshold "
    sentence += f"{FEWEST_THICKNESSES:g}): "
    sentence += "rotary inertia and shear, which this program leaves out, matter." if low else "the plate is thin."
    return Finding("wavelength / thickness", value, FEWEST_THICKNESSES, sentence, low)


def _points(scene: Scene) -> Finding:
    pairs = zip(wavelengths(scene), scene.plate.size, scene.grid.nodes, strict=True)
    value = min(wave * (nodes - 1) / side for wave, side, nodes in pairs)
    fewest = FEWEST_POINTS[scene.grid.order]
    low = value < fewest
    sentence = f"The grid has {value:.3g} points a bending wavelength of the drive's highest frequency (threshold "
    sentence += f"{fewest:g}): "
    sentence += "take more nodes, or ask for an accuracy." if low else "it is fine enough."
    return Finding("points a wavelength", value, fewest, sentence, low)


def _added_mass(scene: Scene) -> Finding:
    named = bool(scene.effects.layers)
    layers = scene.effects.layers or film(scene)
    sheets = sum(
        (2 if one.both else 1) * (one.area[1] - one.area[0]) * (one.area[3] - one.area[2]) * one.thickness * one.density
        for one in layers
    )
    plate = scene.plate
    value = sheets / (plate.size[0] * plate.size[1] * plate.thickness * plate.density)
    high = value > MOST_ADDED_MASS
    whose = "Layers add" if named else "The scene names no layers; a film of 110 µm on each actuator would add"
    sentence = f"{whose} {100 * value:.2g} % to the plate's mass (threshold {100 * MOST_ADDED_MASS:g} %): "
    if not high:
        sentence += "frequencies move by little."
    elif named:
        sentence += f"frequencies move by some {50 * value:.2g} %, so the layers' thickness and density must be right."
    else:
        sentence += "name the actuators' bodies under [[effects.layers]]."
    return Finding("added mass / plate's mass", value, MOST_ADDED_MASS, sentence, high)


def _left_at_start(scene: Scene) -> Finding:
    never = _never_steady(scene)
    if never is not None:
        sentence = f"The motion is not meant to be steady ({never}), so what is left of its start is not judged."
        return Finding("start-up motion left", math.nan, MOST_LEFT, sentence, False)
    value = math.exp(-decay_rate(scene) * scene.window.start)
    high = value > MOST_LEFT
    sentence = f"When the window opens, {100 * value:.2g} % of the start-up motion is left (threshold "
    sentence += f"{100 * MOST_LEFT:g} %): "
    sentence += "the motion is not steady; start the window later." if high else "the motion is steady."
    return Finding("start-up motion left", value, MOST_LEFT, sentence, high)


def _signal(scene: Scene, signal: SampledSignal) -> Finding:
    highest, named = read_samples(signal, scene.folder).highest_frequency(), scene.drive.frequency
    value = highest / named
    high = value > MOST_BEYOND
    sentence = f"99 % of the energy in {signal.file!r} lies below {highest:.4g} Hz, and drive.frequency says "
    sentence += f"{named:g} Hz (threshold {MOST_BEYOND:g} times that): "
    sentence += "time step and grid may be too coarse; write drive.frequency higher." if high else "it covers the file."
    return Finding("file's frequency / drive.frequency", value, MOST_BEYOND, sentence, high)
