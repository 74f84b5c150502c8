"""Galerkin matrices of a scene's plate: its terms over a function space.

With u = Σ q_i ψ_i(x, y), the energies of the plate, its edges and what is attached to it are quadratic forms:

    T = ½ ∫ ρH u̇² dA + Σ ½ m ż²                                                          mass M
    U = ½ ∫ Dx u_xx² + 2 D1 u_xx u_yy + Dy u_yy² + 4 Dxy u_xy² dA                          bending B, part of K
      + ½ ∫ Tx u_x² + Ty u_y² + k u² dA + ½ ∮ k u² + r u_n² ds + Σ ½ s (ū − z)²            stiffness K
    F = ½ ∫ c u̇² dA + Σ ½ d (ū̇ − ż)² + τ B                                               viscous damping C

in which ū is the mean displacement of a patch and z that of the mass on it. The functions themselves must vanish on
supported and clamped edges, and their slopes across clamped ones; conditions on moments and forces follow from the
energies (A. W. Leissa, J. Sound Vib. 31, 1973, pp. 257-293).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from warp_plate.effects.effect import DISPLACEMENT, Attachment, Edge, Factors, Losses, Patch, Role, attachments, losses
from warp_plate.modal.spaces.space import FunctionSpace, Matrix
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.modal.spaces.trimmed_splines import TrimmedSplines
from warp_plate.plate.bending import join_masses
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion, Target

# Largest stiffness of an attached spring, relative to the largest entry of the plate's own stiffness, which rounding
# would hide beside a stiffer one. A spring of a thousandth of this already acts as a rigid one.
STIFFEST = 1e10
# Step of the difference quotients by the places of actuators that are no rectangles, as a part of the longer side.
DIFFERENCE = 1e-5


@dataclass(frozen=True)
class Galerkin:
    """Matrices over the functions of a space, then over the attached masses."""

    scene: Scene  # Scene
    space: FunctionSpace  # Functions on the plate
    mass: Matrix  # M [kg]
    bending: Matrix  # B, the stiffness of the plate without edges and effects [N/m]
    support: Matrix  # K − B, of edges and effects [N/m]
    damping: Matrix  # C [N·s/m] but for τB, the damping of the material
    attachments: Sequence[Attachment]  # Springs, dampers and masses on patches

    @cached_property
    def stiffness(self) -> Matrix:
        """K [N/m]."""
        return self.bending + self.support

    @cached_property
    def losses(self) -> Losses:
        """Damping of the whole plate by kind."""
        return losses(self.scene.terms)

    @cached_property
    def masses(self) -> list[Attachment]:
        """Attachments that have a mass, in the order of their unknowns."""
        return [attachment for attachment in self.attachments if attachment.mass > 0]

    def region_matrix(self, region: Area | Target, within: Area | None = None) -> Matrix:
        """Return the mass matrix [kg] of a region, without attached masses but of the same size as ``mass``."""
        matrix = self.space.region_matrix(region, within)
        matrix.resize(self.mass.shape)
        return matrix


def make_space(scene: Scene, intervals: tuple[int, int]) -> FunctionSpace:
    """Return the function space of a scene's plate, with about a number of intervals along x and along y."""
    return TensorSplines(scene, intervals) if scene.outline is None else TrimmedSplines(scene, intervals)


def make_galerkin(scene: Scene, space: FunctionSpace) -> Galerkin:
    """Return the matrices of a scene over a space; SceneError: no such file, or an attached spring is too stiff."""
    first, *others = (space.form(term.coefficient, term.factors) for term in space.bending_terms())
    bending = np.asarray(sum(others, start=first))
    support, damping, inertia = (_forms(scene, space, role) for role in ("stiffness", "damping", "mass"))
    attached = attachments(scene.terms)
    masses = [attachment.mass for attachment in attached if attachment.mass > 0]
    means = patch_means(space, [attachment.region for attachment in attached])
    _check_springs(scene, attached, means, float(bending.max()))
    mass = space.mass_matrix()
    if inertia.any():
        mass = Matrix(mass + space.scatter(inertia))
    return Galerkin(
        scene=scene,
        space=space,
        mass=_with_masses(mass, masses),
        bending=_with_masses(space.scatter(bending), np.zeros(len(masses))),
        support=_with_links(space, attached, means, support, "stiffness"),
        damping=_with_links(space, attached, means, damping, "damping"),
        attachments=attached,
    )


def _forms(scene: Scene, space: FunctionSpace, role: Role) -> np.ndarray:
    """Return the sum of the forms of the terms with a role, but for bending, patches and the mass per area."""
    area = space.form(1.0)
    total, springs = 0 * area, dict[Edge, dict[Factors, float]]()
    for term in scene.terms:
        if term.role != role or isinstance(term.place, Patch):
            continue
        if isinstance(term.place, Edge):
            coefficients = springs.setdefault(term.place, {})
            coefficients[term.factors] = coefficients.get(term.factors, 0.0) + term.coefficient
        elif term.distributed and term.factors != DISPLACEMENT:
            total += space.form(term.coefficient, term.factors)
        elif term.distributed and role != "mass":  # ``space.mass_matrix`` has the mass per area, with that of terms
            total += term.coefficient * area
    for edge, coefficients in springs.items():
        total += space.edge_form(edge.side, coefficients)
    return total


def load_integrals(galerkin: Galerkin, areas: np.ndarray) -> np.ndarray:
    """Return (rectangles, unknowns of the plate) loads of unit drives of the scene's actuators in rectangles
    (..., actuators, 4) x0, x1, y0, y1 [m]."""
    if not rectangular(galerkin.scene):
        return galerkin.space.region_integrals(_placed(galerkin.scene, areas))
    if not galerkin.scene.piezo:
        return galerkin.space.patch_integrals(areas)
    rectangles = np.asarray(areas, dtype=float).reshape(-1, 4)
    moments = np.resize(galerkin.scene.piezo_moments, len(rectangles))
    return -moments[:, None] * galerkin.space.curvature_integrals(rectangles)


def unit_loads(galerkin: Galerkin) -> np.ndarray:
    """Return (unknowns of the plate, actuators) loads of unit drives, and of 1 N on the patches of coils."""
    scene, space = galerkin.scene, galerkin.space
    loads = load_integrals(galerkin, np.array([actuator.box for actuator in scene.actuators])).T
    if scene.coil_indices:
        loads[:, scene.coil_indices] = patch_means(space, [scene.actuators[index] for index in scene.coil_indices]).T
    return loads


def load_slopes(galerkin: Galerkin, areas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives (rectangles, unknowns of the plate) of :func:`load_integrals` by x and by y of the places."""
    if rectangular(galerkin.scene):
        return galerkin.space.patch_slopes(areas)
    step, slopes = DIFFERENCE * max(galerkin.scene.plate.size), []
    for shift in np.array([(1, 1, 0, 0), (0, 0, 1, 1)]) * step:
        ahead, behind = (load_integrals(galerkin, areas + sign * shift) for sign in (1, -1))
        slopes.append((ahead - behind) / (2 * step))
    return slopes[0], slopes[1]


def rectangular(scene: Scene) -> bool:
    """Return whether all actuators but coils, which stay in their places, are rectangles with sides along x and y."""
    return all(actuator.area is not None or actuator.kind == "coil" for actuator in scene.actuators)


def _placed(scene: Scene, areas: np.ndarray) -> list[PlateRegion]:
    """Return the actuators' regions with their bounding boxes in places (..., actuators, 4) [m]."""
    boxes = np.asarray(areas, dtype=float).reshape(-1, 4).tolist()
    patches = itertools.cycle(scene.actuators)
    return [
        patch.moved_to((x0 + x1) / 2, (y0 + y1) / 2) for patch, (x0, x1, y0, y1) in zip(patches, boxes, strict=False)
    ]


def patch_means(space: FunctionSpace, regions: Sequence[PlateRegion]) -> np.ndarray:
    """Return (regions, unknowns of the plate) mean values of the functions over the parts of regions on the plate."""
    return space.region_integrals(regions) / space.region_areas(regions)[:, None]


def _with_links(
    space: FunctionSpace, attached: Sequence[Attachment], means: np.ndarray, values: np.ndarray, key: str
) -> Matrix:
    """Return the matrix of a form of the plate with the attached springs or dampers, by the ``means`` over patches."""
    return join_masses(space.scatter(values), means, attached, [getattr(attachment, key) for attachment in attached])


def _check_springs(scene: Scene, attached: Sequence[Attachment], means: np.ndarray, largest: float) -> None:
    """Raise a SceneError if an attached spring is too stiff beside the ``largest`` stiffness of two functions."""
    for index, (attachment, row) in enumerate(zip(attached, means, strict=True)):
        limit = STIFFEST * largest / (1.0 if attachment.mass > 0 else float(np.max(row**2)))
        if attachment.stiffness > limit:
            key = f"{scene.effects.attachment_keys(scene.plate)[index]}.stiffness = {attachment.stiffness:g}"
            raise SceneError(f"{key}: hides the plate in rounding; {limit / 1000:.1g} N/m are as good as rigid")


def _with_masses(matrix: Matrix, masses: Sequence[float] | np.ndarray) -> Matrix:
    """Return a matrix of the plate with further unknowns, the motions of masses, and these on its diagonal."""
    if not len(masses):
        return matrix
    return Matrix(scipy.sparse.block_diag([matrix, scipy.sparse.diags_array(masses)], format="csr"))
