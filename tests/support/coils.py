"""Coils, and a panel with them."""

import numpy as np

from support.scenes import scene_of
from warp_plate.plate.designs import scene_phasors

EXCITER = {"kind": "coil", "model": "DAEX25VT-4", "voltage": 2.0}
FREE = {"magnet": "free", "magnet_mass": 0.05}
SPRUNG = {"magnet": "sprung", "magnet_mass": 0.03, "magnet_stiffness": 800.0, "magnet_damping": 0.3}
COILS = [
    {**EXCITER, **FREE, "name": "free", "disc": (0.05, 0.06, 0.012)},
    {**EXCITER, **SPRUNG, "name": "sprung", "area": (0.11, 0.13, 0.1, 0.13), "inductance": 2e-4, "phase": 1.0},
    {
        "kind": "coil",
        "name": "fixed",
        "disc": (0.14, 0.05, 0.01),
        "current": 0.3,
        "force_factor": -2.0,
        "resistance": 6.0,
    },
    {"name": "pressed", "area": (0.02, 0.04, 0.12, 0.14), "force": 0.4},
]
# The same without lossy inductance, which only steady tones have.
LOSSLESS = {"eddy_resistance": (0.0, 0.0), "eddy_reactance": (0.0, 0.0)}
LOSSLESS_COILS = [{**row, **LOSSLESS} if "model" in row else row for row in COILS]


def panel(actuators=COILS, coupled=False, damping=20.0):
    """Return a panel with coils; its modes may be coupled by a damper on a patch."""
    tables = {"damping": {"viscous": damping}}
    if coupled:
        tables["loss_factor"] = {"eta": 0.01}
        tables["oscillators"] = [{"area": (0.12, 0.15, 0.05, 0.08), "mass": 0.002, "stiffness": 400.0, "damping": 1.0}]
    return scene_of(size=(0.2, 0.16), effects=tables).with_tables(actuators=actuators)


def dense_motion(plate, omega):
    """Return amplitudes of the modes, magnets and currents under the scene's drive, from one system of all unknowns."""
    scene = plate.scene
    rows = [
        (scene.actuators[index], mean) for index, mean in zip(plate.coils.indices, plate.coils.means.T, strict=True)
    ]
    modes, count = len(plate.frequencies), len(rows)
    system = np.zeros((modes + 2 * count,) * 2, dtype=complex)
    load = np.zeros(len(system), dtype=complex)
    stiffness = np.diag(plate.angular_frequencies**2 - omega**2) + 1j * (omega * plate.damping + plate.hysteretic)
    system[:modes, :modes] = stiffness
    phasors = scene_phasors(scene)
    for index, actuator in enumerate(scene.actuators):
        if actuator.kind == "pressure":
            load[:modes] += plate.actuator_forces()[:, index] * phasors[index]
    for index, (actuator, mean) in enumerate(rows):
        coil, magnet, current = actuator.coil, modes + index, modes + count + index
        stroke = np.zeros(len(system))
        stroke[:modes], stroke[magnet] = mean, -1.0
        spring = coil.suspension_stiffness + 1j * omega * coil.suspension_damping
        system += spring * np.outer(stroke, stroke)
        system[:modes, :modes] -= omega**2 * coil.moving_mass * np.outer(mean, mean)
        system[magnet, magnet] += coil.magnet_stiffness + 1j * omega * coil.magnet_damping - omega**2 * coil.magnet_mass
        system[:, current] -= coil.force_factor * stroke
        system[current] = 0
        system[current, current] = 1.0
        if actuator.voltage is not None:
            system[current, current] = coil.blocked_impedance(omega)
            system[current] += 1j * omega * coil.force_factor * stroke
        if coil.magnet_mass == 0:
            system[magnet] = system[:, magnet] = 0
            system[magnet, magnet] = 1.0
        load[current] = phasors[plate.coils.indices[index]]
    found = np.linalg.solve(system, load)
    return found[:modes], found[modes : modes + count], found[modes + count :]


def first_order_system(plate):
    """Return A and B of x' = A x + B drives, of displacements of modes and magnets, their rates, and currents of coils
    without lossy inductance."""
    scene, modes = plate.scene, len(plate.frequencies)
    coils = [scene.actuators[index] for index in scene.coil_indices]
    size = modes + len(coils)
    mass, loss, stiffness = np.eye(size), np.zeros((size, size)), np.zeros((size, size))
    loss[:modes, :modes], stiffness[:modes, :modes] = plate.damping, np.diag(plate.angular_frequencies**2)
    assert not any(actuator.coil.eddy_branches for actuator in coils)
    loads = np.zeros((size, len(scene.actuators)))
    for index, actuator in enumerate(scene.actuators):
        if actuator.kind == "pressure":
            loads[:modes, index] = plate.actuator_forces()[:, index]
    push, circuits = np.zeros((size, len(coils))), np.zeros((len(coils), len(coils)))
    by_rates, sources = np.zeros((len(coils), size)), np.zeros((len(coils), len(scene.actuators)))
    for index, (actuator, place) in enumerate(zip(coils, scene.coil_indices, strict=True)):
        coil, magnet = actuator.coil, modes + index
        patch = np.zeros(size)
        patch[:modes] = plate.coils.means[:, index]
        stroke = patch.copy()
        if coil.magnet_mass:
            mass[magnet, magnet] = coil.magnet_mass
            stiffness[magnet, magnet], loss[magnet, magnet] = coil.magnet_stiffness, coil.magnet_damping
            stroke[magnet] = -1.0
        mass += coil.moving_mass * np.outer(patch, patch)
        stiffness += coil.suspension_stiffness * np.outer(stroke, stroke)
        loss += coil.suspension_damping * np.outer(stroke, stroke)
        if actuator.current is not None:
            loads[:, place] = coil.force_factor * stroke
        elif coil.inductance == 0:
            loss += coil.force_factor**2 / coil.resistance * np.outer(stroke, stroke)
            loads[:, place] = coil.force_factor / coil.resistance * stroke
        else:
            push[:, index] = coil.force_factor * stroke
            by_rates[index] = -coil.force_factor * stroke / coil.inductance
            circuits[index, index] = -coil.resistance / coil.inductance
            sources[index, place] = 1 / coil.inductance
    inverse, nothing = np.linalg.inv(mass), np.zeros((size, size))
    matrix = np.block(
        [
            [nothing, np.eye(size), np.zeros(push.shape)],
            [-inverse @ stiffness, -inverse @ loss, inverse @ push],
            [np.zeros(by_rates.shape), by_rates, circuits],
        ]
    )
    return matrix, np.vstack([np.zeros_like(loads), inverse @ loads, sources])
