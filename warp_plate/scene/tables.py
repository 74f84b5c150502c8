"""The table ``[links]``, and the top level of a scene file with what follows from its tables."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import Field

from warp_plate.effects.edges import Edges, ElasticEdge, edge_terms
from warp_plate.effects.effect import IN_PLANE, Edge, Term
from warp_plate.effects.layers import Layer
from warp_plate.effects.table import Effects
from warp_plate.outline.outline import Outline
from warp_plate.scene.actuator import Actuator
from warp_plate.scene.drive import Drive
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Name, Table, Text
from warp_plate.scene.fit import Design, Fit, Measurement
from warp_plate.scene.focus import Focus
from warp_plate.scene.grid import DEFAULT_ACCURACY, Grid, Record, Window
from warp_plate.scene.outline import Plate, Support, outline_of, outline_of_rectangle
from warp_plate.scene.search import Search
from warp_plate.scene.specification import Specification
from warp_plate.scene.target import NamedTarget, PlateRegion, Target


class Link(Table):
    """Keys that hold one number. The name of the link is a key too: it is set, varied and fitted as one."""

    keys: Annotated[
        tuple[Name, ...], Field(min_length=1, examples=[["edges.left.translation", "edges.right.translation"]])
    ]
    """Keys of the panel (plate, edges, effects, piezo patches, measurements) that hold the same number."""


class SceneTables(Table):
    """The top level of a scene file, before its tables are checked against each other."""

    title: Annotated[Text, Field(examples=["Touch panel"])] = ""
    """Title of tables and pictures."""
    plate: Plate
    edges: Edges = Edges()
    supports: tuple[Support, ...] = ()
    grid: Grid = Grid(accuracy=DEFAULT_ACCURACY)
    window: Window = Window()
    drive: Drive
    targets: tuple[NamedTarget, ...] = ()
    target: Target
    record: Record = Record()
    effects: Effects = Effects()
    search: Search = Search()
    specification: Specification | None = None
    links: Annotated[dict[str, Link], Field(default_factory=dict)]
    focus: Focus | None = None
    fit: Fit | None = None
    design: Design | None = None
    measurement: tuple[Measurement, ...] = ()
    actuators: Annotated[tuple[Actuator, ...], Field(min_length=1)]

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values of fields, for which the cached properties are computed anew."""
        copy = super().model_copy(update=update, deep=deep)
        for name in copy.__dict__.keys() - type(self).model_fields.keys():
            del copy.__dict__[name]
        return copy

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances of the nodes along x and y [m]."""
        (width, height), (nx, ny) = self.plate.size, self.grid.nodes
        return width / (nx - 1), height / (ny - 1)

    @property
    def piezo(self) -> bool:
        """True if actuators are piezo patches, driven by voltages; then all but coils are."""
        return any(actuator.kind == "piezo" for actuator in self.actuators)

    @cached_property
    def coil_indices(self) -> list[int]:
        """Indices of the actuators that are coils."""
        return [index for index, actuator in enumerate(self.actuators) if actuator.kind == "coil"]

    @property
    def limited_levels(self) -> dict[str, tuple[str, float]]:
        """Units and values of a search's limits on motion, sound and coils, with which the size of a drive counts."""
        return self.search.limits.levels(self.coil_labels)

    @property
    def coil_labels(self) -> list[str]:
        """Names of the coils, or their keys in place of names that cannot be parts of names in files."""
        names = {index: self.actuators[index].name for index in self.coil_indices}
        return [f"actuators[{index}]" if "/" in name else name for index, name in names.items()]

    @property
    def movable(self) -> dict[str, PlateRegion]:
        """Patches of one place each, by key: actuators, layers and what is attached."""
        actuators = {f"actuators[{index}]": row for index, row in enumerate(self.actuators)}
        return actuators | self.effects.regions

    def check_measurements(self) -> None:
        """Raise ValueError, naming the key, unless responses were measured of the scene's actuators and plate."""
        names = [actuator.name for actuator in self.actuators]
        for index, row in enumerate(self.measurement):
            if row.actuator is not None and row.actuator not in names:
                raise ValueError(f"measurement[{index}].actuator: {row.actuator!r} is not one of {', '.join(names)}")
            for name, point in {"point": row.point, "force_at": row.force_at}.items():
                if point is not None:
                    self.plate.check_point(f"measurement[{index}].{name}", point)

    def check_steady(self) -> None:
        """Raise ValueError, naming the key, if the scene has what coils or sound exclude."""
        transient = self.drive.waveform_key or self.nonlinear_table
        if (tone := self.search.tone_key) is not None and transient is not None:
            what = "the motion of coils" if self.search.sound_key is None else "sound"
            raise ValueError(f"{tone}: {what} is that of steady tones of linear plates; delete {transient}")
        if not self.coil_indices:
            if limited := list(self.search.limits.of_coils):
                key = f"search.limits.{limited[0]}"
                raise ValueError(f'{key}: no actuator is a coil; write kind = "coil", or delete it')
            return
        head = f'actuators[{self.coil_indices[0]}].kind: "coil"'
        if self.nonlinear_table is not None:
            raise ValueError(f"{head} is solved for linear plates; delete {self.nonlinear_table}")
        if self.drive.waveform_key is not None and (lossy := self.lossy_inductance_key) is not None:
            rule = "write eddy_branches in place of eddy_resistance and eddy_reactance"
            raise ValueError(f"{lossy}: is defined for steady tones alone; {rule}, or delete {self.drive.waveform_key}")
        robust = self.search.robust
        moved = {"search.position": self.search.position, "search.robust.place": robust and robust.place}
        for key in (key for key, value in moved.items() if value):
            raise ValueError(f"{head} keeps its place; delete {key}")

    @property
    def piezo_moments(self) -> list[float]:
        """Bending moment per length and volt [N/V] of each piezo patch, 0 of coils."""
        return [actuator.moment_on(self.plate) for actuator in self.actuators]

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """Layers of the plate, among them the bodies of piezo patches that have a density."""
        keys = (*PlateRegion.model_fields, "thickness", "young_modulus", "density")
        patches = (patch for patch in self.actuators if patch.density is not None)
        return (*self.effects.layers, *(Layer(**{key: getattr(patch, key) for key in keys}) for patch in patches))

    @property
    def targets_by_key(self) -> dict[str, Target]:
        """All targets by key: ``target``, or ``targets[0]``, ``targets[1]``, ..."""
        return {f"targets[{index}]": row for index, row in enumerate(self.targets)} or {"target": self.target}

    @property
    def target_regions(self) -> dict[str, NamedTarget]:
        """Targets by the names of their regions; empty if the scene has a single target."""
        return {f"target {target.name}": target for target in self.targets}

    @property
    def unit_drives(self) -> list[float]:
        """Force [N] of each actuator at a magnitude of 1; 1 V for piezo patches, 1 V or 1 A for coils."""
        return [actuator.patch_area if actuator.kind == "pressure" else 1.0 for actuator in self.actuators]

    @property
    def limit_units(self) -> list[str]:
        """Unit of what limits the drive of each actuator: V or A of coils, V of piezo patches, otherwise N."""
        return [actuator.amplitude_unit or ("V" if self.piezo else "N") for actuator in self.actuators]

    @property
    def magnitude_units(self) -> list[str]:
        """Unit of the magnitude of each actuator."""
        pressed = "N/m²" if self.drive.electrostatic is None else "V"
        units = {"magnitude": "V" if self.piezo else pressed, "force": pressed, "voltage": "V", "current": "A"}
        return [units[actuator.amplitude_key] for actuator in self.actuators]

    @property
    def drive_unit(self) -> str:
        """Unit of all magnitudes, N/m² or, for electrostatic actuators, piezo patches and coils, V; or A. Several are
        joined, as "N/m² or V"."""
        return " or ".join(dict.fromkeys(self.magnitude_units))

    @cached_property
    def outline(self) -> Outline | None:
        """Geometry of the plate's outline; None for a rectangle by ``plate.size`` without supports."""
        if self.plate.outline is None:
            return outline_of_rectangle(self.plate.size, self.edges) if self.supports else None
        return outline_of(self.plate.outline, self.plate.holes, self.edges)

    @cached_property
    def edge_conditions(self) -> tuple[tuple[str, Any], ...]:
        """Names and conditions of all edges, those of holes included."""
        holes = ((f"holes[{index}]", hole.edge) for index, hole in enumerate(self.plate.holes))
        return (*self.edges, *holes)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the equation of motion besides bending and inertia: those of elastic edges, then of the effects."""
        supports = (
            Term("stiffness", support.stiffness, place=Edge(f"supports[{index}]"), label="springs of supports")
            for index, support in enumerate(self.supports)
            if support.stiffness is not None
        )
        return (*edge_terms(self.edge_conditions), *supports, *self.effects.terms(self.plate))

    @property
    def uniform(self) -> bool:
        """True if the plate is an isotropic, homogeneous rectangle, clamped or supported along all edges."""
        varied = self.effects.section_keys or self.layers or self.plate.outline or self.supports
        return not varied and all(edge in ("clamped", "supported") for _, edge in self.edge_conditions)

    @property
    def named_files(self) -> dict[str, str]:
        """Names of the files in which parts of the scene lie, by key."""
        signals = {"drive.signal": self.drive.signal, "focus.wish": self.focus and self.focus.wish}
        files = {f"{key}.file": signal.file for key, signal in signals.items() if signal} | self.effects.map_files
        masks = {f"{key}.mask": target.mask for key, target in self.targets_by_key.items()}
        return files | {key: name for key, name in masks.items() if name is not None}

    def with_keys(self, table: str, **values: Any) -> Self:
        """Return the scene with other values of some keys of a table, which are not checked."""
        return self.model_copy(update={table: getattr(self, table).model_copy(update=values)})

    def in_float64(self) -> Self:
        """Return the scene in double precision, for energies whose differences lose digits; nothing is recorded."""
        return self.with_keys("grid", precision="float64").model_copy(update={"record": Record()})

    @property
    def gridded_by_waves(self) -> bool:
        """True if the scene has no ``[grid]``, and no accuracy could be held because it is not linear."""
        return "grid" not in self.model_fields_set and not self.linear

    @cached_property
    def nonlinear_table(self) -> str | None:
        """First table that makes displacements nonlinear in the drives, so that superposition fails; None if none."""
        return self.nonlinear_key or self.effects.first(lambda effect: effect.travels)

    @property
    def nonlinear_key(self) -> str | None:
        """First table that keeps the motion from obeying a linear equation; None if none."""
        electrostatic = "drive.electrostatic" if self.drive.electrostatic is not None else None
        return self.effects.first(lambda effect: not effect.linear) or electrostatic

    @property
    def linear(self) -> bool:
        return self.nonlinear_table is None

    @property
    def modal_only_key(self) -> str | None:
        """First key that only the modal engine knows, because it has no time steps; None if none."""
        return next((key for key, *_ in self._unstepped()), None)

    def check_stepped(self) -> None:
        """Raise a SceneError if only the modal engine knows the scene's effects."""
        for key, what, instead in self._unstepped():
            raise SceneError(f'{key}: {what}cannot be stepped in time; use the evaluator "modal"{instead}')

    def _unstepped(self) -> Iterator[tuple[str, str, str]]:
        """Yield the keys that have no time steps, which part of each, and what else to do about it."""
        if (key := self.lossy_inductance_key) is not None:
            yield key, "a lossy inductance ", ", or write eddy_branches in place of eddy_resistance and eddy_reactance"
        if self.search.tone_key is not None:
            yield self.search.tone_key, "", ""
        if (key := self.effects.first(lambda effect: not effect.stepped)) is not None:
            yield key, "", ", or write [effects.damping] instead"
        if self.plate.outline is None:
            return
        conditions = {condition for _, condition in self.edge_conditions}
        for name, condition in self.edge_conditions:
            if isinstance(condition, ElasticEdge):
                key = f"plate.{name}.edge" if name.startswith("holes") else f"edges.{name}"
                yield key, "springs along an outline ", ""
        stiff = [term for term in self.terms if term.role == "stiffness" and term.distributed]
        if "free" in conditions and any(term.factors in IN_PLANE for term in stiff):
            yield "plate.outline", "in-plane forces next to a free edge ", ""
        if "clamped" in conditions and any(term.multiple_of == "bending" for term in self.terms):
            yield "plate.outline", "losses of the material next to a clamped edge ", ""

    @property
    def steady(self) -> bool:
        """True if the response is the steady one: energies are means over all time, and ``window`` is not read."""
        return self.steady_key is not None

    @property
    def steady_key(self) -> str | None:
        """First effect, loss or limit of a coil, or sound that only steady tones have; None if none."""
        effect = self.effects.first(lambda effect: effect.steady)
        return effect or self.lossy_inductance_key or self.search.tone_key

    @property
    def lossy_inductance_key(self) -> str | None:
        """First key of a coil's lossy inductance, that of its model among them; None if none."""
        for index in self.coil_indices:
            key = self.actuators[index].coil.lossy_inductance_key
            if key is not None:
                return f"actuators[{index}].{key}"
        return None

    @property
    def coils_in_time(self) -> bool:
        """True if the scene has coils that move in time."""
        return bool(self.coil_indices) and self.lossy_inductance_key is None

    @property
    def nonharmonic_key(self) -> str | None:
        """First key that makes the drive other than a tone of one frequency from t = 0 on; None if none."""
        return self.nonperiodic_key or ("drive.electrostatic" if self.drive.electrostatic is not None else None)

    @property
    def nonperiodic_key(self) -> str | None:
        """First key that keeps the load from repeating with the drive's period from t = 0 on; None if none."""
        if self.drive.waveform_key is not None:
            return self.drive.waveform_key
        for index, actuator in enumerate(self.actuators):
            if actuator.frequency not in (None, self.drive.frequency):
                return f"actuators[{index}].frequency"
        return self.effects.first(lambda effect: effect.travels)
