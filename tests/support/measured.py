"""Random panels with the responses that a noisy scan of them measures, and what their modes say of any drive."""

import numpy as np
import scipy

from warp_plate import Scene
from warp_plate.fitting.measured_matrix import MeasuredMatrix
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.measured import MeasuredScene

DENSITY, THICKNESS, STIFFNESS, POISSON = 2700.0, 1e-3, 7e10, 0.3


def drawn_panel(random, most_modes=25.0, actuators=None):
    """Return a random aluminium panel, driven where it has about 5 to ``most_modes`` modes below."""
    size = random.uniform(0.15, 0.5) * np.array([1.0, random.uniform(0.5, 1.0)])
    kinds = random.choice(["clamped", "supported", "free"], 4, p=[0.4, 0.4, 0.2])
    kinds[random.integers(4)] = "clamped"
    patches = []
    for _ in range(int(actuators or random.integers(4, 9))):
        width = random.uniform(0.05, 0.1) * size[0]
        x, y = random.uniform(0.02, 0.98, 2) * (size - width)
        patches.append((x, x + width, y, y + width))
    # Weyl's law: k² = 4π N / area.
    stiffness = STIFFNESS * THICKNESS**3 / 12 / (1 - POISSON**2)
    wave = 4 * np.pi * random.uniform(5, most_modes) / size.prod()
    sides = random.uniform(0.25, 0.5, 2) * size
    x, y = random.uniform(0, 1, 2) * (size - sides)
    return Scene.from_tables(
        {
            "plate": {"size": tuple(size.tolist()), "thickness": THICKNESS, "young_modulus": STIFFNESS}
            | {"poisson_ratio": POISSON, "density": DENSITY},
            "edges": dict(zip(("left", "bottom", "right", "top"), kinds.tolist(), strict=True)),
            "drive": {"frequency": float(wave * np.sqrt(stiffness / DENSITY / THICKNESS) / 2 / np.pi)},
            "window": {"start": 0.0, "end": 0.1},
            "effects": {"loss_factor": {"eta": float(np.exp(random.uniform(np.log(0.003), np.log(0.05))))}},
            "target": {"area": (x, x + sides[0], y, y + sides[1])},
            "actuators": [{"name": f"a{k}", "area": area} for k, area in enumerate(patches)],
        }
    )


class TruePanel:
    """A panel with its exact motion at frequencies [Hz] (default: that of its drive)."""

    def __init__(self, scene, frequencies=None):
        self.scene = scene
        self.frequencies = np.array([scene.drive.frequency] if frequencies is None else frequencies)
        self.plate = solve_modes(scene, float(self.frequencies[-1]) * 1.01, density=0.6)
        forces = self.plate.actuator_forces()
        omega = 2j * np.pi * self.frequencies[:, None, None]
        each = [self.plate.respond_to_drives(np.array([[at]]), forces[None])[0] for at in self.frequencies]
        self.modal = np.stack(each) * omega  # (n, modes, actuators) velocities
        self.forms = [self.plate.kinetic_matrix(scene.target), self.plate.kinetic_matrix()]

    def factor(self, drive, line=0):
        """Return the localization factor of a drive."""
        motion = self.modal[line] @ drive
        inside, whole = ((motion.conj() @ form @ motion).real for form in self.forms)
        return inside / whole

    def largest_factor(self, line=0):
        inside, whole = (self.modal[line].conj().T @ form @ self.modal[line] for form in self.forms)
        return scipy.linalg.eigh(inside, whole, eigvals_only=True)[-1]

    def rows(self, points, line=0):
        """Return the velocities (points, actuators) at points."""
        return self.plate.at_points(points).T @ self.modal[line]

    def scan(self, random, noise=0.01, count=200, known=True, jitter=0.0):
        """Return the responses of about so many points with noise, a part of the root mean square."""
        width, height = self.scene.plate.size
        ny = round(np.sqrt(count * height / width))
        nx = count // ny
        steps = np.array([width / nx, height / ny])
        points = (np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2) + 0.5) * steps
        points = points + random.uniform(-jitter, jitter, points.shape) * steps
        rows = np.stack([self.rows(points, line) for line in range(len(self.frequencies))])
        variance = np.broadcast_to(noise**2 * np.mean(np.abs(rows) ** 2, axis=1, keepdims=True), rows.shape)
        drawn = random.normal(size=rows.shape) + 1j * random.normal(size=rows.shape)
        names = tuple(actuator.name for actuator in self.scene.actuators)
        noisy = rows + drawn * np.sqrt(variance / 2)
        variance = variance if known else None
        return MeasuredMatrix("scan", self.frequencies, noisy, points, names, variance, noise=variance)

    def measured_scene(self, **tables):
        """Return the scene of measured responses with the panel's target."""
        width, height = self.scene.plate.size
        measured = {"file": "scan.h5", "panel": (0.0, width, 0.0, height), **tables.pop("measured", {})}
        return MeasuredScene(measured=measured, target={"area": self.scene.target.area}, **tables)
