"""Universal files (datasets 15, 18, 55, 58, 58b, 164, 2411, 2414, 2420): modes, and responses between nodes.

Datasets of other types, such as lines (82) and headers (151), are not read, and of functions (58) only frequency
responses and their coherence. A direction −Z turns the sign of its end. Coordinate systems (18, 2420) have their axes
as the rows of a matrix and their origin, so that x of the file's own system is origin + x @ axes.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.fitting.measured_tables import FREQUENCY_UNITS, LENGTHS, motion_unit, response_unit
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.scene.fit import Fit, Measurement

UNIVERSAL = (".uff", ".unv", ".ufb")
READ = (15, 18, 55, 58, 164, 2411, 2414, 2420)
# Codes of dataset 58: a frequency response, a coherence. Of dataset 55: normal modes, and complex modes of displacement
# and of velocity.
RESPONSE, COHERENCE, NORMAL, COMPLEX = 4, 6, 2, (3, 7)
# Codes of ordinates by their order in time, those of a force and those that say nothing; direction across the plate.
ORDERS, FORCES, UNKNOWN, ACROSS = {8: 0, 11: 1, 12: 2}, (9, 13), (0, 1), 3
# Columns of nodes: numbers, systems of their coordinates and displacements, coordinates.
MOST_SETS = 2**18  # responses and coherences of 2000 points to 64 actuators, and more; some 3 s
BYTES_A_BYTE = 3.0, 9.0  # of memory that reading a byte of a text, or of a binary file, takes
NODES = ("node_nums", "def_cs", "disp_cs", "x", "y", "z")
MOTIONS = ("displacement", "velocity", "acceleration")
# Largest distance of a node from a point of the scene, relative to the largest distance of nodes and points.
NEAR = 0.01
# Least cosine of directions that are the same.
PARALLEL = 0.99


@dataclass(frozen=True, eq=False)
class UniversalFile:
    """The datasets of a universal file that are read, with directions along the axes of the file's own system."""

    sets: list[dict[str, Any]]
    nodes: dict[int, np.ndarray]  # x, y, z of the nodes in the file's own system and unit
    axes: dict[int, np.ndarray]  # (3, 3) axes, in rows, of the systems of displacements of nodes that have their own
    length: float  # length units in a metre
    force: float  # force units in a newton

    def places(self, *tables: Fit | Measurement | None) -> dict[int, np.ndarray]:
        """Return x, y of the nodes on the plate [m], by the first of the tables that states an origin, and a unit."""
        origin = next((table.origin for table in tables if table and table.origin), (0.0, 0.0))
        unit = next((LENGTHS[table.unit] for table in tables if table and table.unit), 1 / self.length)
        return {number: np.array(origin) + unit * place[:2] for number, place in self.nodes.items()}

    def of(self, *types: int) -> list[dict[str, Any]]:
        """Return the datasets of some types."""
        return [item for item in self.sets if item.get("type") in types]


def read_universal(path: Path) -> UniversalFile:
    """Return the datasets of a universal file; ValueError: it cannot be read."""
    try:
        import pyuff
    except ModuleNotFoundError:
        raise ValueError("universal files need pyuff: pip install 'warp-plate[uff]'") from None
    with path.open("rb") as opened:
        binary = b"    58b" in opened.read(2**20)
    size = path.stat().st_size
    refuse_beyond_memory(BYTES_A_BYTE[binary] * size, f"holds {size} bytes")
    number, sets = 0, []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyuff leaves files for Python to close
            file = pyuff.UFF(str(path))
            kinds = file.get_set_types()
            for number, kind in enumerate(kinds[:MOST_SETS]):
                if kind in READ:
                    sets.append(file.read_sets(number))
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(f"cannot be read as a universal file: dataset {number + 1}: {error}") from None
    if len(kinds) > MOST_SETS:
        raise ValueError(f"has {len(kinds)} datasets; at most {MOST_SETS} are read")
    functions = [item for item in sets if item.get("type") == 58]
    for number, item in enumerate(functions, 1):
        if item.get("func_type") in (RESPONSE, COHERENCE) and item["num_pts"] != len(item["data"]):
            points = f"record 7 states {item['num_pts']} points and {len(item['data'])} follow"
            raise ValueError(f"dataset 58, number {number} of {len(functions)}: {points}")
    units = next((item for item in sets if item["type"] == 164), {"length": 1.0, "force": 1.0})
    if not (units["length"] > 0 and units["force"] > 0):
        raise ValueError("dataset 164: factors of length and force must be above 0")
    frames = _frames(sets)
    nodes, axes = {}, {}
    for item in sets:
        for row in zip(*map(item.get, NODES), strict=False) if item["type"] in (15, 2411) else ():
            if not np.isfinite(row).all():
                raise ValueError(f"dataset {item['type']}: the row of node {row[0]:g} has a number that is not finite")
            number, system, turned = map(int, row[:3])
            own, origin = _cartesian(frames, system, number) or (np.eye(3), np.zeros(3))
            nodes[number] = origin + np.array(row[3:]) @ own
            if (displaced := _cartesian(frames, turned, number)) is not None:
                axes[number] = displaced[0]
    for item in functions:
        for end in ("rsp", "ref"):
            if (frame := axes.get(int(item[f"{end}_node"]))) is not None:
                item[f"{end}_dir"] = _turned(item[f"{end}_dir"], frame, item[f"{end}_node"])
    return UniversalFile(sets, nodes, axes, units["length"], units["force"])


def _frames(sets: Sequence[dict[str, Any]]) -> dict[int, tuple[np.ndarray, np.ndarray] | None]:
    """Return the axes (3, 3) and the origin (3,) of coordinate systems by number; None for those not Cartesian."""
    frames: dict[int, tuple[np.ndarray, np.ndarray] | None] = {}
    for item in sets:
        if item["type"] == 2420:
            for number, kind, rows in zip(item["CS_sys_labels"], item["CS_types"], item["CS_matrices"], strict=True):
                frames[int(number)] = (np.array(rows[:3]), np.array(rows[3])) if kind == 0 else None
        elif item["type"] == 18:
            columns = ("cs_num", "cs_type", "ref_cs_num", "ref_o", "x_point", "xz_point")
            if not all(np.isfinite(item[name]).all() for name in columns):
                raise ValueError("dataset 18 has a number that is not finite")
            for number, kind, reference, origin, along, beside in zip(*(item[name] for name in columns), strict=True):
                x, beside = along - origin, beside - origin
                y = np.cross(beside, x)
                axes = np.array([x, y, np.cross(x, y)])
                axes /= np.linalg.norm(axes, axis=1, keepdims=True)
                own, start = frames.get(int(reference)) or (np.eye(3), np.zeros(3))
                frames[int(number)] = (axes @ own, start + origin @ own) if kind == 0 else None
    return frames


def _cartesian(
    frames: dict[int, tuple[np.ndarray, np.ndarray] | None], system: int, node: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the axes and the origin of a node's coordinate system; None for the file's own."""
    if system in frames and frames[system] is None:
        raise ValueError(f"node {node} is in coordinate system {system}, which is not Cartesian; only these are read")
    return frames.get(system)


def _turned(direction: int, axes: np.ndarray, node: int) -> int:
    """Return a direction along one of the axes of a node, such as −3, as one along the file's own axes."""
    if not 1 <= abs(direction) <= 3:
        return direction
    vector = _sign(direction) * axes[abs(direction) - 1]
    axis = int(np.abs(vector).argmax())
    if abs(vector[axis]) < PARALLEL:
        raise ValueError(f"node {node} has a direction that is oblique to the axes of the file")
    return axis + 1 if vector[axis] > 0 else -axis - 1


def universal_modes(
    file: UniversalFile, fit: Fit | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Return frequencies [Hz], damping ratios, shapes across the plate (n, points) and x, y of the points [m].

    Shapes and points are None if the nodes have no places.
    """
    items = [*file.of(55), *map(_as_dataset_55, file.of(2414))]
    modes = [item for item in items if item.get("analysis_type") in (NORMAL, *COMPLEX)]
    if not modes:
        raise ValueError("has no mode (dataset 55 or 2414 of analysis type 2, 3 or 7)")
    frequencies, damping = np.array([_frequency_and_damping(item) for item in modes], dtype=float).T
    return frequencies, damping, *_shapes_and_points(file, fit, modes)


def _as_dataset_55(item: dict[str, Any]) -> dict[str, Any]:
    """Return a mode of dataset 2414 (at nodes) as one of dataset 55."""
    if item.get("dataset_location") != 1 or item["analysis_type"] not in (NORMAL, *COMPLEX):
        return {}
    values = np.array(item["data_at_node"])
    if item["data_type"] in (5, 6):
        values = values[:, ::2] + 1j * values[:, 1::2]
    fields = [item[f"record12_field{number}"] for number in (2, 5, 6)]
    shared = {name: item[name] for name in ("analysis_type", "node_nums")} | {"n_data_per_node": values.shape[1]}
    shared |= dict(zip(("freq", "modal_damp_vis", "modal_damp_his"), fields, strict=True))
    shared["eig"] = item["record13_field1"] + 1j * item["record13_field2"]
    return shared | ({"r3": values[:, 2]} if values.shape[1] > 2 else {})


def _frequency_and_damping(item: dict[str, Any]) -> tuple[float, float]:
    """Return frequency [Hz] and damping ratio of a mode, NaN for none."""
    if item["analysis_type"] == NORMAL:
        return item["freq"], item["modal_damp_vis"] or item.get("modal_damp_his", 0.0) / 2 or math.nan
    size = abs(item["eig"])
    return size / (2 * math.pi), (-item["eig"].real / size if size else 0.0) or math.nan


def _shapes_and_points(
    file: UniversalFile, fit: Fit | None, modes: Sequence[dict[str, Any]]
) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """Return (n, points) shapes along z and (points, 2) x, y [m]; None if the nodes have no places."""
    numbers, places = modes[0]["node_nums"], file.places(fit)
    if any(not np.array_equal(item["node_nums"], numbers) for item in modes):
        raise ValueError("its modes (dataset 55) are at different nodes")
    if not places:
        return None, None
    if missing := [int(number) for number in numbers if int(number) not in places]:
        raise ValueError(f"node {missing[0]} of a mode has no place (dataset 15 or 2411)")
    if any("r3" not in item for item in modes):
        raise ValueError("a mode has no motion across the plate (r3 of dataset 55)")
    for number, item in enumerate(modes, 1):
        if len(item["r3"]) != len(numbers):
            stated = f"{item['n_data_per_node']} values a node, but {len(item['r3'])} of r3 for {len(numbers)} nodes"
            raise ValueError(f"mode {number} of {len(modes)} (dataset 55): record 6 states {stated}")
    along = np.array([file.axes.get(int(number), np.eye(3))[:, 2] for number in numbers]).T
    shapes = np.array([sum(part * item.get(f"r{axis}", 0) for axis, part in enumerate(along, 1)) for item in modes])
    return shapes, np.array([places[int(number)] for number in numbers])


def universal_responses(
    file: UniversalFile, count: int, rows: Sequence[Measurement] | None, fit: Fit | None = None
) -> tuple[np.ndarray, np.ndarray | None, list[tuple[int, float] | None]]:
    """Return (1 + count, n) frequencies and responses across the plate, their coherences, and their units.

    Where nodes have places, responses are those between the points of ``rows``, or the other way round, as plates are
    reciprocal; otherwise they are in the order of the file.
    """
    functions = file.of(58)
    every = [item for item in functions if item.get("func_type") == RESPONSE]
    if not every:
        raise ValueError("has no frequency response (dataset 58 of function type 4)")
    sets = _across(every)
    located = rows is not None and all(int(item["rsp_node"]) in file.nodes for item in sets)
    chosen = _at_rows(file, sets, rows, fit) if located and rows is not None else sets
    if len(chosen) != count:
        named = ", ".join(map(_ends, chosen[:12])) + (", ..." if len(chosen) > 12 else "")
        given = f"has {len(chosen)} responses across the plate ({named})"
        raise ValueError(f"{given}; the scene has {count} tables [[measurement]] for it")
    if any(not np.array_equal(item["x"], chosen[0]["x"]) for item in chosen):
        raise ValueError("its frequency responses are at different frequencies")
    if real := [item for item in chosen if item["ord_data_type"] not in (5, 6)]:
        raise ValueError(f"the response {_ends(real[0])} is real; a response has real and imaginary parts")
    frequencies = chosen[0]["x"] * FREQUENCY_UNITS.get(_label(chosen[0], "abscissa").lower(), 1.0)
    responses = [math.prod(_sign(item[key]) for key in ("rsp_dir", "ref_dir")) * item["data"] for item in chosen]
    coherence = _coherence(functions, every, chosen)
    return np.vstack([frequencies, *responses]).astype(complex), coherence, [_unit(file, item) for item in chosen]


def _across(sets: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the responses across the plate: along Z, or else along the one direction, or none, that all have."""
    directions = [(abs(item["rsp_dir"]), abs(item["ref_dir"])) for item in sets]
    if len(set(directions)) == 1 and len(set(directions[0]) - {0}) <= 1:
        return sets
    chosen = [item for item, ends in zip(sets, directions, strict=True) if set(ends) <= {0, ACROSS}]
    if not chosen:
        named = ", ".join(map(_ends, sets[:12]))
        raise ValueError(f"has no response across the plate, along Z at both ends; it has {named}")
    return chosen


def _at_rows(
    file: UniversalFile, sets: list[dict[str, Any]], rows: Sequence[Measurement], fit: Fit | None
) -> list[dict[str, Any]]:
    """Return the response between the points of each row."""
    chosen = []
    for index, row in enumerate(rows):
        places = file.places(row, fit)
        points = np.array([*places.values(), *(other.point for other in rows)])
        near = NEAR * float(np.linalg.norm(np.ptp(points, axis=0)))
        found: list[dict[str, Any]] = []
        for ends in (("rsp_node", "ref_node"), ("ref_node", "rsp_node")):
            if row.force_at is not None or ends[0] == "rsp_node":
                found = found or [item for item in sets if _distance(places, item, ends, row) <= near]
        if len(found) != 1:
            stated = f"point = {list(row.point)}" + (f", force_at = {list(row.force_at)}" if row.force_at else "")
            nodes = ", ".join(f"{node} at {x:.4g}, {y:.4g}" for node, (x, y) in list(places.items())[:8])
            given = f"{len(found) or 'no'} responses are at measurement[{index}] ({stated}), which needs one"
            raise ValueError(f"{given}; nodes: {nodes}; origin and unit of [[measurement]] or [fit] place them")
        chosen += found
    return chosen


def _distance(places: dict[int, np.ndarray], item: dict[str, Any], ends: tuple[str, str], row: Measurement) -> float:
    """Return the largest distance of the nodes of a function from the points of a row, of those that are known."""
    there = [places.get(int(item[end])) for end in ends]
    away = [0.0 if at is None or place is None else float(np.linalg.norm(place - at))
            for place, at in zip(there, (row.point, row.force_at), strict=True)]  # fmt: skip
    return max(away)


def _ends(item: dict[str, Any]) -> str:
    """Return nodes and directions of a function, as in 2+Z/1-X."""
    names = {0: "", 1: "X", 2: "Y", 3: "Z", 4: "RX", 5: "RY", 6: "RZ"}
    ends = ((item[f"{end}_node"], item[f"{end}_dir"]) for end in ("rsp", "ref"))
    return "/".join(f"{node}{'' if not way else '+-'[way < 0]}{names.get(abs(way), '?')}" for node, way in ends)


def _sign(direction: int) -> int:
    return -1 if direction < 0 else 1


def _coherence(
    functions: list[dict[str, Any]], every: list[dict[str, Any]], chosen: list[dict[str, Any]]
) -> np.ndarray | None:
    """Return the coherence of each chosen response, by the order of as many of both or else by its ends."""
    found = [item for item in functions if item.get("func_type") == COHERENCE]
    if len(found) == len(every):
        of = {id(item): other for item, other in zip(every, found, strict=True)}
        paired = [of[id(item)] for item in chosen]
    else:
        ends = {_ends(item).replace("-", "+"): item for item in found}
        paired = [ends.get(_ends(item).replace("-", "+"), {}) for item in chosen]
    alike = all(np.array_equal(item.get("x", []), chosen[0]["x"]) for item in paired)
    return np.array([item["data"] for item in paired], dtype=float) if alike else None


def _label(item: dict[str, Any], axis: str) -> str:
    label = str(item.get(f"{axis}_axis_units_lab", "")).strip()
    return "" if label.upper() == "NONE" else label


def _unit(file: UniversalFile, item: dict[str, Any]) -> tuple[int, float] | None:
    """Return the order in time and the factor to SI units of a response; None if the file says nothing of them.

    Labels of units count, where they are known; otherwise the units of dataset 164.
    """
    code, under = item["ordinate_spec_data_type"], item["orddenom_spec_data_type"]
    if code not in (*ORDERS, *UNKNOWN):
        raise ValueError(f"the response {_ends(item)} has ordinates of type {code}; 8, 11 and 12 are motions")
    if under not in (*FORCES, *UNKNOWN):
        raise ValueError(f"the response {_ends(item)} is per ordinate of type {under}; 13 is a force")
    above, below = _label(item, "ordinate"), _label(item, "orddenom")
    order, labelled = ORDERS.get(code), response_unit(above) or (response_unit(f"{above}/{below}") if below else None)
    if labelled is None and (moved := motion_unit(above)) is not None:
        labelled = moved[0], moved[1] * file.force
    if order is not None and labelled is not None and labelled[0] != order:
        raise ValueError(
            f"the response {_ends(item)} states {MOTIONS[order]} (type {code}), but its unit {above} is of a "
            f"{MOTIONS[labelled[0]]}"
        )
    if labelled is None and order is not None:
        return order, file.force / file.length
    return labelled
