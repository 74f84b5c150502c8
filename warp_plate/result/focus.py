"""Waveforms that focus motion at points of a plate, and their results."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from warp_plate.result.hdf5 import FileFormat, write_along
from warp_plate.result.layouts import Dataset, read_fields, write_fields
from warp_plate.scene.errors import check_type
from warp_plate.scene.model import Scene

FORMAT = FileFormat("focus", 1)
FOCI = ("foci",)
UNITS = {"displacement": "m", "velocity": "m/s"}


@dataclass(frozen=True, eq=False)
class PanelFigures:
    """Effect of waveforms on other panels within the tolerances of ``[search.robust]``."""

    peak: Annotated[np.ndarray, Dataset("m or m/s", "motion at the focus at its moment", ("panel", "foci"))]
    crosstalk_db: Annotated[
        np.ndarray, Dataset("dB", "largest motion of the other foci over the peak", ("panel", "foci"))
    ]
    misfit: Annotated[
        np.ndarray | None, Dataset("1", "part of the burst or wish that is not followed", ("panel", "foci"))
    ] = None

    def summary(self) -> dict[str, float | int | None]:
        """Return the number of panels, the least peak, and the worst and median of the rest over the panels."""
        figures: dict[str, float | int | None] = {"number": len(self.peak)}
        figures["least_peak"] = float(np.abs(self.peak).min())
        for name, values in (("crosstalk_db", self.crosstalk_db), ("misfit", self.misfit)):
            worst = None if values is None else values.max(axis=1)
            figures[f"worst_{name}"] = None if worst is None else float(worst.max())
            figures[f"median_{name}"] = None if worst is None else float(np.median(worst))
        return figures


@dataclass(frozen=True, eq=False)
class FocusedWaveforms:
    """Waveforms of one method, a set for each focus, and their results.

    Peak, area and contrast are those of the quantity of the scene's ``[focus]``, in m or m/s, at the moment of the
    focus, which is that of the largest wished motion. The gap is that of its part from ``focus.lowest`` on; of a burst
    or wish, that of the motion's product with it.

    Attributes:
        limits: Limits that the waveforms for each focus attain: "energy", "peak", "energy, peak" or "".
        panels: What is left on other panels, with ``[search.robust]``.
    """

    waveforms: Annotated[
        np.ndarray,
        Dataset(
            "N/m², V or A",
            "drives, held between samples, of the actuators for each focus",
            ("foci", "actuator", "samples"),
            bounded=True,
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
    energy: Annotated[
        np.ndarray, Dataset("(N/m²)²·s, V²·s or A²·s", "sum over actuators of the integral of drive²", FOCI)
    ]
    gap: Annotated[np.ndarray, Dataset("1", "part of the bound of all waveforms that the peak lacks", FOCI)]
    limits: tuple[str, ...]
    misfit: Annotated[np.ndarray | None, Dataset("1", "part of the burst or wish that is not followed", FOCI)] = None
    electrical_energy: Annotated[
        np.ndarray | None, Dataset("J", "½ C ∫ d(V²)/dt dt over the times at which |V| rises", FOCI)
    ] = None
    panels: PanelFigures | None = None

    def __repr__(self) -> str:
        return f"<FocusedWaveforms {len(self.waveforms)} foci, {self.waveforms.shape[1]} actuators>"

    @property
    def crosstalk_db(self) -> np.ndarray:
        """(foci, foci) largest motion of each focus (column) under the waveforms for each (row), over the peak [dB]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.responses).max(axis=2) / np.abs(self.peak)[:, None]))


@dataclass(frozen=True, eq=False)
class FocusResult:
    """Result of ``focus``.

    Attributes:
        scene: The scene, with its ``[focus]``.
        modes: Number of modes up to ``focus.highest``.
        methods: Waveforms by method: "time_reversal", "one_bit", "inverse_filter", "optimum", "quiet",
            "robust_filter".
        condition: Condition of the inverse filters; None for waveforms of another panel.
        seconds: Wall time of the modes, the waveforms and the figures [s].
    """

    scene: Scene
    modes: int
    times: Annotated[np.ndarray, Dataset("s", "times of the responses", ("times",))]
    bound: Annotated[
        np.ndarray, Dataset("m or m/s", "upper bound of the peak of all waveforms within the limits", FOCI)
    ]
    methods: Mapping[str, FocusedWaveforms]
    condition: float | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    wished: Annotated[
        np.ndarray | None,
        Dataset("1", "wished motion from a file or array, in shape", ("foci", "samples"), bounded=True),
    ] = None

    def __repr__(self) -> str:
        return f"<FocusResult {len(self.bound)} foci: {', '.join(self.methods)}>"

    @property
    def half_wave(self) -> float:
        """Half of the length [m] of bending waves at ``focus.highest`` on the plate without its effects."""
        assert self.scene.focus is not None
        return math.sqrt(math.pi * self.scene.plate.kappa / (2 * self.scene.focus.highest))

    def resolution(self, method: str) -> np.ndarray:
        """Return (foci,) diameters of discs as large as the focus over half a wave, see :attr:`half_wave`."""
        return np.asarray(2 * np.sqrt(self.methods[method].focus_area / math.pi) / self.half_wave)

    @property
    def unit(self) -> str:
        """Unit of the motion."""
        assert self.scene.focus is not None
        return UNITS[self.scene.focus.quantity]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints below its tables: what else moves, of each method for all foci together."""
        lines = ((method.replace("_", " "), self._remarks(method)) for method in self.methods)
        return tuple(f"{name}: {', '.join(remarks)}" for name, remarks in lines if remarks)

    def _remarks(self, name: str) -> list[str]:
        method, others, remarks = self.methods[name], ~np.eye(len(self.bound), dtype=bool), []
        wish = "burst" if self.wished is None else "wish"
        if others.any():
            remarks.append(f"crosstalk at most {method.crosstalk_db[others].max():.1f} dB")
        if method.misfit is not None:
            remarks.append(f"{wish} followed within {_percent(method.misfit)}")
        if method.electrical_energy is not None:
            remarks.append(f"electrical energy at most {method.electrical_energy.max():.3g} J")
        if (panels := method.panels) is not None:
            worst = [f"{panels.crosstalk_db.max():.1f} dB"] if others.any() else []
            worst += [] if panels.misfit is None else [_percent(panels.misfit)]
            least = np.abs(panels.peak).min()
            worst.append(f"peak at least {least:.3g} {self.unit}")
            remarks.append(f"on {len(panels.peak)} panels {', '.join(worst)}")
        return remarks


def _percent(parts: np.ndarray) -> str:
    """Return the largest part in percent."""
    return f"{100 * parts.max():.3g} %"


def save_focus(result: FocusResult, path: str | Path) -> Path:
    """Write the waveforms and their results as an HDF5 file, and return its path."""
    check_type("result", result, FocusResult)
    with FORMAT.create(path) as file:
        names = [actuator.name for actuator in result.scene.actuators]
        write_along(file, "actuator", names, "1", "names of the actuators")
        write_fields(file, result)
    return Path(path)


def load_focus(path: str | Path) -> FocusResult:
    """Read a file of :func:`save_focus`, or raise a SceneError if it is missing, damaged or another kind of file."""
    with FORMAT.open(path) as file:
        return read_fields(FocusResult, file)
