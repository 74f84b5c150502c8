"""Changes of what a panel can do with the numbers of its scene, from slopes by its matrices.

The matrices are linear in the coefficients of the plate's terms and in its fields. What two scenes differ in is
therefore multiplied by slopes by these, which are computed once, and no matrix is assembled for a number. Where layers
move, the fields are computed again at the points of another integration rule. Only where the outline or a patch changes
are the matrices themselves differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
import scipy

from warp_plate.designing.functions import shape_of
from warp_plate.effects.effect import Attachment, Edge, Effect, Patch, Term, attachments
from warp_plate.effects.layers import Layer
from warp_plate.modal.assemble import Galerkin, make_galerkin, patch_means, unit_loads
from warp_plate.modal.coils import coil_numbers
from warp_plate.modal.sensitivity.fields import FieldSlopes
from warp_plate.modal.sensitivity.forms import PlateMatrices, plate_matrices
from warp_plate.modal.spaces.edge_moments import Unlike
from warp_plate.modal.spaces.integrals import Integrals, SplineProducts
from warp_plate.plate.section import Laminate, laminate_of
from warp_plate.scene.keys import value_of
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion

# Steps of differences, as parts of the range of a number: of five points by places, and of three by other numbers, in
# which the coefficients of the plate are smooth.
STEP, SMOOTH_STEP = 1e-4, 2e-5


@dataclass(frozen=True)
class PanelSlopes:
    """Derivatives of one quantity by a panel's matrices and by its mass."""

    matrices: PlateMatrices  # by its matrices
    by_mass: float = 0.0  # by its mass [1/kg], beside those by matrices
    by_target: float = 0.0  # by the mass of its target [1/kg], likewise


class NumberSlopes:
    """Changes of numbers that have slopes by a panel."""

    def __init__(
        self, galerkin: Galerkin, space_of: Callable[[Scene], SplineProducts], slopes: Sequence[PanelSlopes]
    ) -> None:
        """Prepare the slopes; ``space_of`` returns the same functions over the panel of another scene."""
        assert isinstance(galerkin.space, SplineProducts)
        self._galerkin, self._space, self._space_of, self._slopes = galerkin, galerkin.space, space_of, slopes
        self._by_mass, self._by_target = (
            np.array([getattr(one, name) for one in slopes]) for name in ("by_mass", "by_target")
        )
        self.of_fields = self._fields_over(galerkin.space)

    def _fields_over(self, space: SplineProducts) -> FieldSlopes:
        return FieldSlopes(space, [one.matrices for one in self._slopes], self._by_mass, self._by_target)

    @property
    def count(self) -> int:
        """Number of numbers with slopes."""
        return len(self._slopes)

    @property
    def scene(self) -> Scene:
        """The scene of the panel."""
        return self._galerkin.scene

    @cached_property
    def _relative(self) -> tuple[np.ndarray, list[list[np.ndarray]]]:
        """(attachments, unknowns) mean motion of each patch relative to its mass, and for each number its products with
        slopes by stiffness and damping."""
        attached, plate = self._galerkin.attachments, self._space.unknowns
        rows = np.zeros((len(attached), self._galerkin.mass.shape[0]))
        rows[:, :plate] = patch_means(self._space, [attachment.region for attachment in attached])
        rows[self._swinging, plate + np.arange(self._swinging.size)] = -1
        sparse = scipy.sparse.csr_array(rows)
        both = [(one.matrices.support, one.matrices.damping) for one in self._slopes]
        return rows, [[sparse @ by for by in one] for one in both]

    @cached_property
    def _swinging(self) -> np.ndarray:
        """Indices of the attachments with a mass."""
        return np.flatnonzero([attachment.mass > 0 for attachment in self._galerkin.attachments])

    @cached_property
    def _attached(self) -> np.ndarray:
        """(numbers, attachments, 3) slopes by stiffness, damping and mass of each attachment."""
        rows, products = self._relative
        slopes = np.zeros((len(self._slopes), len(rows), 3))
        for values, both, one in zip(slopes, products, self._slopes, strict=True):
            values[:, :2] = np.stack([(product * rows).sum(axis=1) for product in both], axis=1)
            values[self._swinging, 2] = np.diag(one.matrices.mass)[self._space.unknowns :] + one.by_mass
        return slopes

    @cached_property
    def by_places(self) -> dict[str, np.ndarray]:
        """Slopes (numbers, 2) [1/m] by x and by y of the place of each table of attachments, by its key."""
        numbers, plate = _numbers(self._galerkin.attachments), self._space.unknowns
        pulls = [sum(numbers[:, [i]] * both[i] for i in range(2))[:, :plate] for both in self._relative[1]]
        totals = {key: np.zeros((len(pulls), 2)) for key in self._first}
        for axis in (0, 1):
            regions = (attachment.region for attachment in self._galerkin.attachments)
            means = self._slopes_of(partial(patch_means, self._space), regions, axis)
            slopes = np.array([2 * (means * pull).sum(axis=1) for pull in pulls])
            for index, key in enumerate(self.scene.effects.attachment_keys(self.scene.plate)):
                totals[key][:, axis] += slopes[:, index]
        return totals

    def edged_layer(self, key: str) -> Layer | None:
        """Return the layer at a key of the scene if it is a rectangle on a rectangular plate; None for others.

        Slopes by its place come from its edges, and from :meth:`change_in_target`: in differences of sums over all
        points they are less than rounding.
        """
        layer = value_of(self.scene, key) if key.startswith("effects.layers[") else None
        return layer if layer is not None and layer.area and isinstance(self._space.rule, Integrals) else None

    def change_in_target(self, after: Scene) -> np.ndarray:
        """Return the changes (numbers,) by the mass of the target alone to a scene with a layer that has moved."""
        moved = self._fields_over(self._space_of(after))
        return moved.total_in_target(laminate_of(after)) - self._in_target

    @cached_property
    def _in_target(self) -> np.ndarray:
        return self.of_fields.total_in_target(self._space.laminate)

    def by_place_of_actuator(self, index: int, axis: int) -> np.ndarray | None:
        """Return the slopes (numbers,) [1/m] by the place along x (0) or y (1) of an actuator; None of a piezo patch,
        and of one that reaches over the plate."""
        actuator, side = self.scene.actuators[index], self.scene.plate.size[axis]
        low, high = actuator.box[2 * axis : 2 * axis + 2]
        if self.scene.piezo or low < 0 or high > side:
            return None
        of_patches = partial(patch_means, self._space) if actuator.kind == "coil" else self._space.region_integrals
        (load,) = self._slopes_of(of_patches, [actuator], axis)
        return np.array([by.matrices.forces[: load.size, index] @ load for by in self._slopes])

    def _slopes_of(
        self, of_patches: Callable[[list[PlateRegion]], np.ndarray], patches: Iterable[PlateRegion], axis: int
    ) -> np.ndarray:
        """Return (patches, unknowns of the plate) slopes [1/m] of rows of patches by their x (0) or y (1)."""
        side, slopes, moved = self.scene.plate.size[axis], list[np.ndarray](), list[PlateRegion]()
        for region in patches:
            low, high = region.box[2 * axis : 2 * axis + 2]
            travel = max(side - (high - low), STEP * side)
            points, weights = next(stencils(min(max(low / travel, 0.0), 1.0), STEP))
            for place in travel * points + (high - low) / 2:
                moved.append(region.moved_to(*np.where(np.arange(2) == axis, place, region.middle).tolist()))
            slopes.append(weights / travel)
        rows = of_patches(moved).reshape(*np.shape(slopes), -1)
        return np.einsum("ap,apu->au", slopes, rows)

    @cached_property
    def _first(self) -> dict[str, int]:
        """Index of the first attachment of each table that has some."""
        keys = self.scene.effects.attachment_keys(self.scene.plate)
        return {key: index for index, key in reversed(list(enumerate(keys)))}

    def of_row(self, key: str, after: Effect, before: Effect) -> np.ndarray:
        """Return the changes (numbers,) between two tables of attachments at a key of the scene, of the same
        patches."""
        plate, first = self.scene.plate, self._first[key]
        changes = _numbers(attachments(after.terms(plate))) - _numbers(attachments(before.terms(plate)))
        return np.asarray((self._attached[:, first : first + len(changes)] * changes).sum(axis=(1, 2)))

    def along(
        self,
        scene_at: Callable[[float], Scene],
        share: float,
        step: float,
        count: int = 5,
        change: Callable[[Scene], np.ndarray] | None = None,
    ) -> np.ndarray:
        """Return the slopes (numbers,) at a share from 0 to 1 of scenes by their share, from :func:`stencils` of a
        ``count`` of points and :meth:`change` or another; Unlike: on either side functions of the outline are of other
        kinds."""
        unlike = None
        for points, weights in stencils(share, step, count):
            others = points != share  # there is no change
            pairs = zip(points[others].tolist(), weights[others], strict=True)
            try:
                changes = [weight * (change or self.change)(scene_at(point)) for point, weight in pairs]
                return np.sum(changes, axis=0)
            except Unlike as error:
                unlike = error
        assert unlike is not None
        raise unlike

    def change(self, after: Scene) -> np.ndarray:
        """Return the changes (numbers,) to another scene; Unlike: functions of the outline are of other kinds."""
        before = self.scene
        both = attachments(after.terms), self._galerkin.attachments
        patches = [_shapes(attachment.region for attachment in attached) for attached in both]
        if shape_of(after) != shape_of(before) or patches[0] != patches[1]:
            galerkin = make_galerkin(after, self._space_of(after))
            matrices, target = plate_matrices(galerkin) - self._matrices, before.target
            mass = panel_mass(galerkin) - panel_mass(self._galerkin)
            of_target = galerkin.space.region_mass(target) - self._target_mass if self._by_target.any() else 0.0
            changes = [by.matrices.product(matrices) for by in self._slopes]
            return np.array(changes) + self._by_target * of_target + self._by_mass * mass
        terms = (self._attached * (_numbers(both[0]) - _numbers(both[1]))).sum(axis=(1, 2))
        return terms + self._of_terms(after) + self._of_section(after) + self._of_coils(after) + self._of_loads(after)

    @cached_property
    def _target_mass(self) -> float:
        return self._space.region_mass(self.scene.target)

    @cached_property
    def _matrices(self) -> PlateMatrices:
        return plate_matrices(self._galerkin)

    def _of_terms(self, after: Scene) -> np.ndarray:
        """Return the changes with the terms but those in the fields of bending and of the mass per area."""
        total = np.zeros(len(self._slopes))
        for term, other in zip(after.terms, self.scene.terms, strict=True):
            if isinstance(term.place, Patch) or term.multiple_of or term.role == "mass":
                continue
            if change := term.coefficient - other.coefficient:
                total += self._of_form(term, change)
        return total

    def _of_form(self, term: Term, change: float) -> list[float]:
        """Return the changes with the coefficient of a term along an edge or over the plate."""
        space, count = self._space, self._space.unknowns
        if isinstance(term.place, Edge):
            values = space.edge_form(term.place.side, {term.factors: change})
        else:
            values = space.form(float(change), term.factors)
        role: Literal["damping", "support"] = "damping" if term.role == "damping" else "support"
        matrix = space.scatter(values)
        return [float(matrix.multiply(getattr(by.matrices, role)[:count, :count]).sum()) for by in self._slopes]

    def _of_section(self, after: Scene) -> np.ndarray:
        """Return the changes with fields; layers that move have points of their own, where functions are the same."""
        laminate, before = laminate_of(after), self._space.laminate
        if _alike(laminate, before):
            return np.zeros(len(self._slopes))
        moved = _shapes(laminate.layers) != _shapes(before.layers)
        fields = self._fields_over(self._space_of(after)) if moved else self.of_fields
        return fields.total(laminate) - self._section_total

    @cached_property
    def _section_total(self) -> np.ndarray:
        return self.of_fields.total(self._space.laminate)

    def _of_coils(self, after: Scene) -> np.ndarray:
        before, omega = self.scene, self.scene.drive.angular_frequency
        numbers = coil_numbers(after, omega) - coil_numbers(before, omega)
        changes = [np.vdot(by.matrices.coils, numbers).real for by in self._slopes]
        return np.array(changes) + self._by_mass * (coil_mass(after) - coil_mass(before))

    def _of_loads(self, after: Scene) -> np.ndarray:
        before = self.scene
        if not after.piezo and _shapes(after.actuators) == _shapes(before.actuators):
            return np.zeros(len(self._slopes))
        one, other = (unit_loads(replace(self._galerkin, scene=scene)) for scene in (after, before))
        plate = self._space.unknowns
        return np.array([np.vdot(by.matrices.forces[:plate], one - other) for by in self._slopes])


def stencils(share: float, step: float, count: int = 5) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield an odd ``count`` of points from 0 to 1, a step apart, of which a share is one, and the weights with which
    values there sum up to the slope at the share of a polynomial through them; first those with the share in the
    middle."""
    step, half = min(step, 1 / count), count // 2
    for below in sorted(range(count), key=lambda below: abs(below - half)):
        offsets = np.arange(count) - below
        points = share + step * offsets
        if points[0] >= 0 and points[-1] <= 1:
            weights = np.linalg.solve(offsets ** np.arange(count)[:, None], np.eye(count)[1])
            yield points, np.where(offsets if below == half else 1, weights, 0) / step


def panel_mass(galerkin: Galerkin) -> float:
    """Return the mass of a panel with what is attached [kg]."""
    attached = sum(attachment.mass for attachment in galerkin.masses)
    return galerkin.space.plate_mass + attached + coil_mass(galerkin.scene)


def coil_mass(scene: Scene) -> float:
    """Return the mass of the coils of a scene with their magnets [kg]."""
    coils = (scene.actuators[index].coil for index in scene.coil_indices)
    return float(sum(coil.moving_mass + coil.magnet_mass for coil in coils))


def _numbers(attached: Iterable[Attachment]) -> np.ndarray:
    """Return (attachments, 3) stiffness, damping and mass."""
    return np.array([[one.stiffness, one.damping, one.mass] for one in attached]).reshape(-1, 3)


def _shapes(patches: Iterable[PlateRegion]) -> list[list[Any]]:
    """Return the places of patches."""
    return [[getattr(patch.region, name) for name in PlateRegion.model_fields] for patch in patches]


def _alike(one: Laminate, other: Laminate) -> bool:
    """Return whether two plates have the same section everywhere."""
    names = "plate", "layers", "rigidities", "masses"
    if one.maps.keys() != other.maps.keys() or any((one.maps[key] != other.maps[key]).any() for key in one.maps):
        return False
    return all(getattr(one, name) == getattr(other, name) for name in names)
