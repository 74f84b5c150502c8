"""Exact solutions of simply supported plates as series of sine modes; NumPy float64.

A rectangle a × b, all four sides simply supported, has the modes sin(mπx/a) sin(nπy/b), m, n = 1, 2, ...
Under the load of one mode only that mode moves, and its amplitude q is a damped oscillator's, from rest at t
= 0:

    ρH q̈ + c q̇ + D k⁴ q = Re(Z exp(iωt)),   k² = (mπ/a)² + (nπ/b)²,   q(0) = q̇(0) = 0

    q(t) = Re(Q exp(iωt)) + exp(−γt)·(A cos νt + B sin νt),   Q = Z / (D k⁴ − ρHω² + icω),   γ = c/2ρH,
    ν² = D k⁴/ρH − γ²,   A = −Re Q,   B = (ω Im Q − γ Re Q)/ν
"""

from __future__ import annotations

import math

import numpy as np


def mode_shape(mode: tuple[int, int], size: tuple[float, float], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(y, x) values of sin(mπx/a) sin(nπy/b); mode (m, n), size (a, b) [m], x and y [m]."""
    (m, n), (width, height) = mode, size
    return np.outer(np.sin(n * math.pi * y / height), np.sin(m * math.pi * x / width))


def wavenumber_squared(mode: tuple[int, int], size: tuple[float, float]) -> float:
    """k² [1/m²] of the mode: −∇² of its shape is k² times its shape."""
    (m, n), (width, height) = mode, size
    return (m * math.pi / width) ** 2 + (n * math.pi / height) ** 2


def grid_wavenumber_squared(
    mode: tuple[int, int], size: tuple[float, float], spacing: tuple[float, float]
) -> float:
    """k² [1/m²] of the mode under the five-point Laplacian, (4/h²) sin²(mπh/2a) for each direction."""
    return sum(
        (2 / step * math.sin(order * math.pi * step / (2 * length))) ** 2
        for order, length, step in zip(mode, size, spacing, strict=True)
    )


def mode_amplitude(
    time: np.ndarray,
    stiffness: float,
    surface_density: float,
    viscous: float,
    pressure: complex,
    frequency: float,
) -> np.ndarray:
    """q [m] of the equations above at ``time`` [s], from rest under Re(pressure · exp(iωt)) times the mode.

    Args:
        stiffness: D k⁴ [N/m³]; surface_density: ρH [kg/m²]; viscous: c [N·s/m³]; pressure: Z [N/m²];
        frequency: ω/2π [Hz].

    Raises:
        ValueError: damping so strong that the mode does not vibrate.
    """
    omega = 2 * math.pi * frequency
    gamma = viscous / (2 * surface_density)
    own_squared = stiffness / surface_density - gamma**2
    if own_squared <= 0:
        critical = 2 * math.sqrt(stiffness * surface_density)
        raise ValueError(f"viscous = {viscous:g}: the mode does not vibrate; must be below {critical:g}")
    own = math.sqrt(own_squared)
    steady = pressure / (stiffness - surface_density * omega**2 + 1j * viscous * omega)
    cosine = -steady.real
    sine = (omega * steady.imag - gamma * steady.real) / own
    transient = np.exp(-gamma * time) * (cosine * np.cos(own * time) + sine * np.sin(own * time))
    return (steady * np.exp(1j * omega * time)).real + transient
