"""Random isotropic panels, and what a fit of each begins with: a number is a panel."""

import math
from dataclasses import dataclass

import numpy as np

from support.grid_modes import natural_modes
from warp_plate import Scene

# Cells of the lattice along the longer side; sensors and the corners of the actuator are points of the lattice, which
# are nodes of all grids. The grid of which the frequencies of the band are taken, in cells of the lattice.
LATTICE, COARSE = 8, 3
SENSORS, MODES, FREQUENCIES = 6, 10, 150
# The band, from LOWEST of the first natural frequency to HIGHEST of the last.
LOWEST, HIGHEST = 0.85, 1.03
# Loss factors: constant ones, and of viscous damping at the upper end of the band.
CONSTANT, AT_THE_END = (0.03, 0.1), (0.02, 0.05)
# Factors from the truth to the start of a fit, at most, and from the start to the ends of its ranges; second those of
# springs.
START, RANGE = (1.5, 3.0), (3.0, 30.0)
MODULUS, LOSS, VISCOUS = "plate.young_modulus", "effects.loss_factor.eta", "effects.damping.viscous"


@dataclass(frozen=True)
class Panel:
    """A panel.

    Attributes:
        scene: The true panel with its tables ``[[measurement]]``, without a grid.
        truth: True values of the numbers to fit, by key.
        start: Wrong values that a fit starts from, by key.
        ranges: Lowest and highest values, by key.
        frequencies: (n,) frequencies of the responses [Hz].
        lattice: Cells of the lattice along x and y.
    """

    scene: Scene
    truth: dict[str, float]
    start: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    frequencies: np.ndarray
    lattice: tuple[int, int]

    @property
    def springs(self) -> list[str]:
        """Keys of the springs."""
        return [key for key in self.truth if key.startswith("edges")]


def random_panel(number: int) -> Panel:
    """Return a panel; the odd ones have springs at one or two edges and viscous damping, the others a loss factor."""
    rng = np.random.default_rng(number)
    lattice = (LATTICE, int(rng.integers(5, 8)))
    long = rng.uniform(0.15, 0.5)
    size = (long, long * lattice[1] / LATTICE * rng.uniform(0.95, 1.05))
    plate = {"size": size, "thickness": long / rng.uniform(100, 300), "young_modulus": 10 ** rng.uniform(9.3, 11.2),
             "poisson_ratio": rng.uniform(0.2, 0.42), "density": 10 ** rng.uniform(3, 3.9)}  # fmt: skip
    rigidity = plate["young_modulus"] * plate["thickness"] ** 3 / 12 / (1 - plate["poisson_ratio"] ** 2)
    edges = _edges(rng, number % 2, rigidity, min(size))
    scene = Scene.from_tables({
        "plate": plate, "edges": edges, "drive": {"frequency": 100.0},
        "target": {"area": (0, size[0] / 2, 0, size[1] / 2)}, **_instruments(rng, size, lattice),
    })  # fmt: skip
    grid = natural_modes(scene.with_tables(grid={"nodes": [1 + COARSE * cells for cells in lattice]}), MODES + 3)
    natural = grid.frequencies[grid.frequencies > 0][:MODES]
    band = np.linspace(LOWEST * natural[0], HIGHEST * natural[-1], FREQUENCIES)
    truth = {MODULUS: plate["young_modulus"]}
    if number % 2:
        surface = plate["density"] * plate["thickness"]
        truth[VISCOUS] = _logarithmic(rng, AT_THE_END) * 2 * math.pi * float(band[-1]) * surface
        effects = {"damping": {"viscous": truth[VISCOUS]}}
    else:
        truth[LOSS] = _logarithmic(rng, CONSTANT)
        effects = {"loss_factor": {"eta": truth[LOSS]}}
    for side, edge in edges.items():
        truth |= {} if isinstance(edge, str) else {f"edges.{side}.{key}": value for key, value in edge.items()}
    spring = {key: int(key.startswith("edges")) for key in truth}
    start = {key: value * START[spring[key]] ** rng.uniform(-1, 1) for key, value in truth.items()}
    ranges = {key: (value / RANGE[spring[key]], value * RANGE[spring[key]]) for key, value in start.items()}
    return Panel(scene.with_tables(effects=effects), truth, start, ranges, band, lattice)


def _logarithmic(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return math.exp(rng.uniform(*np.log(ends)))


def _edges(rng: np.random.Generator, springs: int, rigidity: float, short: float) -> dict:
    """Return the four edges; two at least are held, unless all are free."""
    held = ["clamped", "supported"]
    names = rng.permutation(["left", "right", "bottom", "top"]).tolist()
    if not springs:
        kinds = ["free"] * 4 if rng.random() < 0.15 else [*rng.choice(held, 2), *rng.choice([*held, "free", "free"], 2)]
        return dict(zip(names, map(str, kinds), strict=True))
    sprung = [
        {"translation": rigidity / short**3 * 10 ** rng.uniform(1, 3.3),
         "rotation": rigidity / short * 10 ** rng.uniform(-0.5, 1)}
        for _ in range(rng.integers(1, 3))
    ]  # fmt: skip
    others = [*rng.choice(held, 1), *rng.choice([*held, "free"], 2)]
    return dict(zip(names, [*sprung, *map(str, others)][:4], strict=True))


def _instruments(rng: np.random.Generator, size: tuple[float, float], lattice: tuple[int, int]) -> dict:
    """Return an actuator of one cell of the lattice, and sensors off the edges and off the actuator."""
    cell = np.array(size) / lattice
    corner = rng.integers(1, np.array(lattice) - 1)
    points = [(i, j) for i in range(1, lattice[0]) for j in range(1, lattice[1])
              if not (0 <= i - corner[0] <= 1 and 0 <= j - corner[1] <= 1)]  # fmt: skip
    chosen = cell * rng.permutation(points)[:SENSORS]
    area = np.stack([cell * corner, cell * (corner + 1)], axis=1).ravel()
    actuator = {"name": "shaker", "area": area.tolist()}
    sensors = [{"actuator": "shaker", "point": point, "quantity": "accelerance"} for point in chosen.tolist()]
    return {"actuators": [actuator], "measurement": sensors}
