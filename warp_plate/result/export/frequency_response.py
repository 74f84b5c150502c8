"""Frequency responses as CSV, as universal file format and as HDF5."""

from __future__ import annotations

import csv
import importlib.util
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.result import hdf5
from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.frequency_response import FrequencyResponse
from warp_plate.scene.errors import SceneError

FORMAT = hdf5.FileFormat("frequency response", 1)
EXTRA = "pip install 'warp-plate[uff]'"
# Codes of dataset 58: the quantity that responds, frequency, excitation force; a frequency response; along z.
RESPONDING = {"receptance": 8, "mobility": 11, "accelerance": 12}
FREQUENCY, FORCE, RESPONSE_FUNCTION, ALONG_Z = 18, 13, 4, 3
NAME_LENGTH = 10  # characters of names in dataset 58
# Doubles of a value in a binary dataset 58: frequency, real and imaginary part.
DOUBLES = 3


def write_csv(response: FrequencyResponse, path: Path) -> None:
    """Write a row for each frequency [Hz]: real and imaginary part of each response, and what goes with it."""
    heading = ["frequency [Hz]"]
    for label in response.labels:
        heading += [f"Re {label} [{response.unit}]", f"Im {label} [{response.unit}]"]
    heading += ["localization factor [1]", "bound [1]"]
    heading += [f"mean square velocity, {name} [(m/s)²/N²]" for name in response.inputs]
    parts = np.stack([response.responses.real, response.responses.imag], axis=1).reshape(-1, len(response.frequencies))
    columns = [response.frequencies, *parts, response.localization_factor, response.bound]
    rows = np.column_stack([*columns, *response.mean_square_velocity])
    with atomic_paths(path) as (temporary,), temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(heading)
        np.savetxt(file, rows, fmt=["%.15g", *["%.9g"] * (rows.shape[1] - 1)], delimiter=",")


def missing_uff() -> str | None:
    """Return a sentence on what is missing for files in universal file format, or None."""
    return None if importlib.util.find_spec("pyuff") else f"universal files need pyuff: {EXTRA}"


def write_uff(response: FrequencyResponse, path: Path) -> None:
    """Write units (dataset 164), nodes (15), and each response as a binary dataset 58, in double precision.

    The nodes are numbered from 1: first the inputs, then the points. Text would keep six digits of a frequency, too few
    for a sharp resonance.

    Raises:
        SceneError: pyuff is missing, or the file cannot be written.
    """
    if (problem := missing_uff()) is not None:
        raise SceneError(f"{path}: {problem}")
    import pyuff

    places = np.vstack([response.input_places, response.points])
    numbers = np.arange(1, len(places) + 1)
    units = {"type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1, "temp_offset": 0.0}
    units |= dict.fromkeys(("length", "force", "temp"), 1.0)
    nodes = {"type": 15, "node_nums": numbers, "x": places[:, 0], "y": places[:, 1], "z": np.zeros(len(places))}
    functions = [_dataset_58(response, index) for index in range(len(response.responses))]
    with atomic_paths(path) as (temporary,):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves files for Python to close
            pyuff.UFF(str(temporary)).write_sets([units, nodes, *functions], mode="overwrite")
        # pyuff states the bytes of real data at even spacing.
        count = 8 * len(response.frequencies)
        stated, true = (f"{11:12d}{size:12d}{0:6d}".encode() for size in (count, DOUBLES * count))
        temporary.write_bytes(temporary.read_bytes().replace(stated, true))


def _dataset_58(response: FrequencyResponse, index: int) -> dict[str, Any]:
    """Return the dataset 58 of a response."""
    which, point = divmod(index, len(response.points))
    numerator, denominator = response.unit.rsplit("/", 1)
    return {
        "type": 58,
        "binary": 1,
        "func_type": RESPONSE_FUNCTION,
        "id1": _ascii(f"{response.quantity} {response.labels[index]}")[:80],
        "id2": _ascii(response.title)[:80] or "NONE",
        "ver_num": 0,
        "rsp_ent_name": "NONE",
        "rsp_node": len(response.inputs) + point + 1,
        "rsp_dir": ALONG_Z,
        "ref_ent_name": _ascii(response.inputs[which]).replace(" ", "_")[:NAME_LENGTH],
        "ref_node": which + 1,
        "ref_dir": ALONG_Z,
        "abscissa_spacing": 0,
        "abscissa_spec_data_type": FREQUENCY,
        "abscissa_axis_lab": "Frequency",
        "abscissa_axis_units_lab": "Hz",
        "ordinate_spec_data_type": RESPONDING[response.quantity],
        "ordinate_axis_lab": response.quantity.capitalize(),
        "ordinate_axis_units_lab": numerator.strip("()").replace("²", "^2"),
        "orddenom_spec_data_type": FORCE,
        "orddenom_axis_lab": "Force",
        "orddenom_axis_units_lab": denominator,
        "x": response.frequencies,
        "data": response.responses[index],
    }


def _ascii(text: str) -> str:
    """Return text for a file in universal format, which knows ASCII alone."""
    return text.replace("→", "->").replace("×", "x").encode("ascii", "replace").decode()


def write_hdf5(response: FrequencyResponse, path: Path) -> None:
    """Write a file laid out as netCDF-4 lays out its own, with the dimensions frequency, pair, input and mode."""
    unit, along = response.unit.replace("²", "^2"), [("pair", "frequency"), ("frequency",), ("input", "frequency")]
    text = h5py.string_dtype()
    pairs, places = response.pairs, np.array([point for _, point in response.pairs])
    with FORMAT.create(path) as file:
        file.attrs.update({"title": response.title, "quantity": response.quantity})
        for name, values, units, meaning, axes in (
            ("frequency", response.frequencies, "Hz", "frequency", ()),
            ("pair", np.array(response.labels, dtype=text), "1", "input and point of a response", ()),
            ("input", np.array(response.inputs, dtype=text), "1", "actuator or point on which 1 N acts", ()),
            ("mode", np.arange(1, len(response.natural_frequencies) + 1), "1", "number of the mode in the range", ()),
            ("pair_input", np.array([name for name, _ in pairs], dtype=text), "1", "input", ("pair",)),
            ("pair_x", places[:, 0], "m", "x of the point", ("pair",)),
            ("pair_y", places[:, 1], "m", "y of the point", ("pair",)),
            ("real", response.responses.real, unit, f"real part of the {response.quantity}", along[0]),
            ("imaginary", response.responses.imag, unit, f"imaginary part of the {response.quantity}", along[0]),
            ("localization_factor", response.localization_factor, "1", "localization factor of the drive", along[1]),
            ("bound", response.bound, "1", "bound on the localization factor", along[1]),
            ("mean_square_velocity", response.mean_square_velocity, "(m/s)^2/N^2", "mean square velocity", along[2]),
            ("natural_frequency", response.natural_frequencies, "Hz", "natural frequency, undamped", ("mode",)),
            ("loss_factor", response.loss_factors, "1", "loss factor", ("mode",)),
        ):
            hdf5.write_along(file, name, values, units, meaning, axes)


# Writers of the formats, and the endings of their files.
WRITERS: Mapping[str, tuple[str, Callable[[FrequencyResponse, Path], None]]] = {
    "csv": (".csv", write_csv),
    "uff": (".uff", write_uff),
    "hdf5": (".h5", write_hdf5),
}
