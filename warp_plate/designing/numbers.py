"""Changes of what a panel can do with the numbers of its scene, from slopes by its matrices.

The matrices are linear in the coefficients of the plate's terms and in its fields. What two scenes differ in is
therefore multiplied by slopes by these, which are computed once, and no matrix is assembled for a number. Only where
patches move are the matrices themselves differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property

import numpy as np

from warp_plate.effects.effect import Attachment, Edge, Effect, Patch, Term, attachments
from warp_plate.modal.assemble import Galerkin, load_integrals
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
    def _attached(self) -> np.ndarray:
        """(3, attachments) slopes by stiffness, damping and mass of each attachment."""
        attached, plate = self._galerkin.attachments, self._space.unknowns
        regions, slopes = [attachment.region for attachment in attached], self._slopes
        rows = np.zeros((len(attached), len(slopes.mass)))
        rows[:, :plate] = self._space.region_integrals(regions) / self._space.region_areas(regions)[:, None]
        swinging = np.flatnonzero([attachment.mass > 0 for attachment in attached])
        masses = plate + np.arange(swinging.size)
        rows[swinging, masses] = -1
        by_mass = np.zeros(len(attached))
        by_mass[swinging] = np.diag(slopes.mass)[masses] + self._by_mass
        return np.stack([*(((rows @ by) * rows).sum(axis=1) for by in (slopes.support, slopes.damping)), by_mass])

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
