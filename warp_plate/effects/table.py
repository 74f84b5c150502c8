"""The table ``[effects]``: all effects, one file each. To add one, write its file and name it in :class:`Effects`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, get_args

from warp_plate.effects.air import AirLoad
from warp_plate.effects.damping import Damping
from warp_plate.effects.effect import Effect, Panel, Term, attachments, rows_of
from warp_plate.effects.foundation import Foundation
from warp_plate.effects.layers import Layer
from warp_plate.effects.loss_factor import LossFactor
from warp_plate.effects.material_damping import MaterialDamping
from warp_plate.effects.modal_damping import ModalDamping
from warp_plate.effects.moving_load import MovingLoad
from warp_plate.effects.orthotropic import Orthotropic
from warp_plate.effects.oscillators import Oscillator
from warp_plate.effects.shear_layer import ShearLayer
from warp_plate.effects.stretching import Stretching
from warp_plate.effects.tension import Tension
from warp_plate.effects.variation import LEAST_FACTOR, MOST_FACTOR, Variation
from warp_plate.scene.fields import Table
from warp_plate.scene.target import PlateRegion

# Table of the maps of factors.
FACTOR_MAPS = "effects.variation"
# Least and largest factor of a map.
FACTOR_RANGE = LEAST_FACTOR, MOST_FACTOR
# The table of the force that travels.
TRAVELLING = "effects.moving_load"
# List of what is attached to patches.
ATTACHED = "effects.oscillators"


class Effects(Table):
    """Effects of a scene; those that are None or empty are not compiled into the kernels."""

    damping: Damping | None = None
    material_damping: MaterialDamping | None = None
    loss_factor: LossFactor | None = None
    modal_damping: ModalDamping | None = None
    tension: Tension | None = None
    foundation: Foundation | None = None
    shear_layer: ShearLayer | None = None
    orthotropic: Orthotropic | None = None
    variation: Variation | None = None
    layers: tuple[Layer, ...] = ()
    oscillators: tuple[Oscillator, ...] = ()
    stretching: Stretching | None = None
    moving_load: MovingLoad | None = None
    air: AirLoad | None = None

    @property
    def rows(self) -> Iterator[tuple[str, Effect]]:
        """The tables that the scene names, by key: ``effects.damping``, ``effects.layers[0]`` and so on."""
        for name, value in self:
            yield from ((f"effects.{name}{index}", row) for index, row in rows_of(value))

    @property
    def names(self) -> list[str]:
        """Names of the effects that the scene names."""
        return [name for name, value in self if value not in (None, ())]

    @property
    def compiled(self) -> list[str]:
        """Names of the effects that stand in the kernels of a scene with these; others only change their arrays."""
        compiled = self.keeping(lambda effect: effect.stepped and effect.in_kernels).names
        names = {name: name.replace("_", " ") for name in compiled}
        if self.damping is not None:
            names["damping"] = f"viscous damping ({self.damping.scheme})"
        return list(names.values())

    def first(self, condition: Callable[[Effect], object]) -> str | None:
        """Return the key of the first effect that meets a condition, without its index; None if none does."""
        return next((key.partition("[")[0] for key, row in self.rows if condition(row)), None)

    def attachment_keys(self, plate: Panel) -> list[str]:
        """Return the key of the table of each of the ``attachments``."""
        return [key for key, row in self.rows for _ in attachments(row.terms(plate))]

    def terms(self, plate: Panel) -> Iterator[Term]:
        """Yield the terms of all effects, labelled by their names."""
        for name, value in self:
            for _, row in rows_of(value):
                for term in row.terms(plate):
                    yield term if term.label else replace(term, label=name.replace("_", " "))

    def keeping(self, condition: Callable[[Effect], object]) -> Effects:
        """Return the effects that meet a condition."""
        empty = type(self).model_fields
        kept = {
            name: value if all(condition(row) for _, row in rows_of(value)) else empty[name].default
            for name, value in self
        }
        return self.model_copy(update=kept)

    def linearized(self) -> Effects:
        """Return the effects on small motion about rest, as natural modes have them."""
        linear = self.keeping(lambda effect: effect.linear)
        at_rest = {
            name: tuple(row.at_rest for row in value) if isinstance(value, tuple) else value and value.at_rest
            for name, value in linear
        }
        return linear.model_copy(update=at_rest)

    @property
    def backward(self) -> bool:
        """True if viscous damping is taken backward in time."""
        return self.damping is not None and self.damping.scheme == "backward"

    @property
    def stretches(self) -> bool:
        """True if the plate stretches at large amplitude."""
        return self.stretching is not None

    @property
    def travelling(self) -> MovingLoad | None:
        """The force that travels over the plate."""
        return self.moving_load

    def with_travelling(self, force: MovingLoad | None) -> Effects:
        """Return the effects with another force that travels."""
        return self.model_copy(update={"moving_load": force})

    @property
    def attached(self) -> bool:
        """True if masses, springs or dampers stand on patches of the plate."""
        return bool(self.oscillators)

    @property
    def rigidities(self) -> tuple[float, float, float, float] | None:
        """Dx, D1, Dy, Dxy [N·m] in place of those of an isotropic plate; None if it is isotropic."""
        return None if self.orthotropic is None else self.orthotropic.rigidities

    @property
    def factor_maps(self) -> dict[str, Any]:
        """Maps of factors by key of ``[plate]``: rows of numbers, or the name of a file."""
        return {} if self.variation is None else dict(self.variation.maps)

    def with_thickness(self, given: Any) -> Effects:
        """Return the effects with another map of thickness, rows of numbers or a file's name, that is not checked."""
        maps = {**self.factor_maps, "thickness": given if isinstance(given, str) else tuple(map(tuple, given))}
        return self.model_copy(update={"variation": Variation.model_construct(**maps)})

    @property
    def map_files(self) -> dict[str, str]:
        """Names of the files of ``factor_maps``, by key of the scene."""
        named = self.factor_maps.items()
        return {f"{FACTOR_MAPS}.{key}": value for key, value in named if isinstance(value, str)}

    @property
    def regions(self) -> dict[str, PlateRegion]:
        """Layers and attachments, by key."""
        return {key: row for key, row in self.rows if isinstance(row, Layer | Oscillator)}

    @property
    def section_keys(self) -> list[str]:
        """Keys that make the plate other than isotropic and uniform, but for layers."""
        rows = ((key, part) for key, row in self.rows for part in row.section_keys)
        return [f"{key}.{part}" if part else key for key, part in rows]

    def scaled(self, stiffness: float, thickness: float, damping: float) -> dict[str, Any]:
        """Return the tables of a panel with factors of Young's modulus, thickness and damping."""
        tables = self.model_dump()
        for name, value in self:
            if isinstance(value, Effect):
                tables[name] = value.scaled(stiffness, thickness, damping)
        return tables

    def without_attachments(self) -> dict[str, Any]:
        """Return the tables that a panel with nothing attached to patches replaces."""
        return {"oscillators": ()}


def check_modal_tables(effects: Effects, drives: Mapping[str, Any]) -> None:
    """Raise ValueError, naming both keys, if the damping of modes cannot go with another effect, or with a table of the
    drive, by key and None where there is none, that is no steady tone of a linear plate."""
    nonlinear = {"effects.stretching": effects.stretching, "drive.electrostatic": drives["drive.electrostatic"]}
    transient = {key: table for key, table in drives.items() if key != "drive.electrostatic"}
    transient["effects.moving_load"] = effects.moving_load
    loss = effects.loss_factor
    ratio = "" if loss is None or isinstance(loss.eta, tuple) else f" ratio = {loss.eta / 2:g}"
    causal = f"write [effects.modal_damping]{ratio} instead, as much damping of each mode in any motion"
    for name, others, reason in (
        ("loss_factor", transient, f"a loss factor is defined for steady tones alone; {causal}"),
        ("loss_factor", nonlinear, "only a linear plate has it; delete it"),
        ("air", {**transient, **nonlinear}, "the load of air is that of steady tones of a linear plate; delete it"),
        ("modal_damping", nonlinear, "only a linear plate has modes; delete it"),
    ):
        other = next((key for key, value in others.items() if value is not None), None)
        if getattr(effects, name) is not None and other is not None:
            raise ValueError(f"effects.{name}: {reason}; or delete {other}")
    if effects.modal_damping is not None and loss is not None and isinstance(loss.eta, tuple):
        reason = "effects.loss_factor.eta lists the damping of each mode"
        raise ValueError(f"effects.modal_damping: {reason}; delete one of them")


def effect_type(name: str) -> type[Effect]:
    """Return the class of an effect by the name of its field."""
    annotation = Effects.model_fields[name].annotation
    kinds = (kind for kind in get_args(annotation) if isinstance(kind, type) and issubclass(kind, Effect))
    return next(kinds)
