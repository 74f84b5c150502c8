"""The plate's section at every node: what bends, stretches and weighs there, with layers and variation in it.

A laminate bends about its own neutral plane: with A, S and J the sums of E, Ez and Ez² over its height, z from the
plate's middle, D = (J − S²/A)/(1 − ν²). Edges of layers cut the nodes' cells into rectangles, each of one laminate.
Across a cut the moment and the curvature along it are the same on both sides, and so a cell that is cut once, across x,
has, with the brackets for means over it by length,

    Cxx = 1/⟨1/Dxx⟩,   Cxy = Cxx ⟨Dxy/Dxx⟩,   Cyy = ⟨Dyy − Dxy²/Dxx⟩ + Cxy²/Cxx

(a laminate of rank one: G. W. Milton, The Theory of Composites, 2002, chapter 9). That is second order wherever the
cut lies. Cells around a layer's corner are cut both ways: first across x and then across y, and the other way about,
and the mean of both. Twist and mass are means by area.

Stretching, after Berger, leaves out of the in-plane energy what is not ½∫ C e² dA, e = e_x + κ e_y with the strains of
the middle plane e_x = U_x + ½u_x² and so on, C = A₁₁ and κ² = A₂₂/A₁₁ its stiffnesses per width (isotropic:
C = A/(1 − ν²), κ = 1; T. Iwinski and J. Nowinski, Arch. Mech. Stos. 9, 1957). Where C varies and κ does not, this is
least when N = C e is the same everywhere; then ∫ e dA = ½∫ u_x² + κu_y² dA, where edges do not move in the plane, gives
N = ½∫ u_x² + κu_y² dA / ∫ dA/C: what counts is the harmonic mean of C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.plate.variation import factors_at_nodes
from warp_plate.scene.effects import Orthotropic
from warp_plate.scene.model import Scene

# Dxx, Dxy = D1, Dyy of a plate.
Rigidities = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Section:
    """Fields over the nodes, (ny, nx): bend_xx, bend_xy, bend_yy: Mx = bend_xx u_xx + bend_xy u_yy and so on [N·m];
    twist: Dxy, Mxy = 2 Dxy u_xy [N·m]; mass: per area [kg/m²]. stretch: along x and y, harmonic means of what resists
    stretching over the plate [N/m]."""

    bend_xx: np.ndarray
    bend_xy: np.ndarray
    bend_yy: np.ndarray
    twist: np.ndarray
    mass: np.ndarray
    stretch: tuple[float, float]


@dataclass(frozen=True)
class _Laminates:
    """Of every part of every cell: rigidities and twist [N·m], mass per area [kg/m²]; stretch_x, stretch_y: what
    resists stretching [N/m]."""

    rigidities: Rigidities
    twist: np.ndarray
    mass: np.ndarray
    stretch_x: np.ndarray
    stretch_y: np.ndarray


@dataclass(frozen=True)
class _Parts:
    """The cells of the nodes along one axis, cut at the edges of layers.

    middle and length [m] of each part, and its share of its node's cell; node: whose cell; first: of each node's parts.
    """

    middle: np.ndarray
    length: np.ndarray
    share: np.ndarray
    node: np.ndarray
    first: np.ndarray

    def mean(self, values: np.ndarray, axis: int) -> np.ndarray:
        """Over each node's cell along the axis."""
        weights = self.share if axis == 1 else self.share[:, None]
        mean: np.ndarray = np.add.reduceat(values * weights, self.first, axis=axis)
        return mean


def make_section(scene: Scene) -> Section:
    """The section of a scene's plate at the nodes of its grid.

    Raises:
        SceneError: see ``variation.factors_at_nodes``.
    """
    plate, (nx, ny), layers = scene.plate, scene.grid.nodes, scene.effects.layers
    along_x = _parts(plate.size[0], nx, [place for layer in layers for place in layer.area[:2]])
    along_y = _parts(plate.size[1], ny, [place for layer in layers for place in layer.area[2:]])
    made = _laminates(scene, along_x, along_y)
    rigidities = made.rigidities
    if layers:
        x_first = _across_y(_across_x(rigidities, along_x), along_y)
        y_first = _across_x(_across_y(rigidities, along_y), along_x)
        xx, xy, yy = ((one + other) / 2 for one, other in zip(x_first, y_first, strict=True))
        rigidities = xx, xy, yy
    twist, mass = (along_y.mean(along_x.mean(values, 1), 0) for values in (made.twist, made.mass))
    soft = [along_y.length @ (1 / stretch) @ along_x.length for stretch in (made.stretch_x, made.stretch_y)]
    area = plate.size[0] * plate.size[1]
    return Section(*rigidities, twist, mass, (float(area / soft[0]), float(area / soft[1])))


def _parts(length: float, nodes: int, cuts: list[float]) -> _Parts:
    half = length / (nodes - 1) / 2
    ends = np.concatenate([[0.0], np.linspace(half, length - half, nodes - 1), [length]])
    lines = np.unique(np.concatenate([ends, np.clip(cuts, 0, length)]))
    middle = (lines[1:] + lines[:-1]) / 2
    node = np.clip(np.searchsorted(ends, middle) - 1, 0, nodes - 1)
    share = np.diff(lines) / np.diff(ends)[node]
    return _Parts(middle, np.diff(lines), share, node, np.searchsorted(node, np.arange(nodes)))


def _laminates(scene: Scene, along_x: _Parts, along_y: _Parts) -> _Laminates:
    plate, own, ratio = scene.plate, scene.effects.orthotropic, scene.plate.poisson_ratio
    at_parts = np.ix_(along_y.node, along_x.node)
    factors = {key: values[at_parts] for key, values in factors_at_nodes(scene).items()}
    thickness = plate.thickness * factors["thickness"]
    stretch = plate.young_modulus * factors["young_modulus"] * thickness
    plate_alone = stretch
    first, second = np.zeros_like(stretch), stretch * thickness**2 / 12  # moments of E about the plate's middle
    mass = plate.density * factors["density"] * thickness
    bare = second / (1 - ratio**2)
    top = {1: thickness / 2, -1: thickness / 2}
    for layer in scene.effects.layers:
        x0, x1, y0, y1 = layer.area
        covered = np.outer((along_y.middle > y0) & (along_y.middle < y1), (along_x.middle > x0) & (along_x.middle < x1))
        height = covered * layer.thickness
        for face in (1, -1) if layer.both else (1,):
            middle, pull = top[face] + height / 2, layer.young_modulus * height
            stretch = stretch + pull
            first = first + face * pull * middle
            second = second + pull * (height**2 / 12 + middle**2)
            mass = mass + layer.density * height
            top[face] = top[face] + height
    added = (second - first**2 / stretch) / (1 - ratio**2) - bare
    # What the plate's own rigidities are multiplied by.
    stiffer = factors["young_modulus"] * factors["thickness"] ** 3
    if own is None:
        rigidity = plate.young_modulus * plate.thickness**3 / 12 / (1 - ratio**2)
        own = Orthotropic.model_construct(
            Dx=rigidity, Dy=rigidity, D1=ratio * rigidity, Dxy=(1 - ratio) / 2 * rigidity
        )
    # A sheet of rigidity D and thickness H resists stretching with 12 D/H².
    membrane = 12 * factors["young_modulus"] * factors["thickness"] / plate.thickness**2
    layers = (stretch - plate_alone) / (1 - ratio**2)
    return _Laminates(
        rigidities=(own.Dx * stiffer + added, own.D1 * stiffer + ratio * added, own.Dy * stiffer + added),
        twist=own.Dxy * stiffer + (1 - ratio) / 2 * added,
        mass=mass,
        stretch_x=own.Dx * membrane + layers,
        stretch_y=own.Dy * membrane + layers,
    )


def _across_x(rigidities: Rigidities, parts: _Parts, axis: int = 1) -> Rigidities:
    """Means of the module's docstring over each node's cell along x."""
    xx, xy, yy = rigidities
    soft = 1 / parts.mean(1 / xx, axis)
    coupled = soft * parts.mean(xy / xx, axis)
    return soft, coupled, parts.mean(yy - xy**2 / xx, axis) + coupled**2 / soft


def _across_y(rigidities: Rigidities, parts: _Parts) -> Rigidities:
    """The same along y."""
    yy, xy, xx = _across_x(rigidities[::-1], parts, axis=0)
    return xx, xy, yy
