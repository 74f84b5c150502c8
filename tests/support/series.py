"""Exact solutions of simply supported plates as series of sine modes; NumPy float64.

A rectangle a × b, all four sides simply supported, has the modes sin(mπx/a) sin(nπy/b), m, n = 1, 2, ...
Under the load of one mode only that mode moves, and its amplitude q is a damped oscillator's, from rest at t = 0:

    ρH q̈ + c q̇ + D k⁴ q = Re(Z exp(iωt)),   k² = (mπ/a)² + (nπ/b)²,   q(0) = q̇(0) = 0

    q(t) = Re(Q exp(iωt)) + exp(−γt)·(A cos νt + B sin νt),   Q = Z / (D k⁴ − ρHω² + icω),   γ = c/2ρH,
    ν² = D k⁴/ρH − γ²,   A = −Re Q,   B = (ω Im Q − γ Re Q)/ν

with cosh and sinh for cos and sin where damping is stronger than critical, ν² < 0. A patch x0 ... x1, y0 ... y1
that presses with Re(p exp(iωt)) loads the mode with

    Z = 4p/ab · ∫ sin(mπx/a) dx ∫ sin(nπy/b) dy,   |Z| ≤ 16|p| / (π²mn),

and the plate's motion is the sum over all modes (Navier's series). Here it is cut off at m, n ≤ terms.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# A span of time in which the fastest v² turns by PANEL_TURN [rad] takes PANEL_POINTS of Gauss's points: exact to
# rounding.
PANEL_TURN, PANEL_POINTS = 16.0, 16


class ThinPlate(NamedTuple):
    """A Kirchhoff-Love plate with simply supported edges, ρH ü + c u̇ + D∇⁴u = f."""

    size: tuple[float, float]  # [m]
    rigidity: float  # D [N·m]
    surface_density: float  # ρH [kg/m²]
    viscous: float  # c [N·s/m³]


def mode_shape(mode: tuple[int, int], size: tuple[float, float], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (y, x) values of sin(mπx/a) sin(nπy/b); mode (m, n), size (a, b) [m], x and y [m]."""
    (m, n), (width, height) = mode, size
    return np.outer(np.sin(n * math.pi * y / height), np.sin(m * math.pi * x / width))


def wavenumber_squared(mode: tuple[int, int], size: tuple[float, float]) -> float:
    """Return k² [1/m²] of the mode: −∇² of its shape is k² times its shape."""
    (m, n), (width, height) = mode, size
    return (m * math.pi / width) ** 2 + (n * math.pi / height) ** 2


def grid_wavenumber_squared(mode: tuple[int, int], size: tuple[float, float], spacing: tuple[float, float]) -> float:
    """Return k² [1/m²] of the mode under the five-point Laplacian: (4/h²) sin²(mπh/2a) for each direction."""
    return sum(
        (2 / step * math.sin(order * math.pi * step / (2 * length))) ** 2
        for order, length, step in zip(mode, size, spacing, strict=True)
    )


def damped_motion(
    time: np.ndarray,
    stiffness: float | np.ndarray,
    surface_density: float,
    viscous: float,
    pressure: complex | np.ndarray,
    frequency: float,
    derivative: int = 0,
) -> np.ndarray:
    """Return q [m], or its ``derivative`` q̇ [m/s], of the equations above at t [s], for D k⁴ [N/m³], ρH [kg/m²],
    c [N·s/m³], Z [N/m²] and ω/2π [Hz]; times, stiffnesses and pressures are broadcast."""
    omega = 2 * math.pi * frequency
    gamma = viscous / (2 * surface_density)
    squared = np.asarray(stiffness) / surface_density - gamma**2
    steady = pressure / (stiffness - surface_density * omega**2 + 1j * viscous * omega)
    start, speed = -steady.real, omega * steady.imag - gamma * steady.real  # A and νB
    if derivative:
        steady, start, speed = 1j * omega * steady, speed - gamma * start, -gamma * speed - squared * start
    cosine, sine = _decays(np.asarray(time), squared, gamma)
    return np.asarray((steady * np.exp(1j * omega * time)).real + start * cosine + speed * sine)


def _decays(time: np.ndarray, squared: np.ndarray, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return exp(−γt) cos νt and exp(−γt) sin(νt)/ν [s] for ν² [1/s²]."""
    rate = np.sqrt(-squared + 0j)
    slow, turn = np.exp((rate - gamma) * time), -2 * rate * time
    ratio = np.where(turn == 0, 1, np.expm1(turn) / np.where(turn == 0, 1, turn))
    return (slow * (1 + np.exp(turn)) / 2).real, (slow * time * ratio).real


def patch_pressures(scene: Scene, drive: np.ndarray, terms: int) -> np.ndarray:
    """Return (terms, terms) Z [N/m²] of the modes, n by row and m by column, under phasors (actuators,) of the scene.

    ∇² of a mode is −k² times it, which makes a piezo patch of moment M press as M k² on its area.
    """
    (width, height), orders = scene.plate.size, np.arange(1, terms + 1)
    pressures = np.zeros((terms, terms), dtype=complex)
    squares = np.add.outer((orders * math.pi / height) ** 2, (orders * math.pi / width) ** 2)
    units = [moment * squares for moment in scene.piezo_moments] if scene.piezo else [1.0] * len(scene.actuators)
    for phasor, unit, actuator in zip(drive, units, scene.actuators, strict=True):
        x0, x1, y0, y1 = actuator.area
        along = _sine_integral(orders * math.pi / width, x0, x1)
        across = _sine_integral(orders * math.pi / height, y0, y1)
        pressures += 4 * phasor / (width * height) * unit * np.outer(across, along)
    return pressures


def displacement(
    scene: Scene,
    drive: np.ndarray,
    times: Sequence[float],
    x: np.ndarray,
    y: np.ndarray,
    terms: int = 100,
    derivative: int = 0,
) -> np.ndarray:
    """Return (times, y, x) displacement [m], or its ``derivative`` [m/s], from rest at t = 0 under phasors (actuators,)
    [N/m²], by ``terms`` modes along each side; SceneError as of :func:`supported_plate`."""
    (width, height), orders = scene.plate.size, np.arange(1, terms + 1) * math.pi
    along, across = np.sin(np.outer(orders / width, x)), np.sin(np.outer(orders / height, y))
    return np.asarray(across.T @ _amplitudes(scene, drive, np.asarray(times), terms, derivative) @ along)


def kinetic_energies(scene: Scene, drive: np.ndarray, terms: int = 32) -> np.ndarray:
    """Return (2,) kinetic energies of plate and rectangular target averaged over the scene's window [J].

    The average over time is exact to rounding for the modes kept; the plate's energy converges from below.
    """
    plate, (width, height), (x0, x1, y0, y1) = supported_plate(scene), scene.plate.size, scene.target.area
    along, across = _sine_products(width, x0, x1, terms), _sine_products(height, y0, y1, terms)
    fastest = math.sqrt(plate.rigidity / plate.surface_density) * wavenumber_squared((terms, terms), plate.size)
    start, end = scene.window.start, scene.window.end
    turn = 2 * max(fastest, scene.drive.angular_frequency) * (end - start)
    panels, sums = np.linspace(start, end, max(1, math.ceil(turn / PANEL_TURN)) + 1), np.zeros(2)
    s, weights = legendre.leggauss(PANEL_POINTS)
    for low, high in pairwise(panels):
        rates = _amplitudes(scene, drive, low + (s + 1) / 2 * (high - low), terms, derivative=1)
        products = np.stack([width * height / 4 * rates, across @ rates @ along])
        sums += np.einsum("rtnm,tnm,t->r", products, rates, weights / 2) / (len(panels) - 1)
    return 0.5 * plate.surface_density * sums


def supported_plate(scene: Scene) -> ThinPlate:
    """Return the plate of a scene; SceneError: an edge, an effect or the drive has no sine series."""
    edges = [edge for _, edge in scene.edges]
    if set(map(str, edges)) != {"supported"}:
        raise SceneError(f"edges = {edges}: the sine series needs all four supported")
    for effect, table in scene.effects:
        if effect != "damping" and table:
            raise SceneError(f"effects.{effect}: the sine series knows viscous damping and no other effect")
    if scene.nonharmonic_key is not None:
        raise SceneError(f"{scene.nonharmonic_key}: the sine series knows one frequency from t = 0 on")
    plate, damping = scene.plate, scene.effects.damping
    return ThinPlate(
        size=plate.size,
        rigidity=plate.rigidity,
        surface_density=plate.density * plate.thickness,
        viscous=damping.viscous if damping else 0.0,
    )


def _amplitudes(scene: Scene, drive: np.ndarray, times: np.ndarray, terms: int, derivative: int) -> np.ndarray:
    """Return (times, terms, terms) q [m] or q̇ [m/s] of the modes, n by row and m by column."""
    plate, orders = supported_plate(scene), np.arange(1, terms + 1)
    squared = (orders * math.pi / plate.size[0]) ** 2 + (orders[:, None] * math.pi / plate.size[1]) ** 2
    return damped_motion(
        np.asarray(times, dtype=float)[:, None, None],
        plate.rigidity * squared**2,
        plate.surface_density,
        plate.viscous,
        patch_pressures(scene, drive, terms),
        scene.drive.frequency,
        derivative,
    )


def _sine_integral(wavenumber: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return ∫ sin(kx) dx from low to high, as a product that does not cancel on a narrow patch."""
    middle, half = (low + high) / 2, (high - low) / 2
    return np.asarray(2 / wavenumber * np.sin(wavenumber * middle) * np.sin(wavenumber * half))


def _sine_products(length: float, low: float, high: float, terms: int) -> np.ndarray:
    """Return (terms, terms) ∫ sin(kx) sin(lx) dx from low to high, k and l = π/length, 2π/length, ..."""
    orders = np.arange(1, terms + 1)
    difference, total = orders[:, None] - orders, orders[:, None] + orders
    of_difference, of_total = (_cosine_integral(order, length, low, high) for order in (difference, total))
    return np.asarray((of_difference - of_total) / 2)


def _cosine_integral(order: np.ndarray, length: float, low: float, high: float) -> np.ndarray:
    """Return ∫ cos(order·πx/length) dx from low to high."""
    k = order * math.pi / length
    middle, half = (low + high) / 2, (high - low) / 2
    return np.asarray(2 * half * np.cos(k * middle) * np.sinc(k * half / math.pi))
