"""Waveforms that focus motion at points of a plate, and their results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from warp_plate.result.hdf5 import Dataset, FileFormat, read_fields, write_along, write_fields
from warp_plate.scene.model import Scene

FORMAT = FileFormat("focus", 1)
FOCI = ("foci",)
UNITS = {"displacement": "m", "velocity": "m/s"}


@dataclass(frozen=True)
class FocusedWaveforms:
    """Waveforms of one method, a set for each focus, and their results.

    Peak, area and contrast are those of the quantity of the scene's ``[focus]``, in m or m/s, at the moment of the
    focus. The gap is that of its part from ``focus.lowest`` on; of a burst, that of the motion's product with it.

    Attributes:
        limits: Limits that the waveforms for each focus attain: "energy", "peak", "energy, peak" or "".
    """

    waveforms: Annotated[
        np.ndarray,
        Dataset(
            "N/m² or V",
            "drives, held between samples, of the actuators for each focus",
            ("foci", "actuator", "samples"),
        ),
    ]
    responses: Annotated[
        np.ndarray, Dataset("m or m/s", "motion at each focus under the waveforms for each", ("foci", "foci", "times"))
    ]
    fields: Annotated[
        np.ndarray,
        Dataset("m or m/s", "plate at the moment of each focus, in middles of cells", ("foci", "cell_y", "cell_x")),
    ]
    peak: Annotated[np.ndarray, Dataset("m or m/s", "motion at the focus at its moment", FOCI)]
    focus_area: Annotated[np.ndarray, Dataset("m²", "area around the focus that moves half as far", FOCI)]
    contrast_db: Annotated[np.ndarray, Dataset("dB", "peak over the root mean square of the rest", FOCI)]
    energy: Annotated[np.ndarray, Dataset("(N/m²)²·s or V²·s", "sum over actuators of the integral of drive²", FOCI)]
    gap: Annotated[np.ndarray, Dataset("1", "part of the bound of all waveforms that the peak lacks", FOCI)]
    limits: tuple[str, ...]
    misfit: Annotated[np.ndarray | None, Dataset("1", "part of the burst that the focus does not follow", FOCI)] = None
    electrical_energy: Annotated[
        np.ndarray | None, Dataset("J", "½ C ∫ d(V²)/dt dt over the times at which |V| rises", FOCI)
    ] = None

    @property
    def crosstalk_db(self) -> np.ndarray:
        """(foci, foci) largest motion of each focus (column) under the waveforms for each (row), over the peak [dB]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.responses).max(axis=2) / np.abs(self.peak)[:, None]))


@dataclass(frozen=True)
class FocusResult:
    """Result of ``focus``.

    Attributes:
        scene: The scene, with its ``[focus]``.
        modes: Number of modes up to ``focus.highest``.
        methods: Waveforms by method: "time_reversal", "one_bit", "inverse_filter", "optimum".
        seconds: Wall time of the modes, the waveforms and the figures [s].
    """

    scene: Scene
    modes: int
    times: Annotated[np.ndarray, Dataset("s", "times of the responses", ("times",))]
    bound: Annotated[
        np.ndarray, Dataset("m or m/s", "upper bound of the peak of all waveforms within the limits", FOCI)
    ]
    methods: Mapping[str, FocusedWaveforms]
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """Unit of the motion."""
        assert self.scene.focus is not None
        return UNITS[self.scene.focus.quantity]


def save_focus(found: FocusResult, path: str | Path) -> Path:
    """Write the waveforms and their results as an HDF5 file, and return its path."""
    with FORMAT.create(path) as file:
        names = [actuator.name for actuator in found.scene.actuators]
        write_along(file, "actuator", names, "1", "names of the actuators")
        write_fields(file, found)
    return Path(path)


def load_focus(path: str | Path) -> FocusResult:
    """Read a file of :func:`save_focus`, or raise a SceneError if it is missing, damaged or another kind of file."""
    with FORMAT.open(path) as file:
        return read_fields(FocusResult, file)
