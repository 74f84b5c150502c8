"""From a scene to the numbers of the difference scheme: rigidity, steps, coefficients and the stability limit.

    ρH ü + c u̇ + D∇⁴u = f,   D = EH³ / 12(1 − ν²),   κ = √(D/ρH)

in velocity form, with v at the half-steps and u at t_n = nΔt:

    v⁺ = decay·v − gain·Δt·(D∇⁴u − f)/ρH,   u⁺ = u + Δt v⁺

Centred damping: decay = (1 − a/2)/(1 + a/2), gain = 1/(1 + a/2), a = cΔt/ρH. Backward damping, equation (6) of the
source paper with its signs mended: decay = 1 − a, gain = 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from warp_plate.plate.bending import Bending, buckling_factor, largest_eigenvalue, make_bending, oscillator_shares
from warp_plate.plate.memory import check_grid_memory, check_steps_memory
from warp_plate.plate.operator import DIVISOR, LARGEST, Taps, make_taps
from warp_plate.plate.signals import check_rate, highest_frequency, own_frequencies
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# A time step that the scene leaves out is this part of the stability limit, and carries the drive with so many steps.
SAFETY = 0.9
STEPS_A_PERIOD = 20
# Longer runs are mistakes in a unit: this is hours on any device.
MOST_STEPS = 10**8
# Of a step: cΔt/ρH. Motion is then so small a part of what the load would do in a step that float32 loses its square.
MOST_LOSS = 1e9


@dataclass(frozen=True)
class Scheme:
    """The discretised plate, in SI units where not said otherwise.

    nodes: (nx, ny); spacing: (hx, hy) [m]; rigidity D [N·m]; surface_density ρH [kg/m²]; kappa [m²/s];
    time_step [s]; limit: largest stable time step [s]; steps: of the whole run;
    window: first and last + 1 of the steps whose half-step lies inside the scene's window;
    decay, gain: of the velocity form above (dimensionless); angular_frequency: of the drive [rad/s];
    order: of the differences in space; taps_x, taps_y: these differences, the edges in them (see ``operator``).
    """

    nodes: tuple[int, int]
    spacing: tuple[float, float]
    rigidity: float
    surface_density: float
    kappa: float
    time_step: float
    limit: float
    steps: int
    window: tuple[int, int]
    decay: float
    gain: float
    angular_frequency: float
    order: int
    taps_x: Taps
    taps_y: Taps
    bending: Bending | None
    viscous: float
    backward: bool

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
        """Whether hx = hy up to rounding."""
        return math.isclose(self.spacing[0], self.spacing[1], rel_tol=1e-12)

    @property
    def load_scale(self) -> float:
        """Displacement gained in a step under a pressure of one [m per N/m²]."""
        return self.gain * self.time_step**2 / self.surface_density

    def step_of(self, time: float) -> int:
        """The step n whose t_n = nΔt lies nearest to ``time`` [s], within the run."""
        return min(max(round(time / self.time_step), 0), self.steps)


def make_scheme(scene: Scene) -> Scheme:
    """The scheme of a scene.

    Raises:
        SceneError: the scene asks for an accuracy instead of a grid; its time step is above the stability limit or too
            long for the drive's frequency, its window holds no half-step, its run is longer than MOST_STEPS, or grid or
            run take more memory than there is.
    """
    plate, grid = scene.plate, scene.grid
    if grid.accuracy is not None:
        raise SceneError(
            f"grid.accuracy = {grid.accuracy:g}: no grid is chosen yet; warp_plate.accuracy.choose(scene, "
            f"{grid.accuracy:g}).scene has one"
        )
    check_grid_memory(scene, needs_moments(scene))
    spacing = (plate.size[0] / (grid.nodes[0] - 1), plate.size[1] / (grid.nodes[1] - 1))
    rigidity = plate.young_modulus * plate.thickness**3 / (12 * (1 - plate.poisson_ratio**2))
    surface_density = plate.density * plate.thickness
    kappa = math.sqrt(rigidity / surface_density)
    viscous, backward = _viscous(scene)
    rate_of_loss = viscous / surface_density
    limit, bending = stability(scene)
    longest = min(SAFETY * limit, 1 / (STEPS_A_PERIOD * highest_frequency(scene)))
    time_step = grid.time_step or scene.window.end / math.ceil(scene.window.end / longest)
    if time_step > limit * (1 + 1e-12):
        raise SceneError(
            f"grid.time_step = {time_step:g}: above the stability limit of {limit:.6g} s for {grid.nodes[0]} x "
            f"{grid.nodes[1]} nodes; write a smaller one, or leave it out for {SAFETY:g} of the limit"
        )
    check_rate(scene, time_step)
    if scene.window.end / time_step > MOST_STEPS:
        raise SceneError(
            f"window.end = {scene.window.end:g}: takes {scene.window.end / time_step:.3g} steps of {time_step:g} s; "
            f"at most {MOST_STEPS:.3g} are possible: end earlier or use fewer nodes"
        )
    check_steps_memory(scene, round(scene.window.end / time_step))
    loss = rate_of_loss * time_step
    if loss > MOST_LOSS:
        raise SceneError(
            f"effects: {viscous:g} N·s/m³ of viscous damping is more than {MOST_LOSS:g} times what stops the plate "
            f"within a step; at most {MOST_LOSS * surface_density / time_step:.3g} are possible"
        )
    first, last = _window(scene, time_step)
    return Scheme(
        nodes=grid.nodes,
        spacing=spacing,
        rigidity=rigidity,
        surface_density=surface_density,
        kappa=kappa,
        time_step=time_step,
        limit=limit,
        steps=last,
        window=(first, last),
        decay=1 - loss if backward else (1 - loss / 2) / (1 + loss / 2),
        gain=1.0 if backward or bending else 1 / (1 + loss / 2),
        angular_frequency=scene.drive_angular_frequency,
        order=grid.order,
        taps_x=make_taps(grid.nodes[0], _plain(scene.edges.left), _plain(scene.edges.right), grid.order),
        taps_y=make_taps(grid.nodes[1], _plain(scene.edges.bottom), _plain(scene.edges.top), grid.order),
        bending=bending,
        viscous=viscous,
        backward=backward,
    )


def stability(scene: Scene) -> tuple[float, Bending | None]:
    """Largest stable time step [s] of a scene's grid and effects; the plate as moments, where it goes that way.

    Raises:
        SceneError: the plate buckles, or fourth order is asked of one that does not know it.
    """
    plate, grid, effects = scene.plate, scene.grid, scene.effects
    spacing = (plate.size[0] / (grid.nodes[0] - 1), plate.size[1] / (grid.nodes[1] - 1))
    surface_density = plate.density * plate.thickness
    viscous, backward = _viscous(scene)
    if not needs_moments(scene):
        late = viscous / surface_density if backward else 0.0
        rigidity = plate.young_modulus * plate.thickness**3 / (12 * (1 - plate.poisson_ratio**2))
        return time_step_limit(math.sqrt(rigidity / surface_density), spacing, late, grid.order), None
    if grid.order == 4:
        raise SceneError(
            "grid.order = 4: knows an isotropic plate, the same everywhere, with clamped and supported edges, viscous "
            "damping and actuators of one frequency; write 2 for other edges, effects and drives"
        )
    bending = make_bending(scene)
    _refuse_buckling(scene, bending)
    largest = largest_eigenvalue(scene, bending)
    late = viscous / float(bending.mass.min()) if backward else 0.0
    if effects.material_damping is not None:
        late += effects.material_damping.time * largest
    cell_mass = bending.mass.min() * spacing[0] * spacing[1]
    for one, share in zip(effects.oscillators, oscillator_shares(scene), strict=True):
        late += one.damping * ((share**2 / bending.weight).sum() / cell_mass + (1 / one.mass if one.mass else 0.0))
    return _limit(largest, late), bending


def _viscous(scene: Scene) -> tuple[float, bool]:
    """All viscous damping [N·s/m³], and whether it is taken backward in time."""
    damping, bed = scene.effects.damping, scene.effects.foundation
    viscous = (damping.viscous if damping else 0.0) + (bed.damping if bed else 0.0)
    return viscous, damping is not None and damping.scheme == "backward"


def time_step_limit(
    kappa: float, spacing: tuple[float, float], backward_loss: float = 0.0, order: int = 2
) -> float:
    """Largest stable time step [s]; κ [m²/s], spacing [m], c/ρH [1/s] where damping is taken backward.

    The largest eigenvalue of the discrete κ²∇⁴ is at most Λ = κ²(s/hx² + s/hy²)², s = 4 for second order and 16/3 for
    fourth: there the spectrum of a periodic plate ends, and edges only lower it (of second order they are even and odd
    mirror images; of fourth see tests/test_operator.py). Undamped or with centred damping the scheme is stable for
    Λ Δt² ≤ 4 (κΔt/h² ≤ 1/4 or 3/16 on square cells); with backward damping for Λ Δt² ≤ 4 − 2cΔt/ρH.
    """
    largest = kappa**2 * (LARGEST[order] / spacing[0] ** 2 + LARGEST[order] / spacing[1] ** 2) ** 2
    return _limit(largest, backward_loss)


def _limit(largest: float, late_loss: float) -> float:
    """The positive root of Λ Δt² + 2 b Δt − 4 = 0, written so that it does not cancel for large b."""
    return 4 / (late_loss + math.sqrt(late_loss**2 + 4 * largest))


def _refuse_buckling(scene: Scene, bending: Bending) -> None:
    if min(bending.tension) >= 0:
        return
    factor = buckling_factor(scene, bending)
    if factor <= 1:
        x, y = (factor * pull for pull in bending.tension)
        raise SceneError(
            f"effects.tension = {{x = {bending.tension[0]:g}, y = {bending.tension[1]:g}}}: the plate buckles; the "
            f"critical load is x = {x:.4g}, y = {y:.4g} N/m, {factor:.3g} of this one"
        )


def needs_moments(scene: Scene) -> bool:
    """Whether a scene is more than a plain plate with viscous damping under one carrier, and goes the general way."""
    effects = scene.effects
    rest = (
        effects.material_damping, effects.tension, effects.foundation, effects.stretching, effects.moving_load,
        scene.drive.electrostatic,
    )  # fmt: skip
    named = any(table is not None for table in rest) or bool(effects.oscillators)
    return not scene.uniform or named or len(own_frequencies(scene)) > 1


def _plain(edge: object) -> str:
    """An edge as the plain plate has it; where it has not, its taps are not used."""
    return "clamped" if edge == "clamped" else "supported"


def _window(scene: Scene, time_step: float) -> tuple[int, int]:
    """First and last + 1 of the steps n with start < (n + ½)Δt < end."""
    window = scene.window
    slack = 1e-9  # steps: a half-step that falls on an end of the window up to rounding is outside
    first = math.floor(window.start / time_step - 0.5 + slack) + 1
    last = math.ceil(window.end / time_step - 0.5 - slack)
    if last <= first:
        raise SceneError(
            f"window.end = {window.end:g}: no half-step of {time_step:g} s lies between it and "
            f"window.start = {window.start:g}; widen the window or shorten grid.time_step"
        )
    return first, last
