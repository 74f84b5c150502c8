"""Focus on the pane of ``focusing-glass`` with a lattice of resonators, by modes and by time reversal in time steps.

    python benchmarks/resonator_lattice.py [--columns 20] [--rows 14] [--ratio 3] [--resonance 2100] [--nodes 121 85]

prints the areas of the four foci in mm² as JSON. ``--ratio`` is the mass of the resonators over that of the pane, and 0
leaves them out. The time steps share nothing with the modes: a force on the focus is stepped to the patches, what they
receive between 1400 and 2000 Hz is reversed and stepped back from them, which is time reversal by reciprocity.
"""

from __future__ import annotations

import argparse
import json
import math

import numpy as np
import scipy

import warp_plate as wpl
from warp_plate.focusing.figures import measure_focus
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.weights import bilinear, node_positions, patches
from warp_plate.scene.model import Scene

BAND, RATE, TIME, HALF, VISCOUS = (1400.0, 2000.0), 20_000, 0.02, 1e-3, 500.0
# Part of the longest stable step, and points along the longer side at which areas are counted.
STABLE, POINTS = 0.95, 420


def scene_with(
    columns: int, rows: int, ratio: float, resonance: float, loss: float, nodes: tuple[int, int], density: float
) -> Scene:
    """Return the pane with a lattice of square patches 2 mm wide, and the band."""
    scene = Scene.load("focusing-glass")
    (width, height), pitch = scene.plate.size, (scene.plate.size[0] / columns, scene.plate.size[1] / rows)
    effects = {"damping": {"viscous": VISCOUS}}
    if ratio:
        mass = ratio * scene.plate.density * scene.plate.thickness * width * height / (columns * rows)
        stiffness = mass * (2 * math.pi * resonance) ** 2
        x, y = pitch[0] / 2, pitch[1] / 2
        one = {"area": (x - HALF, x + HALF, y - HALF, y + HALF), "mass": mass, "stiffness": stiffness}
        one |= {"damping": loss * math.sqrt(stiffness * mass), "lattice": (columns, rows), "pitch": pitch}
        effects["oscillators"] = [one]
    focus = scene.focus.model_dump() | {
        "lowest": BAND[0],
        "highest": BAND[1],
        "time": TIME,
        "rate": RATE,
        "energy": None,
    }
    return scene.with_tables(effects=effects, focus=focus, grid={"nodes": nodes, "modal_density": density})


def by_modes(scene: Scene) -> dict[str, object]:
    """Return the areas [mm²] of the methods."""
    found = wpl.focus(scene)
    areas = {name: (1e6 * method.focus_area).round(1).tolist() for name, method in found.methods.items()}
    return {"modes": found.modes, **areas, "contrast_db": found.methods["time_reversal"].contrast_db.round(1).tolist()}


def cell_area(scene: Scene) -> float:
    """Return the area of a cell of the grid [m²]."""
    return math.prod(side / (count - 1) for side, count in zip(scene.plate.size, scene.grid.nodes, strict=True))


class Stepped:
    """The pane on a grid, by central differences in time."""

    def __init__(self, scene: Scene) -> None:
        self.bending = make_bending(scene)
        self.stiffness, self.masses = system(self.bending)
        root = scipy.sparse.diags_array(1 / np.sqrt(self.masses))
        (fastest,) = scipy.sparse.linalg.eigsh(root @ self.stiffness @ root, 1, which="LA", return_eigenvectors=False)
        self.a_sample = math.ceil(math.sqrt(fastest) / (2 * STABLE * RATE))
        self.step = 1 / (RATE * self.a_sample)
        self.nodes = int(self.bending.moves.sum())
        area = np.where(np.arange(self.masses.size) < self.nodes, cell_area(scene), 0.0)
        self.lost = VISCOUS * area * self.step / (2 * self.masses)

    def _spread(self, fields: np.ndarray) -> np.ndarray:
        """Return (unknowns, n) of fields (n, ny, nx) or (ny, nx)."""
        moving = fields.reshape(-1, *self.bending.moves.shape)[:, self.bending.moves].T
        return np.pad(moving, ((0, self.masses.size - self.nodes), (0, 0)))

    def run(self, loads: np.ndarray, drives: np.ndarray, seen: np.ndarray | None) -> np.ndarray:
        """Return the motion (samples, seen, columns) at ends of samples, or the last one (unknowns, columns).

        ``loads`` (n, ny, nx) [N], ``drives`` (samples, n, columns), held in a sample.
        """
        loads = self._spread(loads)
        watched = None if seen is None else self._spread(seen).T
        before = now = np.zeros((self.masses.size, drives.shape[2]))
        scale = (self.step**2 / self.masses)[:, None]
        ahead, behind = 1 / (1 + self.lost[:, None]), 1 - self.lost[:, None]
        rows = []
        for drive in drives:
            force = loads @ drive
            for _ in range(self.a_sample):
                before, now = now, ahead * (2 * now - behind * before + scale * (force - self.stiffness @ now))
            if watched is not None:
                rows.append(watched @ now)
        return now if watched is None else np.array(rows)

    def field(self, motion: np.ndarray) -> np.ndarray:
        """Return the (columns, ny, nx) displacement."""
        field = np.zeros((motion.shape[1], *self.bending.moves.shape))
        field[:, self.bending.moves] = motion[: self.nodes].T
        return field


def by_steps(scene: Scene) -> dict[str, object]:
    """Return the areas [mm²] of time reversal in time steps."""
    stepped, cell = Stepped(scene), cell_area(scene)
    x, y = node_positions(scene)
    points = np.array(scene.focus.points)
    corners, shares = bilinear(points, scene.grid.nodes, scene.plate.size)
    at_points = np.zeros((len(points), y.size, x.size))
    np.add.at(at_points, (np.arange(len(points))[:, None], corners[..., 0], corners[..., 1]), shares)
    on_patches, samples = cell * patches(scene), round(TIME * RATE)
    pulse = np.zeros((samples, len(points), len(points)))
    pulse[0] = np.eye(len(points))
    received = stepped.run(at_points, pulse, on_patches)  # (samples, patches, foci)
    length = 2 * samples
    frequency = scipy.fft.rfftfreq(length, 1 / RATE)
    gain = np.sin(math.pi / 2 * np.clip(2 * frequency / BAND[0] - 1, 0, 1)) ** 2 * (frequency <= BAND[1])
    banded = scipy.fft.irfft(gain[:, None, None] * scipy.fft.rfft(received, length, axis=0), length, axis=0)[:samples]
    fields = stepped.field(stepped.run(on_patches, banded[::-1], None))
    (width, height), areas, contrasts = scene.plate.size, [], []
    fine_x, fine_y = (
        (np.arange(count) + 0.5) / count * side for count, side in ((POINTS, width), (POINTS * 2 // 3, height))
    )
    for field, point in zip(fields, points, strict=True):
        surface = scipy.interpolate.RectBivariateSpline(y, x, field)
        area, contrast = measure_focus(
            surface(fine_y, fine_x), scene.plate.size, point, float(surface.ev(point[1], point[0]))
        )
        areas.append(round(1e6 * area, 1))
        contrasts.append(round(contrast, 1))
    return {"nodes": scene.grid.nodes, "time_reversal": areas, "contrast_db": contrasts}


def main() -> None:
    """Print the areas."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=20)
    parser.add_argument("--rows", type=int, default=14)
    parser.add_argument("--ratio", type=float, default=3.0)
    parser.add_argument("--resonance", type=float, default=2100.0)
    parser.add_argument("--loss", type=float, default=0.0, help="loss factor of the resonators")
    parser.add_argument("--nodes", type=int, nargs=2, default=None, help="grid of time steps instead of modes")
    parser.add_argument("--density", type=float, default=1.5, help="grid.modal_density of the modes")
    taken = parser.parse_args()
    if taken.loss and taken.nodes:
        parser.error("--loss: the time steps leave it out; delete --nodes")
    numbers = taken.columns, taken.rows, taken.ratio, taken.resonance, taken.loss
    scene = scene_with(*numbers, tuple(taken.nodes or (43, 31)), taken.density)
    print(json.dumps({"lattice": numbers, **(by_modes(scene) if taken.nodes is None else by_steps(scene))}), flush=True)


if __name__ == "__main__":
    main()
