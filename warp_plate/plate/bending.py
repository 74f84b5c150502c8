"""The plate in moment form: rigidity, mass and springs of every node, from the terms of a scene.

Bending stores ½∫ Dx u_xx² + 2 D1 u_xx u_yy + Dy u_yy² + 4 Dxy u_xy² dA. On the grid, curvatures and moments belong to
nodes and twists to cells, and a node on an edge owns half a cell (a quarter at a corner). There the curvature across
the edge is taken with the neighbour's mirror image as 2(u₁ − u₀)/h². A rotational spring at the edge is in series with
the plate: with a stiffness r per length it adds the compliance 2/(r h) to that of the plate,

    C = (D⁻¹ + diag(2/(rx hx), 2/(ry hy)))⁻¹,

which is D for a clamped edge (r = ∞) and leaves no moment across a supported or free one (r = 0). So the operator comes
from an energy: it is symmetric in the nodes' masses, and never negative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from warp_plate.effects.effect import DISPLACEMENT, IN_PLANE, SLOPE, Attachment, Edge, Joint, Patch, Term, attachments
from warp_plate.plate.coils import MountedCoil, mounted_coils
from warp_plate.plate.outline_grid import OutlineGrid
from warp_plate.plate.section import Section, make_section
from warp_plate.plate.supports import springs_of_supports
from warp_plate.plate.weights import EDGE_LINES, cell_shares, covered_cells, grid_of, moving_nodes, on_plate
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Up to this many unknowns, all buckling loads are computed by a dense solver.
DENSE = 400


@dataclass(frozen=True)
class Bending:
    """Fields of the plate on its grid."""

    spacing: tuple[float, float]  # (hx, hy) [m]
    bend_xx: np.ndarray  # (ny, nx) Cxx above [N·m]
    bend_xy: np.ndarray  # (ny, nx) Cxy above [N·m]
    bend_yy: np.ndarray  # (ny, nx) Cyy above [N·m]
    twist: np.ndarray  # (ny − 1, nx − 1) 4Dxy of the cells [N·m]
    mass: np.ndarray  # (ny, nx) mass per area [kg/m²]
    # (ny, nx) share of each node's cell on the plate, 1, ½ or ¼; raised where supports are
    weight: np.ndarray
    moves: np.ndarray  # (ny, nx) true for nodes that move
    stretch: tuple[float, float]  # Membrane stiffness of the whole plate along x and y [N/m], see ``section``
    # (ny, nx) springs per area [N/m³], by what they belong to
    springs: Mapping[str, np.ndarray] = field(default_factory=dict)
    membrane: tuple[float, float] = (0.0, 0.0)  # In-plane force along x and y [N/m], positive where it pulls
    retardation: float = 0.0  # Retardation time of the bending moments [s]
    attachments: Sequence[Joint] = ()  # Masses, springs and dampers on patches, then springs of supports
    # (attachments, ny, nx) shares of the nodes in the mean displacement of each patch or point
    shares: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    coils: Sequence[MountedCoil] = ()  # Coils on patches
    labels: Mapping[str, str] = field(default_factory=dict)  # Names of ``membrane`` and ``retardation`` in texts
    # Grid of a plate with an outline, where ``weight`` is the area of a node in cells; None for a rectangle
    grid: OutlineGrid | None = None

    @property
    def spring(self) -> np.ndarray:
        """(ny, nx) all springs per area [N/m³]."""
        return sum(self.springs.values(), start=np.zeros_like(self.mass))

    @property
    def patch_shares(self) -> np.ndarray:
        """(attachments, then coils, ny, nx) shares of the nodes in the mean displacement of each patch."""
        return np.concatenate([self.shares.reshape(-1, *self.mass.shape), *(coil.share[None] for coil in self.coils)])

    @property
    def cell(self) -> float:
        """Area of a cell [m²]."""
        return self.spacing[0] * self.spacing[1]

    @property
    def stretch_ratio(self) -> float:
        """κ of ``section``: membrane force of large motion along y over that along x; 1 for an isotropic plate."""
        return math.sqrt(self.stretch[1] / self.stretch[0])

    @property
    def berger(self) -> float:
        """Berger's force along x for ∫ u_x² + κu_y² dA = 1 m² [N/m³]; for an isotropic plate 6D/(H² area)."""
        return self.stretch[0] / (2 * self.cell * float(cell_shares(self.weight.shape).sum()))


def make_bending(scene: Scene) -> Bending:
    """Return the fields of a scene on its grid; SceneError: the grid has no such term, or a file cannot be read."""
    spacing, section = scene.spacing, make_section(scene)
    if (grid := grid_of(scene)) is not None:
        return _with_supports(scene, _outlined(scene, grid, section, spacing))
    bend_xx, bend_xy, bend_yy = _in_series(section, *_edge_compliances(scene, spacing))
    bare = Bending(
        spacing=spacing,
        bend_xx=bend_xx,
        bend_xy=bend_xy,
        bend_yy=bend_yy,
        twist=_of_cells(section.twist),
        mass=section.mass,
        weight=cell_shares(section.mass.shape),
        moves=moving_nodes(scene),
        stretch=section.stretch,
    )
    return _with_supports(scene, _complete(scene, bare))


def _with_supports(scene: Scene, bare: Bending) -> Bending:
    """Return the plate with the springs of its supports, after other attachments, and raised masses."""
    if not scene.supports:
        return bare
    rows, masses = _sums_of_rows(bare), mass_matrix(bare).reshape(bare.mass.shape)
    attached, shares, added = springs_of_supports(scene, bare.moves, rows)
    median = np.median((rows / masses)[bare.moves])
    raised = 1 + added / np.where(bare.moves, np.minimum(rows, masses * median), 1)
    return replace(
        bare,
        weight=bare.weight * raised,
        bend_xx=bare.bend_xx / raised,
        bend_xy=bare.bend_xy / raised,
        bend_yy=bare.bend_yy / raised,
        springs={label: springs / raised for label, springs in bare.springs.items()},
        attachments=[*bare.attachments, *attached],
        shares=np.concatenate([bare.shares, shares]),
    )


def _complete(scene: Scene, bare: Bending) -> Bending:
    """Return the plate with the terms of edges and effects, and what is attached."""
    attached = attachments(scene.terms)
    terms = _with_terms(bare, scene.terms)
    return replace(terms, attachments=attached, shares=_patch_shares(scene, attached), coils=mounted_coils(scene))


def _of_cells(corners: np.ndarray) -> np.ndarray:
    """Return (ny − 1, nx − 1) 4Dxy of the cells from Dxy of the nodes."""
    return corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]


def _outlined(scene: Scene, grid: OutlineGrid, section: Section, spacing: tuple[float, float]) -> Bending:
    """Return the fields of a plate with an outline.

    Masses next to a held piece are raised until no row of K is larger, for its mass, than the largest away from the
    outline, so that the outline does not shorten the time step (Gershgorin's theorem).
    """
    if grid.narrow is not None:
        x, y = grid.narrow
        raise SceneError(f"grid.nodes: the plate is too narrow at x = {x:.4g}, y = {y:.4g} m for these; use more")
    x, y = np.moveaxis(grid.normals, -1, 0)
    mixed = section.bend_xy + 2 * section.twist
    across = section.bend_xx * x**4 + 2 * mixed * (x * y) ** 2 + section.bend_yy * y**4

    bend_xx, bend_yy = section.bend_xx * grid.squares[0], section.bend_yy * grid.squares[1]
    largest = np.sqrt(bend_xx * bend_yy)
    bend_xy = np.clip(section.bend_xy * grid.products, -largest, largest)

    def with_area(area: np.ndarray) -> Bending:
        bare = Bending(
            spacing=spacing,
            bend_xx=bend_xx / area,
            bend_xy=bend_xy / area,
            bend_yy=bend_yy / area,
            twist=_of_cells(section.twist) * grid.twist,
            mass=section.mass,
            weight=area,
            moves=grid.moves,
            stretch=section.stretch,
            springs={"clamped edges": across * grid.strips / area},
            grid=grid,
        )
        return _complete(scene, bare)

    area = np.where(grid.moves, np.maximum(grid.count(np.ones(grid.moves.shape)), 1e-3), 1.0)
    plate = with_area(area)
    per_mass = _sums_of_rows(plate) / (area * section.mass)
    inside = per_mass[grid.deep].max() if grid.deep.any() else math.inf
    return with_area(np.where(grid.held, area * np.maximum(per_mass / inside, 1), area))


def _edge_compliances(scene: Scene, spacing: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return (ny, nx) compliances 2/(r h) along x and y of what holds the slope of the edges."""
    rotations = {side: math.inf if edge == "clamped" else 0.0 for side, edge in scene.edges}
    for term in scene.terms:
        if isinstance(term.place, Edge) and term.factors == SLOPE:
            rotations[term.place.side] += term.coefficient
    compliances = np.zeros((2, *scene.grid.nodes[::-1]))
    for side, line in EDGE_LINES.items():
        axis, rotation = 0 if side in ("left", "right") else 1, rotations[side]
        compliances[axis][line] = 2 / (rotation * spacing[axis]) if rotation > 0 else math.inf
    return compliances[0], compliances[1]


def _with_terms(bare: Bending, terms: Sequence[Term]) -> Bending:
    """Return the plate with the terms of edges and effects."""
    springs: dict[str, np.ndarray] = dict(bare.springs)
    membrane, retardation = [0.0, 0.0], 0.0
    labels: dict[str, list[str]] = {"membrane": [], "retardation": []}
    for term in sorted(terms, key=lambda term: isinstance(term.place, Edge)):
        if _applied_elsewhere(term):
            continue
        if term.role == "stiffness" and term.distributed and term.factors in IN_PLANE:
            membrane[IN_PLANE.index(term.factors)] += term.coefficient
            labels["membrane"].append(term.label)
        elif term.role == "stiffness" and not term.multiple_of and term.factors == DISPLACEMENT:
            field, edge = springs.setdefault(term.label, np.zeros_like(bare.mass)), term.place
            if isinstance(edge, Edge):
                across = bare.spacing[0 if edge.side in ("left", "right") else 1]
                field[EDGE_LINES[edge.side]] += 2 * term.coefficient / across
            else:
                field += term.coefficient
        elif term.role == "damping" and term.multiple_of == "bending":
            retardation += term.coefficient
            labels["retardation"].append(term.label)
        else:
            raise SceneError(
                f"effects: {term.label} has no term on a grid, and so no time steps; take the modal engine"
            )
    return replace(
        bare,
        springs=springs,
        membrane=(membrane[0], membrane[1]),
        retardation=retardation,
        labels={key: " and ".join(dict.fromkeys(names)) for key, names in labels.items() if names},
    )


def _applied_elsewhere(term: Term) -> bool:
    """Return whether ``attachments``, ``_edge_compliances``, ``section.laminates`` (mass per area), ``losses`` (viscous
    damping) or the modal engine (damping that is not stepped, springs along outlines) applies a term."""
    slope_of_edge = term.role == "stiffness" and isinstance(term.place, Edge) and term.factors == SLOPE
    per_area = term.role in ("mass", "damping") and term.distributed and term.factors == DISPLACEMENT
    by_modes = term.role == "hysteretic" or term.multiple_of == "modes"
    along_outline = isinstance(term.place, Edge) and term.place.side not in EDGE_LINES
    return isinstance(term.place, Patch) or slope_of_edge or per_area or by_modes or along_outline


def stiffness_parts(bending: Bending) -> dict[str, scipy.sparse.csr_array]:
    """Return the symmetric matrices [N/m] of all nodes, row by row, edges included, that add up to K, by name: ½uᵀKu is
    the energy stored by "bending", by in-plane forces and by springs."""
    (hx, hy), (ny, nx) = bending.spacing, bending.mass.shape
    curve_x = scipy.sparse.kron(scipy.sparse.eye_array(ny), _mirrored_second_difference(nx)) / hx**2
    curve_y = scipy.sparse.kron(_mirrored_second_difference(ny), scipy.sparse.eye_array(nx)) / hy**2
    cells = scipy.sparse.kron(_difference(ny), _difference(nx)) / (hx * hy)
    weight, in_plane = bending.weight, cell_shares(bending.weight.shape)
    if bending.grid is not None:
        # What ends at the outline in place of the two neighbours; forces in the plane pass whole cells.
        own_x, own_y = (2 - np.ravel(centre) for centre in bending.grid.centres)
        curve_x = curve_x + scipy.sparse.diags_array(own_x / hx**2)
        curve_y = curve_y + scipy.sparse.diags_array(own_y / hy**2)
        in_plane = np.ones_like(weight)

    def diagonal(values: np.ndarray) -> scipy.sparse.dia_array:
        return scipy.sparse.diags_array(np.ravel(values))

    parts = {
        "bending": curve_x.T @ diagonal(weight * bending.bend_xx) @ curve_x
        + curve_x.T @ diagonal(weight * bending.bend_xy) @ curve_y
        + curve_y.T @ diagonal(weight * bending.bend_xy) @ curve_x
        + curve_y.T @ diagonal(weight * bending.bend_yy) @ curve_y
        + cells.T @ diagonal(bending.twist) @ cells
    }
    if any(bending.membrane):
        pull_x, pull_y = bending.membrane
        curved = pull_x * diagonal(in_plane) @ curve_x + pull_y * diagonal(in_plane) @ curve_y
        parts[bending.labels.get("membrane", "membrane")] = -curved
    for label, springs in bending.springs.items():
        if springs.any():
            # An effect may have both in-plane forces and springs, under one name.
            parts[label] = parts.get(label, 0) + diagonal(weight * springs)
    return {label: scipy.sparse.csr_array(hx * hy * part) for label, part in parts.items()}


def stiffness_matrix(bending: Bending) -> scipy.sparse.csr_array:
    """Return K [N/m], the sum of :func:`stiffness_parts`."""
    first, *others = stiffness_parts(bending).values()
    return scipy.sparse.csr_array(sum(others, start=first))


def _sums_of_rows(bending: Bending) -> np.ndarray:
    """Return (ny, nx) Σ|K_ij| [N/m] of each node i."""
    return np.asarray(abs(stiffness_matrix(bending)).sum(axis=1)).reshape(bending.mass.shape)


def system(bending: Bending) -> tuple[scipy.sparse.csr_array, np.ndarray]:
    """Return stiffness [N/m] and masses [kg] of the moving nodes, row by row, then of the attached masses."""
    moves = np.flatnonzero(bending.moves)
    stiffness = stiffness_matrix(bending)[moves][:, moves]
    stiffness = with_attachments(bending, stiffness, [attachment.stiffness for attachment in bending.attachments])
    return stiffness, moving_masses(bending)


def moving_masses(bending: Bending) -> np.ndarray:
    """Return the masses [kg] of the moving nodes, then those of the attached masses."""
    attached = [attachment.mass for attachment in bending.attachments if attachment.mass > 0]
    return np.concatenate([mass_matrix(bending)[bending.moves.ravel()], attached])


def with_attachments(
    bending: Bending, matrix: scipy.sparse.csr_array, values: Sequence[float]
) -> scipy.sparse.csr_array:
    """Return a matrix over the moving nodes with springs or dampers ``values``, see :func:`join_masses`."""
    means = bending.shares.reshape(len(bending.shares), bending.mass.size)[:, np.flatnonzero(bending.moves)]
    return join_masses(matrix, means, bending.attachments, values)


def join_masses(
    matrix: scipy.sparse.csr_array, means: np.ndarray, attached: Sequence[Joint], values: Sequence[float]
) -> scipy.sparse.csr_array:
    """Return a matrix extended by the attached masses: the sum of its form and of Σ value (ū − z)².

    The means ū (attachments, unknowns) of the patches are joined to the motions z of the masses, or to the ground.
    """
    if not attached:
        return matrix
    masses = [index for index, attachment in enumerate(attached) if attachment.mass > 0]
    rows = scipy.sparse.csr_array(np.hstack([means, -np.eye(len(attached))[:, masses]]))
    padded = scipy.sparse.block_diag([matrix, scipy.sparse.csr_array((len(masses), len(masses)))])
    return scipy.sparse.csr_array(padded + rows.T @ (scipy.sparse.diags_array(np.array(values)) @ rows))


def buckling_factor(bending: Bending) -> float:
    """Return the factor by which the in-plane forces can grow until the plate buckles; infinite if they never press:
    the smallest μ with (K₀ + μG)u = 0, K₀ being the stiffness without in-plane forces and G their part of it."""
    moves = np.flatnonzero(bending.moves)
    first, *others = stiffness_parts(replace(bending, membrane=(0.0, 0.0))).values()
    held = scipy.sparse.csr_array(sum(others, start=first))
    in_plane = (stiffness_matrix(bending) - held)[moves][:, moves]
    if abs(in_plane).max() == 0:
        return math.inf
    # The rigid motion of a plate that nothing holds is no buckling: it gets a stiffness of rounding's size.
    held = held[moves][:, moves] + 1e-9 * first.diagonal().max() * scipy.sparse.eye_array(len(moves))
    if len(moves) <= DENSE:
        largest = scipy.linalg.eigh(-in_plane.toarray(), held.toarray(), eigvals_only=True)[-1]
    else:
        # The eigenvalues are shifted by one, so that a relative tolerance suffices for one near zero.
        start = np.random.default_rng(0).normal(size=len(moves))
        largest = scipy.sparse.linalg.eigsh(
            held - in_plane, k=1, M=held.tocsc(), which="LA", v0=start, tol=1e-6, ncv=60, return_eigenvectors=False
        )[0] - 1  # fmt: skip
    return math.inf if largest <= 1e-6 else 1 / float(largest)


def _patch_shares(scene: Scene, attached: Sequence[Attachment]) -> np.ndarray:
    """Return (attachments, ny, nx) shares of the nodes in the mean displacement of each patch."""
    shares = (on_plate(scene, covered_cells(scene, attachment.region)) for attachment in attached)
    return np.array([share / share.sum() for share in shares]).reshape(-1, *scene.grid.nodes[::-1])


def mass_matrix(bending: Bending) -> np.ndarray:
    """Return (nodes,) masses [kg] of all nodes, row by row."""
    masses: np.ndarray = (bending.spacing[0] * bending.spacing[1] * bending.weight * bending.mass).ravel()
    return masses


def _in_series(section: Section, compliance_x: np.ndarray, compliance_y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return Cxx, Cxy, Cyy of the module's docstring; compliances may be infinite."""
    stiff_x, coupling, stiff_y = section.bend_xx, section.bend_xy, section.bend_yy
    determinant = stiff_x * stiff_y - coupling**2
    soft_x, soft_y = stiff_y / determinant + compliance_x, stiff_x / determinant + compliance_y
    mixed = -coupling / determinant
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = soft_x * soft_y - mixed**2
        both = np.isfinite(soft_x) & np.isfinite(soft_y)
        bend_xx = np.where(both, soft_y / whole, np.where(np.isfinite(soft_x), 1 / soft_x, 0.0))
        bend_yy = np.where(both, soft_x / whole, np.where(np.isfinite(soft_y), 1 / soft_y, 0.0))
        bend_xy = np.where(both, -mixed / whole, 0.0)
    return bend_xx, bend_xy, bend_yy


def _mirrored_second_difference(count: int) -> scipy.sparse.csr_array:
    low, high = np.ones(count - 1), np.ones(count - 1)
    low[-1] = high[0] = 2
    return scipy.sparse.csr_array(scipy.sparse.diags_array([low, np.full(count, -2.0), high], offsets=[-1, 0, 1]))


def _difference(count: int) -> scipy.sparse.csr_array:
    sides = np.ones(count - 1)
    return scipy.sparse.csr_array(scipy.sparse.diags_array([-sides, sides], offsets=[0, 1], shape=(count - 1, count)))
