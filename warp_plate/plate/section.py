"""The section of the plate at every node: rigidities, mass and membrane stiffness, with layers and maps of factors.

A laminate bends about its own neutral plane: with A, S and J the sums of E, Ez and Ez² over its height, z from the
plate's middle, D = (J − S²/A)/(1 − ν²). Edges of layers cut the nodes' cells into rectangles, each of one laminate.
Across a cut the moment and the curvature along it are the same on both sides, and so a cell that is cut once, across x,
has, with the brackets for means over it by length,

    Cxx = 1/⟨1/Dxx⟩,   Cxy = Cxx ⟨D1/Dxx⟩,   Cyy = ⟨Dyy − D1²/Dxx⟩ + Cxy²/Cxx

(a laminate of rank one: G. W. Milton, The Theory of Composites, 2002, chapter 9). That is second order wherever the
cut lies. Cells around a layer's corner are cut both ways: first across x and then across y, and the other way about,
and the mean of both. Twist and mass are means by area.

Berger's approximation of large motion leaves out of the in-plane energy what is not ½∫ C e² dA, e = e_x + κ e_y with
the strains of the middle plane e_x = U_x + ½u_x² and so on, C = A₁₁ and κ² = A₂₂/A₁₁ its stiffnesses per width
(isotropic: C = A/(1 − ν²), κ = 1; T. Iwinski and J. Nowinski, Arch. Mech. Stos. 9, 1957). Where C varies and κ does
not, this is least when N = C e is the same everywhere; then ∫ e dA = ½∫ u_x² + κu_y² dA, where edges do not move in the
plane, gives N = ½∫ u_x² + κu_y² dA / ∫ dA/C: what counts is the harmonic mean of C.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from warp_plate.effects.effect import DISPLACEMENT, attachments
from warp_plate.effects.layers import Layer
from warp_plate.effects.table import FACTOR_MAPS, FACTOR_RANGE
from warp_plate.plate.files import read_table
from warp_plate.plate.weights import covered_cells, node_positions
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.outline import Plate
from warp_plate.scene.target import PlateRegion

# Keys of ``[plate]`` that maps of factors multiply.
VARIED = ("thickness", "young_modulus", "density")
# Dxx, D1, Dyy of a plate.
Rigidities = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Section:
    """Fields over the nodes."""

    bend_xx: np.ndarray  # (ny, nx) Dxx [N·m]: Mx = Dxx u_xx + D1 u_yy
    bend_xy: np.ndarray  # (ny, nx) D1 [N·m]
    bend_yy: np.ndarray  # (ny, nx) Dyy [N·m]
    twist: np.ndarray  # (ny, nx) torsional rigidity Dxy of Mxy = 2 Dxy u_xy [N·m]
    mass: np.ndarray  # (ny, nx) mass per area [kg/m²]
    stretch: tuple[float, float]  # Harmonic means over the plate of the membrane stiffness along x and y [N/m]


class _Parts(NamedTuple):
    """The cells of the nodes along one axis, cut at the edges of layers."""

    middle: np.ndarray  # Middle of each part [m]
    length: np.ndarray  # Length of each part [m]
    share: np.ndarray  # Share of each part in its node's cell
    node: np.ndarray  # Node of each part
    first: np.ndarray  # First part of each node

    def mean(self, values: np.ndarray, axis: int) -> np.ndarray:
        """Return the means over the nodes' cells along an axis."""
        weights = self.share if axis == 1 else self.share[:, None]
        mean: np.ndarray = np.add.reduceat(values * weights, self.first, axis=axis)
        return mean


@dataclass(frozen=True, eq=False)
class Laminate:
    """A plate with its layers and maps of factors, at any point; made by :func:`laminate_of`."""

    plate: Plate
    layers: Sequence[Layer]  # With the bodies of piezo patches
    maps: Mapping[str, np.ndarray]  # Arrays (rows, columns) of factors of VARIED keys
    rigidities: tuple[float, float, float, float]  # Dxx, D1, Dyy and torsional Dxy of the plate alone [N·m]
    masses: Sequence[float]  # Further masses per area [kg/m²]
    loaded: Sequence[PlateRegion]  # Patches on which something stands
    folder: Path | None  # Folder of the masks of targets

    @property
    def size(self) -> tuple[float, float]:
        """Sides of the plate along x and y [m]."""
        return self.plate.size

    @property
    def varied(self) -> bool:
        """True if rectangular layers or maps make the section another one from point to point."""
        return any(layer.area for layer in self.layers) or bool(self.maps)

    @property
    def even_mass(self) -> bool:
        """True if the mass per area without layers of other shapes is the same at all points."""
        return not any(layer.area for layer in self.layers) and set(self.maps) <= {"young_modulus"}

    @property
    def shaped_layers(self) -> list[Layer]:
        """Layers other than rectangles along x and y."""
        return [layer for layer in self.layers if layer.area is None]

    def layer_edges(self, axis: int) -> list[float]:
        """Return the ends of rectangular layers along x (0) or y (1) [m]."""
        return [place for layer in self.layers if layer.area for place in layer.area[2 * axis : 2 * axis + 2]]

    def factors_at(self, x: np.ndarray, y: np.ndarray) -> dict[str, np.ndarray]:
        """Return factors of thickness, young_modulus and density at points (y, x) [m], ones without an array, by name.

        Arrays are interpolated bilinearly and not averaged: one finer than the grid is sampled.
        """
        width, height = self.size
        factors = {key: np.ones((y.size, x.size)) for key in VARIED}
        return factors | {key: bilinear(array, x / width, y / height) for key, array in self.maps.items()}

    def fields(
        self, x: np.ndarray, y: np.ndarray, factors: dict[str, np.ndarray] | None = None, over: Layer | None = None
    ) -> tuple[Rigidities, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return rigidities and twist [N·m], mass [kg/m²] and membrane stiffness [N/m] at points (y, x) [m], with
        rectangular layers and one of another shape, which is ``over`` all of the points; ``factors`` are by default
        those of the maps."""
        factors = self.factors_at(x, y) if factors is None else factors
        plate, ratio = self.plate, self.plate.poisson_ratio
        thickness = plate.thickness * factors["thickness"]
        mass = plate.density * factors["density"] * thickness
        # Factor of the plate's own rigidities.
        stiffer = factors["young_modulus"] * factors["thickness"] ** 3
        bend_xx, bend_xy, bend_yy, twist = (rigidity * stiffer for rigidity in self.rigidities)
        # A sheet of rigidity D and thickness H resists strain with 12 D/H².
        membrane = 12 * factors["young_modulus"] * factors["thickness"] / plate.thickness**2
        along_x, along_y = self.rigidities[0] * membrane, self.rigidities[2] * membrane
        if self.layers:
            added, layers, mass = self._with_layers(x, y, (thickness, factors["young_modulus"], mass), over)
            bend_xx, bend_xy, bend_yy = bend_xx + added, bend_xy + ratio * added, bend_yy + added
            twist, along_x, along_y = twist + (1 - ratio) / 2 * added, along_x + layers, along_y + layers
        for further in self.masses:
            mass = mass + further
        return (bend_xx, bend_xy, bend_yy), twist, mass, (along_x, along_y)

    def _with_layers(
        self, x: np.ndarray, y: np.ndarray, fields: tuple[np.ndarray, np.ndarray, np.ndarray], over: Layer | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the contributions of layers to the rigidity [N·m] and to the membrane stiffness [N/m], and the total
        mass [kg/m²], of a plate with thickness [m], factor of Young's modulus and mass as ``fields`` at points."""
        plate, (thickness, stiffer, mass) = self.plate, fields
        stretch = plate_alone = plate.young_modulus * stiffer * thickness
        first, second = np.zeros_like(stretch), stretch * thickness**2 / 12  # moments of E about the plate's middle
        bare = second / (1 - plate.poisson_ratio**2)
        top = {1: thickness / 2, -1: thickness / 2}
        for layer in self.layers:
            if layer.area is not None:
                x0, x1, y0, y1 = layer.area
                covered = np.outer((y > y0) & (y < y1), (x > x0) & (x < x1))
            elif layer is over:
                covered = np.ones((y.size, x.size), dtype=bool)
            else:
                continue
            height = covered * layer.thickness
            for face in (1, -1) if layer.both else (1,):
                middle, stiffness = top[face] + height / 2, layer.young_modulus * height
                stretch = stretch + stiffness
                first = first + face * stiffness * middle
                second = second + stiffness * (height**2 / 12 + middle**2)
                mass = mass + layer.density * height
                top[face] = top[face] + height
        added = (second - first**2 / stretch) / (1 - plate.poisson_ratio**2) - bare
        return added, (stretch - plate_alone) / (1 - plate.poisson_ratio**2), mass


def laminate_of(scene: Scene) -> Laminate:
    """Return the plate of a scene with its layers and maps; SceneError: no such file, or the plate is not thin."""
    plate, terms = scene.plate, scene.terms
    ratio = plate.poisson_ratio
    rigidity = plate.young_modulus * plate.thickness**3 / 12 / (1 - ratio**2)
    isotropic = (rigidity, ratio * rigidity, rigidity, (1 - ratio) / 2 * rigidity)
    of_area = (term for term in terms if term.role == "mass" and term.distributed and term.factors == DISPLACEMENT)
    return Laminate(
        plate=plate,
        layers=scene.layers,
        maps={key: _factors(scene, key, given) for key, given in scene.effects.factor_maps.items()},
        rigidities=scene.effects.rigidities or isotropic,
        masses=[term.coefficient for term in of_area],
        loaded=[attachment.region for attachment in attachments(terms)],
        folder=scene.folder,
    )


def make_section(scene: Scene) -> Section:
    """Return the section of a scene's plate at the nodes of its grid."""
    laminate, plate, (nx, ny) = laminate_of(scene), scene.plate, scene.grid.nodes
    shaped = laminate.shaped_layers
    along_x, along_y = (_parts(plate.size[i], (nx, ny)[i], laminate.layer_edges(i)) for i in (0, 1))
    at_parts = np.ix_(along_y.node, along_x.node)
    factors = {key: values[at_parts] for key, values in laminate.factors_at(*node_positions(scene)).items()}
    sections = [_section(laminate, along_x, along_y, factors, over) for over in (None, *shaped)]
    section = sections[0]
    if len(sections) > 1:
        cell = covered_cells(scene, PlateRegion.model_construct(area=plate.box))
        covered = np.stack([covered_cells(scene, layer) for layer in shaped]) / cell
        shares = np.concatenate([1 - covered.sum(axis=0, keepdims=True), covered])
        section = _mixed(sections, shares, (shares * cell).sum(axis=(1, 2)) / cell.sum())
    stretch_x, stretch_y = (float(plate.area / soft) for soft in section.softness)
    return Section(*section.rigidities, section.twist, section.mass, (stretch_x, stretch_y))


class _Fields(NamedTuple):
    """The section at the nodes, and ∫ dA/C along x and along y."""

    rigidities: Rigidities
    twist: np.ndarray
    mass: np.ndarray
    softness: Sequence[Any]


def _section(
    laminate: Laminate, along_x: _Parts, along_y: _Parts, factors: dict[str, np.ndarray], over: Layer | None
) -> _Fields:
    """Return the section with rectangular layers, and another one over the whole plate."""
    rigidities, twist, mass, stretches = laminate.fields(along_x.middle, along_y.middle, factors, over)
    if laminate.layers:
        x_first = _across_y(_across_x(rigidities, along_x), along_y)
        y_first = _across_x(_across_y(rigidities, along_y), along_x)
        xx, xy, yy = ((first + second) / 2 for first, second in zip(x_first, y_first, strict=True))
        rigidities = xx, xy, yy
    twist, mass = (along_y.mean(along_x.mean(values, 1), 0) for values in (twist, mass))
    return _Fields(rigidities, twist, mass, [along_y.length @ (1 / values) @ along_x.length for values in stretches])


class _Phases(NamedTuple):
    """Parts of the nodes' cells, each of one laminate, whose place in the cell does not count."""

    shares: np.ndarray  # (phases, ny, nx)

    def mean(self, values: np.ndarray, axis: int) -> np.ndarray:
        """Return the means over the nodes' cells of values (phases, ny, nx)."""
        return np.asarray((self.shares * values).sum(axis=0))


def _mixed(sections: Sequence[_Fields], shares: np.ndarray, of_plate: np.ndarray) -> _Fields:
    """Return the section of cells of which ``shares`` (phases, ny, nx) have the sections, and of the plate the parts
    (phases,): the mean of cuts across x and across y, so that errors fall as the first power of the spacing."""
    phases = _Phases(shares)
    xx, xy, yy = (np.stack(fields) for fields in zip(*(section.rigidities for section in sections), strict=True))
    both = zip(_across_x((xx, xy, yy), phases), _across_y((xx, xy, yy), phases), strict=True)
    xx, xy, yy = ((first + second) / 2 for first, second in both)
    twist, mass = (phases.mean(np.stack([getattr(s, name) for s in sections]), 0) for name in ("twist", "mass"))
    return _Fields((xx, xy, yy), twist, mass, of_plate @ [section.softness for section in sections])


def _factors(scene: Scene, key: str, given: Any) -> np.ndarray:
    """Return (rows, columns) factors of a map, read from a file or as written."""
    head = f"{FACTOR_MAPS}.{key}"
    if isinstance(given, str):
        array = read_table(head, given, scene.folder, *FACTOR_RANGE)
        head += f" = {given!r}"
    else:
        array = np.array(given)
    if key == "thickness":
        try:
            scene.plate.check_thin(scene.plate.thickness * array.max())
        except ValueError as error:
            raise SceneError(f"{head}: {error}") from None
    return array


def _parts(length: float, nodes: int, cuts: list[float]) -> _Parts:
    half = length / (nodes - 1) / 2
    ends = np.concatenate([[0.0], np.linspace(half, length - half, nodes - 1), [length]])
    lines = np.unique(np.concatenate([ends, np.clip(cuts, 0, length)]))
    middle = (lines[1:] + lines[:-1]) / 2
    node = np.clip(np.searchsorted(ends, middle) - 1, 0, nodes - 1)
    share = np.diff(lines) / np.diff(ends)[node]
    return _Parts(middle, np.diff(lines), share, node, np.searchsorted(node, np.arange(nodes)))


def _across_x(rigidities: Rigidities, parts: _Parts | _Phases, axis: int = 1) -> Rigidities:
    """Return the means of the module's docstring over each node's cell along x."""
    xx, xy, yy = rigidities
    soft = 1 / parts.mean(1 / xx, axis)
    coupled = soft * parts.mean(xy / xx, axis)
    return soft, coupled, parts.mean(yy - xy**2 / xx, axis) + coupled**2 / soft


def _across_y(rigidities: Rigidities, parts: _Parts | _Phases) -> Rigidities:
    """Return the same means along y."""
    yy, xy, xx = _across_x(rigidities[::-1], parts, axis=0)
    return xx, xy, yy


def bilinear(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (y, x) values between those of an array (rows, columns), at shares x and y of its sides."""

    def between_rows(values: np.ndarray, share: np.ndarray) -> np.ndarray:
        where = share * (len(values) - 1)
        low = np.minimum(where.astype(int), max(len(values) - 2, 0))
        high, part = np.minimum(low + 1, len(values) - 1), (where - low)[:, None]
        return np.asarray((1 - part) * values[low] + part * values[high])

    return between_rows(between_rows(values, y).T, x).T
