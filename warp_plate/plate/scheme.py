"""The discretized scene: its difference scheme (steps, coefficients, stability limit), loads and regions.

    ρH ü + c u̇ + D∇⁴u = f,   D = EH³ / 12(1 − ν²),   κ = √(D/ρH)

in velocity form, with v at the half-steps and u at t_n = nΔt:

    v⁺ = decay·v − gain·Δt·(D∇⁴u − f)/ρH,   u⁺ = u + Δt v⁺

Centred damping: decay = (1 − a/2)/(1 + a/2), gain = 1/(1 + a/2), a = cΔt/ρH. Backward damping, equation (6) of the
source paper with its signs corrected: decay = 1 − a, gain = 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_plate.effects.effect import attachments
from warp_plate.plate.bending import Bending
from warp_plate.plate.coils import check_apart
from warp_plate.plate.designs import NO_PER_PLATE, PerPlate, carriers_of
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.operator import DIVISOR, Taps, plain_taps
from warp_plate.plate.section import make_section
from warp_plate.plate.signals import Signals, check_rate, highest_frequency, make_signals
from warp_plate.plate.stability_limit import StabilityLimit, find_limit, needs_moment_form, viscous_damping
from warp_plate.plate.supports import support_points
from warp_plate.plate.travelling import MovingWeights, moving_weights
from warp_plate.plate.weights import patches, region_weights
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Window
from warp_plate.scene.model import Scene

# A time step that the scene leaves out is this part of the stability limit, or this part of the drive's period.
SAFETY = 0.9
STEPS_A_PERIOD = 20
# Longer runs are mistakes in a unit: this is hours on any device.
MOST_STEPS = 10**8
# Bytes per node: of regions, fields and copies; more in moment form; of sparse matrices for the limit of inhomogeneous
# plates; and of the factorised one for compression. Measured in all, with three actuators: 110, 590, 840 and 5400.
PLAIN, MOMENT_FORM, MATRICES, FACTORISED = 160, 450, 400, 5500
# Bytes per step: of a term of the drive's wave, and of a recorded point.
TERM, POINT = 64, 96
# Cases of a search with records, and bytes of a number of a record of each further target, in memory and when written.
CASES, KEPT = 3, 12.0
# Largest cΔt/ρH. Above it float32 loses the square of the remaining motion of a step.
MOST_LOSS = 1e9


@dataclass(frozen=True)
class Scheme:
    """The discretized plate."""

    nodes: tuple[int, int]  # (nx, ny), edges included
    spacing: tuple[float, float]  # (hx, hy) [m]
    rigidity: float  # D [N·m]
    surface_density: float  # ρH [kg/m²]
    kappa: float  # κ [m²/s]
    time_step: float  # Δt [s]
    stability: StabilityLimit  # Its limit, and the cause of the limit
    steps: int  # Number of steps of the whole run
    window: tuple[int, int]  # First and last + 1 of the steps whose half-step lies inside the scene's window
    decay: float  # Factor of the velocity in a step
    gain: float  # Factor of the force in a step
    angular_frequency: float  # ω of the drive [rad/s]
    order: int  # Order of the differences in space
    taps_x: Taps  # Differences along x with their edges, see ``operator``
    taps_y: Taps  # Differences along y
    bending: Bending | None  # Fields of the plate in moment form; None for a plain plate
    viscous: float  # All viscous damping [N·s/m³]
    backward: bool  # True if it is taken backward in time

    @property
    def limit(self) -> float:
        """Largest stable time step [s]."""
        return self.stability.time_step

    @property
    def stable(self) -> bool:
        """True if the time step is at most the limit, up to rounding."""
        return self.time_step <= self.limit * (1 + 1e-12)

    @property
    def stiffness(self) -> float:
        """gain·(κΔt/hx²)², the kernels' dimensionless coefficient of ∇⁴ as the taps give it."""
        return self.gain * (self.kappa * self.time_step / self.spacing[0] ** 2 / DIVISOR[self.order]) ** 2

    @property
    def aspect(self) -> float:
        """(hx/hy)²."""
        return (self.spacing[0] / self.spacing[1]) ** 2

    @property
    def square_cells(self) -> bool:
        """True if hx = hy up to rounding."""
        return math.isclose(self.spacing[0], self.spacing[1], rel_tol=1e-12)

    @property
    def load_scale(self) -> float:
        """Displacement gained in a step under a pressure of one [m per N/m²]."""
        return self.gain * self.time_step**2 / self.surface_density

    def step_of(self, time: float) -> int:
        """Return the step n of the run whose t_n = nΔt lies nearest to ``time`` [s]."""
        return min(max(round(time / self.time_step), 0), self.steps)


def make_scheme(scene: Scene, allow_unstable: bool = False, moment_form: bool = False, stepped: bool = True) -> Scheme:
    """Return the scheme of a scene with a grid.

    Args:
        allow_unstable: Accept a time step above the stability limit.
        moment_form: Use the moment form also where a plain plate would do.
        stepped: False for a plate by modes, whose time step only serves its traces and need not be stable.

    Raises:
        SceneError: No grid is chosen yet; the time step is unstable or too long for the drive; the window holds no
            half-step; or the run is longer than MOST_STEPS, or takes more memory than there is.
    """
    plate, grid = scene.plate, scene.grid
    check_grid(scene, moment_form)
    if stepped:
        scene.check_stepped()
    surface_density = plate.density * plate.thickness
    stability, bending = find_limit(scene, moment_form)
    if stepped and bending is not None:
        check_apart(scene, bending.coils)
    time_step = _time_step(scene, stability.time_step, allow_unstable, stepped)
    viscous, backward = viscous_damping(scene)
    loss = viscous / surface_density * time_step
    if stepped and loss > MOST_LOSS:
        raise SceneError(
            f"effects: {viscous:g} N·s/m³ of viscous damping is more than {MOST_LOSS:g} times what stops the plate "
            f"within a step; at most {MOST_LOSS * surface_density / time_step:.3g} are possible"
        )
    first, last = _window(scene.window, time_step, stepped)
    taps_x, taps_y = plain_taps(scene.edges, grid.nodes, grid.order)
    return Scheme(
        nodes=grid.nodes,
        spacing=scene.spacing,
        rigidity=plate.rigidity,
        surface_density=surface_density,
        kappa=plate.kappa,
        time_step=time_step,
        stability=stability,
        steps=last,
        window=(first, last),
        decay=1 - loss if backward else (1 - loss / 2) / (1 + loss / 2),
        gain=1.0 if backward or bending else 1 / (1 + loss / 2),
        angular_frequency=scene.drive.angular_frequency,
        order=grid.order,
        taps_x=taps_x,
        taps_y=taps_y,
        bending=bending,
        viscous=viscous,
        backward=backward,
    )


def check_grid(scene: Scene, moment_form: bool = False) -> None:
    """Raise a SceneError if no grid is chosen yet, or if it takes more memory than there is."""
    if (accuracy := scene.grid.accuracy) is not None:
        raise SceneError(
            f"grid.accuracy = {accuracy:g}: no grid is chosen yet; write grid.nodes, or take "
            f"warp_plate.accuracy.choose.choose(scene, {accuracy:g}).scene"
        )
    times = f" and {len(scene.record.times)} record.times" if scene.record.times else ""
    what = f"grid.nodes = {list(scene.grid.nodes)} with {len(scene.actuators)} actuators{times}"
    refuse_beyond_memory(grid_bytes(scene, moment_form or needs_moment_form(scene)), what)


def grid_bytes(scene: Scene, moment_form: bool) -> float:
    """Return the bytes of a scene's fields."""
    terms, nodes = scene.terms, math.prod(scene.grid.nodes)
    bytes_a_node = PLAIN + 16.0 * len(scene.actuators) + _record_bytes(scene, 16.0) * len(scene.record.times)
    if moment_form:
        springs = (len(support_points(support, scene.spacing)[0]) for support in scene.supports)
        attached = len(attachments(terms)) + len(scene.coil_indices) + sum(springs)
        bytes_a_node += MOMENT_FORM + 32 * attached
        bytes_a_node += MATRICES * bool(scene.layers or attached)
        bytes_a_node += FACTORISED * any(term.role == "stiffness" and term.coefficient < 0 for term in terms)
    return nodes * bytes_a_node


def steps_bytes(scene: Scene, steps: int) -> float:
    """Return the bytes of a run's drives and traces."""
    frequencies = len({actuator.frequency for actuator in scene.actuators})
    terms = 2 * frequencies if scene.drive.electrostatic is None else 4 * frequencies + 2
    bytes_a_step = TERM * terms + _record_bytes(scene, POINT) * len(scene.record.points)
    if scene.effects.travelling is not None:
        bytes_a_step += 24 * sum(scene.grid.nodes)
    return float(steps) * bytes_a_step


def _record_bytes(scene: Scene, of_case: float) -> float:
    """Return the bytes of a number of a record: of the cases of the first target, which are kept, and of another's."""
    others = max(0, len(scene.targets) - 1)
    return CASES * of_case * (1 + (others > 0)) + KEPT * others


def sampling_step(scene: Scene, limit: float) -> float:
    """Return the time step [s] at which a run that takes no time steps is sampled; see :func:`_time_step`."""
    return _time_step(scene, limit, allow_unstable=True, stepped=False)


def _time_step(scene: Scene, limit: float, allow_unstable: bool, stepped: bool) -> float:
    """Return the scene's time step [s], or the longest that suits limit, drive and window; see ``make_scheme``.

    Where the plate is not stepped, a limit that takes more than MOST_STEPS does not count.
    """
    end, nodes = scene.window.end, scene.grid.nodes
    longest = 1 / (STEPS_A_PERIOD * highest_frequency(scene))
    if stepped or end <= MOST_STEPS * SAFETY * limit:
        longest = min(longest, SAFETY * limit)
    time_step = scene.grid.time_step or end / math.ceil(end / longest)
    if stepped and time_step > limit * (1 + 1e-12) and not allow_unstable:
        raise SceneError(
            f"grid.time_step = {time_step:g}: above the stability limit of {limit:.6g} s for {nodes[0]} x {nodes[1]} "
            f"nodes; write a smaller one, or leave it out for {SAFETY:g} of the limit"
        )
    check_rate(scene, time_step)
    if end / time_step > MOST_STEPS:
        raise SceneError(
            f"window.end = {end:g}: takes {end / time_step:.3g} steps of {time_step:g} s; "
            f"at most {MOST_STEPS:.3g} are possible: end earlier or use fewer nodes"
        )
    if stepped or scene.record.points:
        steps, points = round(end / time_step), len(scene.record.points)
        beside = f", {points} record.points" if points else ""
        if scene.effects.travelling is not None:
            beside += f", a moving load on {list(nodes)} nodes"
        refuse_beyond_memory(steps_bytes(scene, steps), f"window.end = {end:g}: {steps} steps{beside}")
    return time_step


def _window(window: Window, time_step: float, stepped: bool) -> tuple[int, int]:
    """Return first and last + 1 of the steps n with start < (n + ½)Δt < end."""
    slack = 1e-9  # steps: a half-step on an end of the window up to rounding is outside
    first = math.floor(window.start / time_step - 0.5 + slack) + 1
    last = math.ceil(window.end / time_step - 0.5 - slack)
    if stepped and last <= first:
        raise SceneError(
            f"window.end = {window.end:g}: no half-step of {time_step:g} s lies between it and "
            f"window.start = {window.start:g}; widen the window or shorten grid.time_step"
        )
    return first, last


@dataclass(frozen=True)
class Discretization:
    """A scene on its grid, in host memory and double precision; no device is involved."""

    scene: Scene  # The scene, which has a grid
    per_plate: PerPlate  # Quantities that may differ between the plates of a batch
    carriers: int  # Number of separate carriers of each plate; 0 if all plates share the scene's
    scheme: Scheme  # Steps, coefficients, stability limit and, in moment form, the fields of the plate
    region_weights: np.ndarray  # (2, ny, nx) weights of the plate and of the target, in cells

    @cached_property
    def signals(self) -> Signals:
        """Waves of the drive and their coefficients, only for time steps; see ``make_signals``."""
        scene, scheme = self.scene, self.scheme
        return make_signals(scene, scheme.time_step, scheme.steps, scene.folder, per_actuator=self.carriers > 1)

    @cached_property
    def moving(self) -> MovingWeights | None:
        """Factors of the moving load, only for time steps; None without one."""
        if self.scene.effects.travelling is None:
            return None
        return moving_weights(self.scene, self.scheme.time_step, self.scheme.steps)

    @cached_property
    def patches(self) -> np.ndarray:
        """(actuators, ny, nx) fraction of each node's cell that each actuator loads, only for time steps."""
        return patches(self.scene)

    @cached_property
    def surface_density(self) -> np.ndarray:
        """(ny, nx) mass per area [kg/m²], with layers and maps of factors."""
        bending = self.scheme.bending
        return make_section(self.scene).mass if bending is None else bending.mass

    @property
    def time_step(self) -> float:
        """Time step [s]."""
        return self.scheme.time_step

    @property
    def steps(self) -> int:
        """Number of steps of the whole run."""
        return self.scheme.steps

    @property
    def cell(self) -> float:
        """Area of a cell of the grid [m²]."""
        return self.scheme.spacing[0] * self.scheme.spacing[1]


def discretize(
    scene: Scene, per_plate: PerPlate = NO_PER_PLATE, allow_unstable: bool = False, stepped: bool = True
) -> Discretization:
    """Discretize a scene for plates that differ in ``per_plate``; for all else see ``make_scheme``.

    Raises:
        SceneError: ``make_scheme`` or ``region_weights`` refuse the scene, or it does not support ``per_plate``.
    """
    carriers = 0 if per_plate == NO_PER_PLATE else carriers_of(scene, per_plate, by_modes=False)
    return Discretization(
        scene=scene,
        per_plate=per_plate,
        carriers=carriers,
        scheme=make_scheme(scene, allow_unstable, carriers > 1, stepped),
        region_weights=region_weights(scene),
    )
