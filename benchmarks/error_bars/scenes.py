"""Random linear scenes: a number is a scene."""

import math

import numpy as np

from error_bars.elements import element_frequencies
from warp_plate import PlateSolver, Scene, SceneError

EFFECTS = (
    "damping", "material_damping", "tension", "foundation", "orthotropic", "oscillators", "springs", "layers", "map",
)  # fmt: skip
EDGES = ("clamped", "supported", "free")
INHOMOGENEOUS = ("layers", "map")
NOTHING, RESONANCE, NONLINEAR = "none", "resonance", ("stretching", "electrostatic", "moving_load")


def random_scene(number):
    """Return a scene, and the names of its effects."""
    rng = np.random.default_rng(number)
    long = rng.uniform(0.1, 0.4)
    size = (long, long / 12 ** rng.uniform(0, 1))[:: rng.choice([1, -1])]
    thickness, young, ratio, density = rng.uniform(3e-4, 2e-3), 10 ** rng.uniform(9, 11), rng.uniform(0.1, 0.45), 2000.0
    rigidity = young * thickness**3 / 12 / (1 - ratio**2)
    mass = density * thickness
    half_waves = rng.uniform(1, 5)
    frequency = math.pi / 2 * (half_waves / long) ** 2 * math.sqrt(rigidity / mass)
    edges = dict(zip(("left", "right", "bottom", "top"), rng.choice(EDGES, 4, p=(0.5, 0.3, 0.2)).tolist(), strict=True))
    if list(edges.values()).count("free") > 2:
        edges["left"] = "clamped"
    names = rng.permutation(EFFECTS)[: rng.choice([0, 1, 3], p=(0.2, 0.5, 0.3))].tolist()
    loss = 10 ** rng.uniform(-2.5, -0.3) * 2 * math.pi * frequency  # rate of decay of energy [1/s]
    effects, lowest = {}, rigidity * (math.pi / min(size)) ** 2
    if "damping" in names or ("material_damping" not in names and rng.random() < 0.8):
        effects["damping"] = {"viscous": loss * mass}
    if "material_damping" in names:
        effects["material_damping"] = {"time": 10 ** rng.uniform(-2.5, -1) / (2 * math.pi * frequency)}
    if "tension" in names:
        effects["tension"] = {"x": lowest * rng.uniform(-0.2, 2), "y": lowest * rng.uniform(-0.2, 2)}
    if "foundation" in names:
        bed = mass * (2 * math.pi * frequency) ** 2 * rng.uniform(0.01, 1)
        effects["foundation"] = {"stiffness": bed, "damping": loss * mass * rng.choice([0, 0.3])}
    if "orthotropic" in names:
        along, across = rigidity * rng.uniform(0.5, 2, 2)
        mean = math.sqrt(along * across)
        effects["orthotropic"] = {"Dx": along, "Dy": across, "D1": ratio * mean, "Dxy": (1 - ratio) / 2 * mean}
    if "oscillators" in names:
        own = mass * math.prod(size) * rng.uniform(0.01, 0.2)
        stiffness = own * (2 * math.pi * frequency * rng.uniform(0.3, 3)) ** 2
        effects["oscillators"] = [{
            "area": _patch(rng, size, 0.1, 0.3), "mass": own, "stiffness": stiffness,
            "damping": 0.05 * math.sqrt(own * stiffness),
        }]  # fmt: skip
    if "springs" in names:
        stiff = 10 ** rng.uniform(-1, 3) * rigidity
        edges["top"] = {"translation": stiff / min(size) ** 3, "rotation": stiff / min(size) * rng.choice([0, 1])}
    if "layers" in names:
        effects["layers"] = [
            {"area": _patch(rng, size, 0.1, 0.45), "thickness": thickness * rng.uniform(0.05, 1),
             "young_modulus": young * 10 ** rng.uniform(-1, 1), "density": density * rng.uniform(0.3, 3),
             "both": bool(rng.random() < 0.3)}
        ]  # fmt: skip
    if "map" in names:
        shape = rng.integers(1, 4, 2)
        key = rng.choice(["thickness", "young_modulus", "density"])
        effects["variation"] = {key: rng.uniform(0.7, 1.3, shape + (shape.sum() == 2)).tolist()}
    periods = rng.choice([rng.uniform(2, 8), rng.uniform(10, 40)])
    start = periods / frequency
    target = {"area": _patch(rng, size, 0.2, 0.7)}
    if "layers" not in names and rng.random() < 0.5:
        radius = min(size) * rng.uniform(0.15, 0.45)
        centre = [rng.uniform(radius, side - radius) for side in size]
        angles = np.sort(rng.uniform(0, 2 * math.pi, rng.integers(3, 7)))
        corners = [(centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle)) for angle in angles]
        target = {"disc": (*centre, radius)} if rng.random() < 0.6 else {"polygon": corners}
    actuators = [
        {"name": str(index), "area": _patch(rng, size, *rng.choice([(0.01, 0.05), (0.05, 0.2), (0.2, 0.5)]))}
        for index in range(rng.integers(1, 5))
    ]
    for actuator in actuators:
        actuator["phase"], actuator["magnitude"] = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 1)
    tables = {
        "plate": {"size": size, "thickness": thickness, "young_modulus": young, "poisson_ratio": ratio,
                  "density": density},
        "edges": edges, "effects": effects, "target": target, "actuators": actuators,
        "drive": {"frequency": frequency}, "window": {"start": start, "end": start + rng.uniform(1, 8) / frequency},
    }  # fmt: skip
    scene = Scene.from_tables(tables)
    if "material_damping" not in names and rng.random() < 0.2:
        names = [*names, RESONANCE]
        resonance = element_frequencies(scene, 6, 6)[rng.integers(1, 6)]
        width = loss / (4 * math.pi) if "damping" in effects else 0.02 * resonance
        away = rng.choice([-1, 1]) * rng.uniform(0.05, 1) * width
        scene = scene.with_tables(drive={"frequency": resonance + away})
    return scene, names or [NOTHING]


def random_nonlinear_scene(number):
    """Return a scene that is not linear in its drives, and the names of its effects."""
    rng = np.random.default_rng([number, 2])
    names = INHOMOGENEOUS
    while set(names) & set(INHOMOGENEOUS):  # whose judge takes uniform plates
        scene, names = random_scene(int(rng.integers(10**6)))
    kinds = [NONLINEAR[number % 3], *rng.choice(NONLINEAR, rng.choice([0, 1, 2], p=(0.6, 0.3, 0.1))).tolist()]
    plate, period = scene.plate, 1 / scene.drive.frequency
    scene = scene.with_tables(grid={"nodes": [max(11, round(40 * side / sum(plate.size))) for side in plate.size]})
    phasors = np.array([[actuator.magnitude for actuator in scene.actuators]])
    times = np.linspace(0, scene.window.end, 60)[1:]
    moved = np.abs(PlateSolver(scene, "cpu").run(phasors, times).displacement).max()
    amplitude = plate.thickness * (10 ** rng.uniform(-1, 0.4) if "stretching" in kinds else 0.1)
    scale = amplitude / moved
    tables = scene.model_dump()
    effects, drive = tables["effects"], tables["drive"]
    for actuator in tables["actuators"]:
        actuator["magnitude"] *= scale
    if "stretching" in kinds:
        effects["stretching"] = {}
    if "electrostatic" in kinds:
        volts, bias = 100.0, rng.choice([0, rng.uniform(20, 300)])
        drive["electrostatic"] = {"bias": bias, "gain": scale / (2 * bias * volts + volts**2 / 2)}
        for actuator in tables["actuators"]:
            actuator["magnitude"] *= volts / scale
    if "moving_load" in kinds:
        pressed = scale * sum(math.prod(np.diff(actuator.area)[::2]) for actuator in scene.actuators)
        points = [np.array([rng.uniform(-0.1, 1.1) * side for side in plate.size]) for _ in range(2)]
        crossing = scene.window.end * rng.uniform(0.5, 1)
        effects["moving_load"] = {
            "force": pressed * rng.uniform(0.3, 3), "start": points[0], "velocity": (points[1] - points[0]) / crossing,
            "size": min(plate.size) * rng.choice([0, rng.uniform(0.02, 0.3)], p=(0.2, 0.8)),
            "frequency": rng.choice([None, 1 / period * rng.uniform(0.3, 1.5)]),
        }  # fmt: skip
    if rng.random() < 0.2:
        duration = scene.window.end * rng.uniform(0.3, 0.8)
        start = rng.uniform(0, 0.5) * scene.window.start
        drive["burst"] = {"start": start, "duration": duration, "ramp": duration * rng.uniform(0.05, 0.5)}
    tables["grid"] = {"nodes": (27, 27)}
    return Scene.from_tables(tables), [*dict.fromkeys(kinds), *names]


def random_grid(scene, number):
    """Return the scene with a random grid."""
    rng = np.random.default_rng([number, 1])
    (width, height), cells = scene.plate.size, rng.integers(12, 34)
    nodes = [max(9, 1 + round(cells * side / max(width, height))) for side in (width, height)]
    grids = [{"nodes": nodes, "order": 2, "load": load, "precision": "float64"} for load in ("overlap", "nodes")]
    grids.append({"nodes": nodes, "order": 4, "load": "moments", "precision": "float64"})
    for grid in rng.permutation(grids):
        made = scene.with_tables(grid=grid)
        try:
            PlateSolver(made, "cpu")
        except SceneError:
            continue
        return made
    return None


def _patch(rng, size, least, most):
    """Return a rectangle whose sides are parts of the plate's, anywhere on it."""
    area = []
    for side in size:
        part = side * rng.uniform(least, most)
        low = rng.choice([rng.uniform(0, side - part), 0, side - part], p=(0.9, 0.05, 0.05))
        area += [low, low + part]
    return tuple(area)
