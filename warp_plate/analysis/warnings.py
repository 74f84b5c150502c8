"""Warnings about missing effects, doubtful numerics, and likely mistakes of units."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_plate.accuracy.configurations import percent
from warp_plate.effects.effect import Edge, losses
from warp_plate.effects.layers import film
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.outline.outline import Outline, shared_areas
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import carrier_frequencies, highest_frequency
from warp_plate.plate.waveforms import read_samples
from warp_plate.plate.weights import region_weights
from warp_plate.scene.drive import SampledSignal
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Displacement over thickness. By Berger's equation for a supported square, stretching raises the frequency of a motion
# of amplitude a by 0.56 (a/H)² (Berger 1955, Wah 1963): 2 % at 0.2.
MOST_AMPLITUDE = 0.2
# Wavelength over thickness. Rotary inertia and shear, which Kirchhoff and Love neglect, lower the squared frequency of
# a wave of number k by (kH)²/12 · (1 + 2/((1 − ν)κ)), κ = 5/6, to first order (Mindlin 1951): 7 % of the frequency at
# 10 thicknesses, with ν = 0.3.
FEWEST_THICKNESSES = 10.0
# Grid points a wavelength, by order. The frequency of a wave on the grid is too low by (kh)²/12 for second order and
# (kh)⁴/90 for fourth (Taylor series of the squared second difference): 3 % at 10 points, 1.3 % at 6.
FEWEST_POINTS = {2: 10.0, 4: 6.0}
# Grid points a wavelength below which no grid holds the wave (Nyquist).
NYQUIST = 2.0
# Mass of layers over that of the plate. By Rayleigh's quotient it lowers frequencies by half of it: 2.5 %, about the
# half width of a resonance with a loss factor of 5 %.
MOST_ADDED_MASS = 0.05
# Fraction of the start-up motion that is left when the window opens. It beats with the steady motion, so that averaged
# energies are wrong by about 1 %.
MOST_LEFT = 0.01
# Highest frequency of a signal's file over drive.frequency, which bounds the time step and the numbers above.
MOST_BEYOND = 1.2
# Highest grid.modal_density that is advised, and periods of the drive in a soft start.
MOST_DENSITY, RAMP_PERIODS = 4.0, 10.0
# Modes among which the lowest natural frequency is looked for: a free plate has three rigid motions.
MODES = 6
# Shorter side over thickness: ten times that of a foil of 50 µm stretched over 100 mm. Millimetres written as metres
# have a thousand times that of the panel.
MOST_SLENDER = 20000.0
# Phase in turns; a phase within one turn may be meant, beyond it degrees are likely. 2π may be rounded.
MOST_TURNS = 1.001
# Share of the energy in the target over its share of the area.
LEAST_SHARE = 0.01
# Share of an actuator's patch that another covers by rounding.
ROUNDED = 1e-6


@dataclass(frozen=True)
class Finding:
    """A number with its threshold."""

    name: str  # name of the number
    value: float  # dimensionless value; NaN if it does not apply
    threshold: float  # dimensionless threshold
    sentence: str  # explanation; if exceeded, with what to change
    exceeded: bool  # True if the threshold is exceeded and the scene lacks the effect
    at_least: bool = False  # True if the value should be no smaller than the threshold, False if no larger


def find_warnings(scene: Scene, peak_displacement: float | None, gridded: bool = True) -> list[Finding]:
    """Return all numbers of a scene with a grid; ``peak_displacement`` [m] is the largest of a run, if known.

    Those of the grid are left out where it does not count, as where modes are used (``gridded`` = False).

    Raises:
        SceneError: the file of ``[drive.signal]`` cannot be read.
    """
    findings = [] if peak_displacement is None else [_amplitude(scene, peak_displacement)]
    findings.append(_thinness(scene))
    if gridded and scene.modal_only_key is None:
        findings.append(_points(scene))
    judges = (_added_mass, _left_at_start, _slenderness, _above_first_mode, _turns, _overlap)
    findings += [judge(scene) for judge in judges]
    findings += [] if scene.outline is None else [_off_plate(scene, scene.outline)]
    return findings if scene.drive.signal is None else [*findings, _signal(scene, scene.drive.signal)]


def warning_texts(scene: Scene, peak_displacement: float | None, gridded: bool = True) -> list[str]:
    """Return the sentences of the numbers that exceed their thresholds, see :func:`find_warnings`."""
    return [finding.sentence for finding in find_warnings(scene, peak_displacement, gridded) if finding.exceeded]


def target_warnings(scene: Scene, localization_factor: float) -> list[str]:
    """Return a warning if a drive leaves the target, or the whole plate, with hardly any energy."""
    if math.isnan(localization_factor):
        return ["Nothing moves under this drive: are the magnitudes of the actuators 0?"]
    plate, target = region_weights(scene).sum(axis=(1, 2))
    if localization_factor >= LEAST_SHARE * target / plate:
        return []
    return [
        f"There is next to no energy in the target: {localization_factor:.2g} of the plate's, on {target / plate:.2g} "
        "of its area. The motion dies out before it gets there; check the units of plate, effects and drive.frequency."
    ]


def search_warnings(scene: Scene) -> list[str]:
    """Return warnings about results of a search that cannot be built, and about drives that were not searched."""
    search, found = scene.search, []
    if len(scene.targets) > 1 and search.position is not None:
        found.append(
            f"The actuators have different positions for each of the {len(scene.targets)} targets, which one panel "
            "cannot have: take the scene of one target, delete [search.position], and localize again with its "
            "positions."
        )
    others = [name for name in ("frequency", "position", "delay") if getattr(search, name) is not None]
    if others and search.magnitude is None and search.phase is None and len(scene.actuators) > 1:
        found.append(
            f"Magnitudes and phases stayed those of the scene, because only [search.{'], [search.'.join(others)}] is "
            "written: write [search.magnitude] and [search.phase] to search them too."
        )
    return found


def accuracy_warnings(scene: Scene, accuracy: Mapping[str, Any], modes_option: str) -> list[str]:
    """Return a warning if the error of a result, see ``Result.accuracy``, is larger than the one it was to have.

    ``modes_option`` is the option that keeps its command to modes; "" for a result of time steps.
    """
    asked, expected = accuracy.get("asked"), accuracy.get("expected")
    error = accuracy.get("estimate", {}).get("error", expected)
    if asked is None or error is None or not error > asked:
        return []
    means = ["a grid of more nodes"]
    if modes_option:
        density = max(2.0, 1.5 * scene.grid.modal_density)
        means = [f"grid.modal_density = {density:.2g} with {modes_option}"] if density <= MOST_DENSITY else []
    exceeded, lost = _left_at_start(scene).exceeded, losses(scene.terms)
    if exceeded and (lost.viscous or lost.retardation or lost.ratios is not None):
        means.append("a later window.start")
    if exceeded and scene.drive.waveform_key is None:
        ramp = RAMP_PERIODS / min(carrier_frequencies(scene))
        means.append(f"a soft start, drive.ramp = {min(ramp, scene.window.start or ramp):.1g} s")
    advice = f": write {' or '.join(means)}" if means else ""
    return [f"The localization factor has an error of up to {percent(error)}, not {percent(asked)}{advice}."]


def with_one_frequency(scene: Scene) -> Scene:
    """Return the scene with all actuators at the drive's frequency."""
    actuators = tuple(actuator.model_copy(update={"frequency": None}) for actuator in scene.actuators)
    return scene.model_copy(update={"actuators": actuators})


def wavelengths(scene: Scene) -> tuple[float, float]:
    """Return the lengths [m] of bending waves along x and y at the highest frequency, in the plate without layers."""
    isotropic = scene.plate.rigidity
    rigidities = scene.effects.rigidities[::2] if scene.effects.rigidities else (isotropic, isotropic)
    inertia = scene.plate.density * scene.plate.thickness * (2 * math.pi * highest_frequency(scene)) ** 2
    x, y = (2 * math.pi * (bending / inertia) ** 0.25 for bending in rigidities)
    return x, y


def slowest_frequency(scene: Scene) -> float:
    """Return the lowest natural frequency [Hz] above zero of the plate's small motions; 0 if there is none."""
    frequencies = solve_modes(linear_part(scene), highest=0.0, count=MODES).frequencies
    return float(min(frequencies[frequencies > 0], default=0.0))


def explain_missing_energies(scene: Scene, status: str = "its numbers grew beyond all bounds") -> str:
    """Return a sentence about a plate whose status is not "ok", with the likely cause.

    A linear plate cannot grow below the stability limit, which does not include the membrane force of large motion.
    """
    scheme = None if scene.modal_only_key is not None else make_scheme(scene, allow_unstable=True)
    if scheme is not None and not scheme.stable:
        cause = (
            f"the time step of {scheme.time_step:.6g} s is above the stability limit of {scheme.limit:.6g} s; write a "
            "shorter grid.time_step."
        )
    elif scheme is None or not scene.effects.stretches:
        cause = f"check the drive (magnitudes are in {scene.drive_unit}, precision is {scene.grid.precision})."
    else:
        cause = (
            f"stretching stiffened it more than the time step of {scheme.time_step:.3g} s allows; write a shorter "
            "grid.time_step, or drive it less."
        )
    return f"A plate has no energies, {status}: {cause}"


def _finding(
    name: str, value: float, threshold: float, fact: str, advice: str = "", at_least: bool = False, named: bool = False
) -> Finding:
    """Return a number with its threshold; where the scene has ``named`` the effect, it is not exceeded."""
    exceeded = not named and (value < threshold if at_least else value > threshold)
    return Finding(name, value, threshold, f"{fact}: {advice}" if exceeded else f"{fact}.", exceeded, at_least)


def _amplitude(scene: Scene, peak: float) -> Finding:
    name, value, most = "displacement / thickness", peak / scene.plate.thickness, MOST_AMPLITUDE
    if not math.isfinite(value):
        return Finding(name, value, most, explain_missing_energies(scene), True)
    fact = f"The largest displacement over the run is {value:.2g} of the thickness (threshold {most:g})"
    advice = "stretching matters; name [effects.stretching]."
    return _finding(name, value, most, fact, advice, named=scene.effects.stretches)


def _thinness(scene: Scene) -> Finding:
    value, fewest = min(wavelengths(scene)) / scene.plate.thickness, FEWEST_THICKNESSES
    fact = f"A bending wave of the drive's highest frequency is {value:.3g} thicknesses long (threshold {fewest:g})"
    advice = "rotary inertia and shear, which this program neglects, matter."
    return _finding("wavelength / thickness", value, fewest, fact, advice, at_least=True)


def _points(scene: Scene) -> Finding:
    pairs = zip(wavelengths(scene), scene.plate.size, scene.grid.nodes, strict=True)
    value, fewest = min(wave * (nodes - 1) / side for wave, side, nodes in pairs), FEWEST_POINTS[scene.grid.order]
    fact = f"The grid has {value:.3g} points a bending wave of the drive's highest frequency (threshold {fewest:g})"
    advice = "take more nodes, or ask for an accuracy."
    if value < NYQUIST:
        advice = (
            "no grid holds a wave of fewer than 2 points. plate.size, plate.thickness and areas are in metres, "
            "plate.density in kg/m³, frequencies in Hz; if they are right, take more nodes, or ask for an accuracy."
        )
    return _finding("points a wavelength", value, fewest, fact, advice, at_least=True)


def _added_mass(scene: Scene) -> Finding:
    plate, named, added = scene.plate, bool(scene.layers), 0.0
    for layer in scene.layers or film(scene.actuators):
        added += (2 if layer.both else 1) * layer.patch_area * layer.thickness * layer.density
    value = added / (plate.area * plate.thickness * plate.density)
    subject = "Layers add" if named else "The scene names no layers; a film of 110 µm on each actuator would add"
    fact = f"{subject} {percent(value)} to the plate's mass (threshold {percent(MOST_ADDED_MASS)})"
    advice = "name the bodies of the actuators under [[effects.layers]]."
    if named:
        advice = f"frequencies change by about {percent(value / 2)}, so their thickness and density must be right."
    if value > 1:
        advice = f"the plate itself weighs less; is plate.density = {plate.density:g} kg/m³ meant?"
    return _finding("added mass / plate's mass", value, MOST_ADDED_MASS, fact, advice)


def _left_at_start(scene: Scene) -> Finding:
    """Return the finding about start-up motion, which decays at the rate c/2ρH + τω²/2 + ζω, without attached masses.

    ω is the lowest frequency of the drive, near which the strongest modes lie. The square of a voltage also has a
    constant part; its step at t = 0 excites the lowest modes.
    """
    name, key, lost = "start-up motion left", with_one_frequency(scene).nonperiodic_key, losses(scene.terms)
    if scene.steady:
        fact = f"The motion is the steady one ({scene.steady_key}), without start-up motion"
        return _finding(name, 0.0, MOST_LEFT, fact)
    if key is not None:
        fact = f"The motion does not become steady ({key}), so its start-up motion is not judged"
        return _finding(name, math.nan, MOST_LEFT, fact)
    rate = lost.viscous / (2 * scene.plate.density * scene.plate.thickness)
    if lost.retardation or lost.ratios is not None:
        lowest = min(carrier_frequencies(scene))
        if scene.drive.electrostatic is not None:
            lowest = min(lowest, slowest_frequency(scene))
        rate += lost.retardation * (2 * math.pi * lowest) ** 2 / 2
        rate += float(np.min(lost.ratios)) * 2 * math.pi * lowest if lost.ratios is not None else 0.0
    value = math.exp(-rate * scene.window.start)
    fact = f"When the window opens, {percent(value)} of the start-up motion is left (threshold {percent(MOST_LEFT)})"
    advice = "it never decays; name [effects.damping]."
    if rate > 0:
        start = _rounded_up(-math.log(MOST_LEFT) / rate)
        end = _rounded_up(start + scene.window.end - scene.window.start)
        later = f" and window.end = {end:.3g} s" if start >= scene.window.end else ""
        advice = f"the motion is not steady; start the window later, at window.start = {start:.3g} s{later}."
    return _finding(name, value, MOST_LEFT, fact, advice)


def _rounded_up(value: float) -> float:
    """Return a positive number with three digits that is no smaller."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit) * unit


def _slenderness(scene: Scene) -> Finding:
    value, most = min(scene.plate.size) / scene.plate.thickness, MOST_SLENDER
    fact = f"The plate's shorter side is {value:.3g} times its thickness (threshold {most:g})"
    advice = f"are plate.size and plate.thickness = {scene.plate.thickness:g} both in metres?"
    return _finding("side / thickness", value, most, fact, advice)


def _above_first_mode(scene: Scene) -> Finding:
    """Return the finding about a drive so slow that the plate only follows it.

    The first mode of a clamped plate has waves no longer than 1.33 times its shorter side (4.73 for a strip), and no
    other edges shorten them: only stiffness beside that of bending raises its frequency.
    """
    driven, first, value = highest_frequency(scene), math.nan, math.nan
    springs = any(term.role == "stiffness" and not isinstance(term.place, Edge) for term in scene.terms)
    stiffened = springs or scene.effects.layers or scene.effects.factor_maps
    if scene.effects.travelling is not None:
        fact = "A moving load has no single frequency, so it is not compared with the first natural frequency"
    elif not stiffened and max(wavelengths(scene)) < min(scene.plate.size):
        fact = "The drive's bending waves are shorter than the plate, so it lies above the first natural frequency"
    else:
        try:
            first = slowest_frequency(scene)
            value = driven / first if first else math.nan
            fact = f"The drive's highest frequency is {driven:.4g} Hz, the first natural frequency {first:.4g} Hz"
        except SceneError as error:  # a plate that buckles has none, and may be run with stretching
            fact = f"The first natural frequency is not known: {error}"
    advice = "the plate moves quasi-statically, so that hardly any drive can move one part alone; raise the frequency."
    return _finding("drive's frequency / first natural frequency", value, 1.0, fact, advice, at_least=True)


def _turns(scene: Scene) -> Finding:
    index = max(range(len(scene.actuators)), key=lambda at: abs(scene.actuators[at].phase))
    phase = scene.actuators[index].phase
    value = abs(phase) / (2 * math.pi)
    fact = f"The largest phase, actuators[{index}].phase = {phase:g} rad, is {value:.3g} turns (threshold 1)"
    advice = f"phases are in radians; {phase:g}° are {math.radians(phase):.4g} rad."
    return _finding("phase / turn", value, MOST_TURNS, fact, advice)


def _overlap(scene: Scene) -> Finding:
    """Return the finding about the largest share of a patch that another one covers."""
    patches = [actuator.flattened() for actuator in scene.actuators]
    shared = shared_areas(patches, patches)
    shares = np.triu(shared / np.minimum.outer(np.diag(shared), np.diag(shared)), k=1)
    value, fact = float(shares.max()), "No two actuators overlap"
    if value > ROUNDED:
        first, second = (scene.actuators[at].name for at in np.unravel_index(shares.argmax(), shares.shape))
        fact = f'Actuators "{first}" and "{second}" overlap by {percent(value)}'
    advice = "their pressures add there, but two bodies cannot be in one place; move one."
    return _finding("overlap of actuators", value, ROUNDED, fact, advice)


def _off_plate(scene: Scene, outline: Outline) -> Finding:
    """Return the finding about the largest part of a patch that is off the plate."""
    parts = [1 - outline.share(actuator.flattened()) for actuator in scene.actuators]
    value, name = max(parts), scene.actuators[int(np.argmax(parts))].name
    fact = (
        f'Of actuator "{name}" {percent(value)} reach over the outline' if value > ROUNDED else "None reaches over it"
    )
    return _finding("actuator off the plate", value, ROUNDED, fact, "what lies outside does not press.")


def _signal(scene: Scene, signal: SampledSignal) -> Finding:
    stated = scene.drive.frequency
    highest = read_samples(signal, scene.folder, len(scene.actuators)).highest_frequency()
    fact = (
        f"99 % of the energy in {signal.file!r} lies below {highest:.4g} Hz, and drive.frequency is {stated:g} Hz "
        f"(threshold {MOST_BEYOND:g} times that)"
    )
    advice = "the time step and grid may be too coarse; raise drive.frequency."
    return _finding("file's frequency / drive.frequency", highest / stated, MOST_BEYOND, fact, advice)
