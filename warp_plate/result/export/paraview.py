"""Time series of fields for ParaView: VTI files with a PVD index, or one VTKHDF file, written without VTK.

The plate is flat image data in the plane z = 0. Its point data are fields such as ``displacement_best`` [m], and the
fractions of each node's cell that lie in the ``target`` and under the ``actuators``. See "VTK XML Formats" and "VTKHDF
format specification" (temporal image data) in the VTK documentation.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np

from warp_plate.plate.weights import REGIONS, region_weights
from warp_plate.result.atomic_io import atomic_paths
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# By the first word of a field's name.
UNITS = {"displacement": "m", "velocity": "m/s", "rms": "m/s", "target": "1", "actuators": "1"}


def write_pvd(scene: Scene, times: np.ndarray, fields: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write an index and beside it a VTI file for each time; return their paths, the index last.

    Args:
        scene: The scene.
        times: (times,) times [s].
        fields: (times, ny, nx) fields, or (1, ny, nx) constant ones, by names that begin with a word of ``UNITS``; the
            first one is active.
        path: The index, a .pvd file.

    Raises:
        SceneError: there are no times, or a file cannot be written.
    """
    constant, digits = _constant_fields(scene, times), max(4, len(str(len(times) - 1)))
    parts = [path.with_name(f"{path.stem}-{index:0{digits}}.vti") for index in range(len(times))]
    with atomic_paths(*parts, path) as (*temporaries, index_file):
        for index, (time, temporary) in enumerate(zip(times.tolist(), temporaries, strict=True)):
            current = {name: field[min(index, len(field) - 1)] for name, field in fields.items()}
            temporary.write_text(_vti_text(scene, time, current | constant), encoding="utf-8")
        index_file.write_text(_pvd_text(times, parts), encoding="utf-8")
    return [*parts, path]


def write_vtkhdf(scene: Scene, times: np.ndarray, fields: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write all times into one .vtkhdf file, for ParaView 5.12 and later; return its path; see :func:`write_pvd`."""
    constant = {name: field[None] for name, field in _constant_fields(scene, times).items()}
    with atomic_paths(path) as (temporary,), h5py.File(temporary, "w") as file:
        root = file.create_group("VTKHDF")
        nx, ny = scene.grid.nodes
        root.attrs["Version"] = np.array([2, 0])
        root.attrs["Type"] = np.bytes_("ImageData")
        root.attrs["WholeExtent"] = np.array([0, nx - 1, 0, ny - 1, 0, 0])
        root.attrs["Origin"] = np.zeros(3)
        root.attrs["Spacing"] = np.array(_spacing(scene))
        root.attrs["Direction"] = np.eye(3).ravel()
        points = root.create_group("PointData")
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = len(times)
        steps["Values"] = times.astype(float)
        offsets = steps.create_group("PointDataOffsets")
        # Arrays are (time, y, x): the format leaves out the axis of a flat image's thickness.
        for name, field in {**fields, **constant}.items():
            points[name] = field.astype("<f4")
            points[name].attrs["units"] = UNITS[name.split("_")[0]]
            offsets[name] = np.minimum(np.arange(len(times)), len(field) - 1)
        # The active array, for older readers and for those of version 2.6 of the format.
        active = next(iter(fields))
        points.attrs["Scalars"] = np.bytes_(active.encode())
        points[active].attrs["Attribute"] = "Scalars"
    return [path]


def _constant_fields(scene: Scene, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the (ny, nx) covered fractions of each node's cell by name; refuse a series without times."""
    if not len(times):
        raise SceneError("holds no displacements; add record.times = [...] (seconds) to its scene and run it again")
    areas = {str(index): actuator.area for index, actuator in enumerate(scene.actuators)}
    by_overlap = scene.model_copy(update={"grid": scene.grid.model_copy(update={"load": "overlap"})})
    weights = region_weights(by_overlap, areas)
    actuators = np.minimum(weights[len(REGIONS) :].sum(axis=0), 1)
    return {"target": weights[REGIONS.index("target")], "actuators": actuators}


def _spacing(scene: Scene) -> tuple[float, float, float]:
    dx, dy = (side / (count - 1) for side, count in zip(scene.plate.size, scene.grid.nodes, strict=True))
    return dx, dy, 1.0


def _pvd_text(times: np.ndarray, parts: list[Path]) -> str:
    entries = "\n".join(
        f'<DataSet timestep="{time!r}" part="0" file={quoteattr(part.name)}/>'
        for time, part in zip(times.tolist(), parts, strict=True)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">
<Collection>
{entries}
</Collection>
</VTKFile>
"""


def _vti_text(scene: Scene, time: float, fields: Mapping[str, np.ndarray]) -> str:
    """Return image data at a time; fields: (ny, nx) by name, the first one active."""
    nx, ny = scene.grid.nodes
    extent, spacing = f"0 {nx - 1} 0 {ny - 1} 0 0", " ".join(map(repr, _spacing(scene)))
    arrays = []
    for name, field in fields.items():
        data = field.astype("<f4").tobytes()
        inline = base64.b64encode(len(data).to_bytes(8, "little") + data).decode()
        arrays.append(f'<DataArray type="Float32" Name={quoteattr(name)} format="binary">{inline}')
        arrays.append(
            f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{UNITS[name.split("_")[0]]}</InformationKey>'
        )
        arrays.append("</DataArray>")
    text = "\n".join(arrays)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="{spacing}">
<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1">{time!r}</DataArray></FieldData>
<Piece Extent="{extent}"><PointData Scalars={quoteattr(next(iter(fields)))}>
{text}
</PointData></Piece></ImageData></VTKFile>
"""
