"""Memory and work of a run and of a search, by laws of their sizes: known before anything is computed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from warp_plate.accuracy.configurations import NODE_STEP_SECONDS, RELATIVE_COST
from warp_plate.modal.energies import AMPLITUDES_AT_ONCE
from warp_plate.modal.expected import expected_modes
from warp_plate.modal.gram import ROWS
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.scheme import Discretization, grid_bytes, steps_bytes
from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.design_variables import with_common_step
from warp_plate.problem.methods import history_bytes, optimizer_bytes
from warp_plate.problem.objectives import Objectives, make_objectives
from warp_plate.problem.parametrization import Parametrization, parametrization_of
from warp_plate.problem.starts import BRENT_STEPS, candidate_frequencies
from warp_plate.problem.uncertainty import scenario_bytes
from warp_plate.resolve import Resolved
from warp_plate.scene.model import Scene
from warp_plate.solve import response
from warp_plate.solve.parts import CPU_BYTES, plates_a_launch

# Bytes of the program itself, with its libraries and compiled kernels.
PROGRAM = 2.5e8
# Numbers, by modes, of the forces and Gram matrices of the designs that are in memory at a time, and bytes of each; and
# of each number of the motion of those that are computed at once.
DESIGN_NUMBERS, DESIGN_BYTES, MOTION_BYTES = 2**24, 9.0, 200.0
# Time of a core by modes for each number of a design of a place or frequency of its own [s].
DESIGN_SECONDS = 2e-7
# Bytes for each number of a unit drive in memory, for each pair of drives' parts (indices and energies), and for each
# number of a region's Gram matrix (copies for bounds and search).
UNIT_BYTES, PAIR_BYTES, MATRIX_BYTES = 25.0, 60.0, 60.0
# Numbers of a plate in time steps for each node, of plain plates and in moment form; and the time of a node-step of
# this form, relative to plain plates.
PLAIN_NUMBERS, MOMENT_NUMBERS, MOMENT_SECONDS = 9.0, 17.0, 2.5
# Functions along each side for error estimates, relative to those of the modal engine, and the most in all.
REFERENCE_DENSITY, MOST_REFERENCE = 1.5, 3000
# Bytes of modes for each number of their vectors, of the products of their free motions, and of those that a search
# holds for each region.
VECTOR_BYTES, PRODUCT_BYTES, FORM_BYTES = 32.0, 50.0, 32.0


@dataclass(frozen=True)
class Cost:
    """Work and memory of a run or a search."""

    candidates: int  # largest number of designs that are evaluated
    plates: int  # largest number of plates that are run in time steps; 0 by modes
    node_steps: float  # node-steps of these plates
    seconds: float | None  # about the time of a core, within a factor of four; None on GPUs, and by modes in air
    memory: Mapping[str, float]  # largest memory besides PROGRAM [bytes], by the key that determines it


def cost_of_run(resolved: Resolved) -> Cost:
    """Return the cost of a run of a scene with its error estimate."""
    highest = highest_frequency(resolved.scene)
    seconds = expected_modes(resolved.scene, highest).seconds if resolved.by_modes else 0.0
    return _cost(resolved, 1, 1, 0, _plate_memory(resolved, highest), seconds)


def cost_of_search(resolved: Resolved) -> Cost:
    """Return the cost of the search of a scene that ``resolve_search`` returned; SceneError: it cannot be searched."""
    parametrization = parametrization_of(with_common_step(resolved.scene, not resolved.by_modes))
    scene, search = parametrization.scene, parametrization.scene.search
    resolved, evaluator = resolved.with_scene(scene), evaluator_of(resolved, parametrization)
    scenarios = search.robust.scenarios if search.robust is not None else 1
    tried = search.particles * search.iterations
    if search.method == "exact":
        frequencies = None if parametrization.only_drives else candidate_frequencies(parametrization, resolved.solver())
        tried = 1 if frequencies is None else frequencies.size + BRENT_STEPS
    candidates = max(1, len(scene.targets)) * tried
    measured = 0
    if not resolved.by_modes and parametrization.quadratic:
        measured = response.count_unit_drives(len(scene.actuators))
        measured *= 1 + (scenarios if search.robust is not None and evaluator != "direct" else 0)
    simulated = candidates * scenarios if evaluator == "direct" else 0
    memory = search_memory(parametrization, resolved, make_objectives(resolved.grid))
    by_modes = 0.0
    if resolved.by_modes:
        expected, robust = expected_modes(scene, _highest(scene)), search.robust is not None
        by_modes = expected.seconds * (1 + scenarios * robust)
        if not parametrization.only_drives:
            numbers = design_numbers(len(scene.actuators), expected.functions, expected.modes)
            by_modes += DESIGN_SECONDS * candidates * scenarios * numbers
    return _cost(resolved, candidates, simulated, measured, memory, by_modes)


def _cost(
    resolved: Resolved, candidates: int, simulated: int, measured: int, memory: Mapping[str, float], by_modes: float
) -> Cost:
    """Return the cost of plates in the scene's precision and of those that are measured in float64, or the time
    ``by_modes`` [s] on a CPU, which does not include the air."""
    on_cpu = not resolved.device.startswith("cuda")
    if resolved.by_modes:
        return Cost(candidates, 0, 0.0, by_modes if on_cpu and not resolved.scene.effects.air else None, memory)
    grid, node_steps, seconds = resolved.scene.grid, node_steps_of(resolved), None
    if on_cpu:
        relative = [RELATIVE_COST[grid.order, precision] for precision in (grid.precision, "float64")]
        seconds = NODE_STEP_SECONDS["cpu"] * node_steps * (simulated * relative[0] + measured * relative[1])
        seconds *= MOMENT_SECONDS if _moment_form(resolved) else 1
    return Cost(candidates, simulated + measured, (simulated + measured) * node_steps, seconds, memory)


def evaluator_of(resolved: Resolved, parametrization: Parametrization) -> str:
    """Return the evaluator that was asked for; by default "response" for a robust search that can, and "direct"."""
    robust = parametrization.scene.search.robust is not None and parametrization.quadratic
    return resolved.evaluator or ("response" if robust else "direct")


def node_steps_of(resolved: Resolved) -> float:
    """Return the node-steps of a plate."""
    return float(math.prod(side - 2 for side in resolved.scene.grid.nodes) * resolved.grid.steps)


def search_memory(parametrization: Parametrization, resolved: Resolved, objectives: Objectives) -> dict[str, float]:
    """Return the largest memory of a search [bytes] besides PROGRAM, by the key that determines it."""
    scene, search = parametrization.scene, parametrization.scene.search
    evaluator, actuators = evaluator_of(resolved, parametrization), len(scene.actuators)
    particles, regions = search.particles, len(REGIONS) + len(objectives.regions)
    matrices, highest = regions * (2.0 * actuators) ** 2, _highest(scene)
    memory = _plate_memory(resolved, highest)
    memory["search.particles"] = optimizer_bytes(search, len(parametrization.variables))
    memory["search.iterations"] = history_bytes(search)
    memory["actuators"] = MATRIX_BYTES * matrices
    if not resolved.by_modes and parametrization.quadratic:
        units = response.count_unit_drives(actuators)
        drives = PAIR_BYTES * units + UNIT_BYTES * min(units * actuators, response.PHASORS_AT_ONCE)
        drives += _plates_bytes(units, resolved, 8)
        memory["actuators"] += drives
        memory["plate.size"] -= min(memory["plate.size"], drives)  # the error is estimated when they are freed
    if evaluator == "direct":
        number_bytes = 4 if scene.grid.precision == "float32" else 8
        memory["search.particles"] += _plates_bytes(particles, resolved, number_bytes)
    if resolved.by_modes and not parametrization.only_drives:
        expected = expected_modes(scene, highest)
        numbers = particles * design_numbers(actuators, expected.functions, expected.modes)
        motion = MOTION_BYTES * min(AMPLITUDES_AT_ONCE, particles * actuators * expected.modes)
        memory["search.particles"] += DESIGN_BYTES * min(DESIGN_NUMBERS, numbers) + motion
        memory["plate.size"] += FORM_BYTES * regions * (2 * expected.modes) ** 2
    if search.robust is not None:
        scenario = scenario_bytes(actuators) + 8 * matrices * (evaluator != "direct") + 24.0 * particles
        memory["search.robust.scenarios"] = search.robust.scenarios * scenario
    return memory


def refuse_search_beyond_memory(memory: Mapping[str, float], resolved: Resolved) -> None:
    """Raise a SceneError that names the key of the largest part if a search takes more memory than there is."""
    key = max(memory, key=lambda name: memory[name])
    table: Any = resolved.scene
    for name in key.split("."):
        table = getattr(table, name)
    value = len(table) if key == "actuators" else list(table) if isinstance(table, tuple) else table
    refuse_beyond_memory(sum(memory.values()), f"{key} = {value} in this search")


def design_numbers(actuators: int, functions: float, modes: float) -> int:
    """Return the numbers that the forces and the Gram matrices of a design take."""
    return math.ceil(actuators * (functions + modes) + 40 * actuators**2)


def _plate_memory(resolved: Resolved, highest: float) -> dict[str, float]:
    """Return the memory of a run with responses up to a frequency [Hz], by keys."""
    scene, grid, memory = resolved.scene, resolved.grid, {}
    memory["grid.nodes"] = grid_bytes(scene, _moment_form(resolved))
    memory["window.end"] = steps_bytes(scene, grid.steps) if isinstance(grid, Discretization) else 0.0
    if scene.linear:
        expected = expected_modes(scene, highest, REFERENCE_DENSITY)
        if expected.functions > MOST_REFERENCE:  # more would take too long
            expected = expected_modes(scene, highest)
        products = PRODUCT_BYTES * min(ROWS, 2 * expected.modes) * 2 * expected.modes
        memory["plate.size"] = VECTOR_BYTES * expected.functions * expected.modes + products
    return memory


def _highest(scene: Scene) -> float:
    """Return the highest frequency [Hz] of a scene's drives and of a search."""
    searched = scene.search.frequency
    return max(highest_frequency(scene), 0.0 if searched is None else searched.range[1])


def _moment_form(resolved: Resolved) -> bool:
    return isinstance(resolved.grid, Discretization) and resolved.grid.scheme.bending is not None


def _plates_bytes(plates: int, resolved: Resolved, number_bytes: int) -> float:
    """Return the bytes of the plates that run at once on CPU."""
    numbers = MOMENT_NUMBERS if _moment_form(resolved) else PLAIN_NUMBERS
    a_plate = numbers * number_bytes * math.prod(resolved.scene.grid.nodes)
    return max(a_plate, min(CPU_BYTES, a_plate * min(plates, plates_a_launch(node_steps_of(resolved)))))
