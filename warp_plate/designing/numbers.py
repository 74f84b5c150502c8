"""Changes of what a panel can do with the numbers of its scene, from slopes by its matrices.

The matrices are linear in the coefficients of the plate's terms and in its fields. What two scenes differ in is
therefore multiplied by slopes by these, which are computed once, and no matrix is assembled for a number. Only where
actuators or layers move are the matrices themselves differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy

from warp_plate.effects.effect import Attachment, Edge, Effect, Patch, Term, attachments
from warp_plate.modal.assemble import DIFFERENCE, Galerkin, load_integrals
from warp_plate.modal.sensitivity import FieldSlopes, PlateMatrices, has_rule, plate_matrices
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.plate.section import laminate_of
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion


class NumberSlopes:
    """Changes of a number that has slopes by the matrices of a panel."""

    def __init__(
        self, galerkin: Galerkin, slopes: PlateMatrices, make: Callable[[Scene], Galerkin], by_mass: float = 0.0
    ) -> None:
        """Prepare the slopes; ``make`` returns the matrices of another scene over the same functions, and ``by_mass``
        is the slope by the mass of the panel [1/kg] beside those by its matrices."""
        assert isinstance(galerkin.space, TensorSplines)
        self._galerkin, self._space, self._slopes, self._make = galerkin, galerkin.space, slopes, make
        self._by_mass, self.of_fields = by_mass, FieldSlopes(galerkin.space, slopes, by_mass)

    @property
    def scene(self) -> Scene:
        """The scene of the panel."""
        return self._galerkin.scene

    @cached_property
    def _relative(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """(attachments, unknowns) mean motion of each patch relative to its mass, and its products with slopes by
        stiffness and damping."""
        attached, plate = self._galerkin.attachments, self._space.unknowns
        rows = np.zeros((len(attached), len(self._slopes.mass)))
        rows[:, :plate] = self._means([attachment.region for attachment in attached])
        rows[self._swinging, plate + np.arange(self._swinging.size)] = -1
        sparse = scipy.sparse.csr_array(rows)
        return rows, [sparse @ by for by in (self._slopes.support, self._slopes.damping)]

    def _means(self, regions: Sequence[PlateRegion]) -> np.ndarray:
        """Return (regions, unknowns of the plate) mean values of the functions."""
        return self._space.region_integrals(regions) / self._space.region_areas(regions)[:, None]

    @cached_property
    def _swinging(self) -> np.ndarray:
        """Indices of the attachments with a mass."""
        return np.flatnonzero([attachment.mass > 0 for attachment in self._galerkin.attachments])

    @cached_property
    def _attached(self) -> np.ndarray:
        """(3, attachments) slopes by stiffness, damping and mass of each attachment."""
        rows, products = self._relative
        by_mass = np.zeros(len(rows))
        by_mass[self._swinging] = np.diag(self._slopes.mass)[self._space.unknowns :] + self._by_mass
        return np.stack([*((product * rows).sum(axis=1) for product in products), by_mass])

    @cached_property
    def by_places(self) -> dict[str, tuple[float, float]]:
        """Slopes [1/m] by x and by y of the place of each table of attachments, by its key."""
        attached, slopes = self._galerkin.attachments, []
        numbers = np.array([[attachment.stiffness, attachment.damping] for attachment in attached]).reshape(-1, 2)
        pulls = sum(
            number[:, None] * product for number, product in zip(numbers.T, self._relative[1], strict=True)
        )[:, : self._space.unknowns]  # fmt: skip
        step = DIFFERENCE * max(self.scene.plate.size)
        for shift in ((step, 0.0), (0.0, step)):
            ahead, behind = (
                self._means([_moved(attachment.region, sign * shift[0], sign * shift[1]) for attachment in attached])
                for sign in (1, -1)
            )
            slopes.append(((ahead - behind) * pulls).sum(axis=1) / step)
        totals = {key: np.zeros(2) for key in self._first}
        for key, by in zip(self.scene.effects.attachment_keys(self.scene.plate), np.transpose(slopes), strict=True):
            totals[key] += by
        return {key: (float(by[0]), float(by[1])) for key, by in totals.items()}

    @cached_property
    def _first(self) -> dict[str, int]:
        """Index of the first attachment of each table that has some."""
        keys = self.scene.effects.attachment_keys(self.scene.plate)
        return {key: index for index, key in reversed(list(enumerate(keys)))}

    def of_row(self, key: str, after: Effect, before: Effect) -> float:
        """Return the change between two tables of attachments at a key of the scene, of the same patches."""
        plate, first = self.scene.plate, self._first[key]
        changes = _changes(zip(attachments(after.terms(plate)), attachments(before.terms(plate)), strict=True))
        return float((self._attached[:, first : first + len(changes)].T * changes).sum())

    def between(self, after: Scene, before: Scene) -> float:
        """Return the change between two scenes."""
        if _shapes(after) != _shapes(before) or any(layer.area is None for layer in after.layers):
            one, other = (self._make(scene) for scene in (after, before))
            by_matrices = self._slopes.product(plate_matrices(one) - plate_matrices(other))
            return by_matrices + self._by_mass * (panel_mass(one) - panel_mass(other))
        return self._of_terms(after, before) + self._of_fields(after, before) + self._of_loads(after, before)

    def _of_terms(self, after: Scene, before: Scene) -> float:
        """Return the change with the terms but those in the fields of bending and of the mass per area."""
        pairs = zip(attachments(after.terms), attachments(before.terms), strict=True)
        total = float((self._attached.T * _changes(pairs)).sum())
        for term, other in zip(after.terms, before.terms, strict=True):
            if isinstance(term.place, Patch) or term.multiple_of or term.role == "mass":
                continue
            if change := term.coefficient - other.coefficient:
                total += self._of_form(term, change)
        return total

    def _of_form(self, term: Term, change: float) -> float:
        """Return the change with the coefficient of a term along an edge or over the plate."""
        space, count = self._space, self._space.unknowns
        if isinstance(term.place, Edge):
            values = space.edge_form(term.place.side, {term.factors: change})
        else:
            values = space.form(float(change), term.factors)
        by = self._slopes.damping if term.role == "damping" else self._slopes.support
        return float(space.scatter(values).multiply(by[:count, :count]).sum())

    def _of_fields(self, after: Scene, before: Scene) -> float:
        target = self.scene.target
        changes = self._field_changes(after, before, *self._space.integrals.points)
        if not any(change.any() for change in changes):
            return 0.0
        total = float(self.of_fields.by_fields(changes).sum())
        if not changes[-1].any():
            return total
        if has_rule(target):
            rule, by_mass = self.of_fields.of_target
            return total + float((by_mass * self._field_changes(after, before, *rule.points)[-1]).sum())
        one, other = (self._make(scene).region_matrix(target) for scene in (after, before))
        return total + float((one - other).multiply(self._slopes.regions[1]).sum())

    @staticmethod
    def _field_changes(after: Scene, before: Scene, x: np.ndarray, y: np.ndarray) -> list[np.ndarray]:
        """Return the changes of Dx, D1, Dy, Dxy and the mass per area at points (y, x) [m]."""
        fields = []
        for scene in (after, before):
            rigidities, twist, mass, _ = laminate_of(scene).fields(x, y)
            fields.append([*rigidities, twist, mass])
        return [one - other for one, other in zip(*fields, strict=True)]

    def _of_loads(self, after: Scene, before: Scene) -> float:
        if not after.piezo:
            return 0.0
        boxes = np.array([actuator.box for actuator in after.actuators])
        one, other = (load_integrals(replace(self._galerkin, scene=scene), boxes) for scene in (after, before))
        return float(np.vdot(self._slopes.forces[: self._space.unknowns], (one - other).T))


def _moved(region: PlateRegion, x: float, y: float) -> PlateRegion:
    """Return a region moved by x, y [m]."""
    middle = region.middle
    return PlateRegion.model_construct(**{**dict(region), **region.placed(middle[0] + x, middle[1] + y)})


def panel_mass(galerkin: Galerkin) -> float:
    """Return the mass of a panel with what is attached [kg]."""
    return galerkin.space.plate_mass + sum(attachment.mass for attachment in galerkin.masses)


def _changes(pairs: Iterable[tuple[Attachment, Attachment]]) -> np.ndarray:
    """Return (attachments, 3) changes of stiffness, damping and mass between pairs of attachments."""
    names = "stiffness", "damping", "mass"
    changes = [[getattr(one, name) - getattr(other, name) for name in names] for one, other in pairs]
    return np.array(changes).reshape(-1, 3)


def _shapes(scene: Scene) -> list[PlateRegion]:
    """Return the places of actuators, layers and attachments."""
    attached = (attachment.region for attachment in attachments(scene.terms))
    return [*(row.region for row in (*scene.actuators, *scene.layers)), *attached]
