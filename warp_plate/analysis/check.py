"""Numerical properties of a scene, determined before it runs."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.accuracy.configurations import seconds_text
from warp_plate.analysis.warnings import Finding, find_warnings, slowest_frequency, wavelengths
from warp_plate.modal.solver import MODAL
from warp_plate.plate.memory import memory_room
from warp_plate.plate.scheme import Scheme, discretize
from warp_plate.plate.signals import carrier_frequencies, highest_frequency
from warp_plate.plate.stability_limit import StabilityLimit
from warp_plate.plate.weights import cell_shares
from warp_plate.problem.methods import resolve_search, with_method_of_engine
from warp_plate.problem.search_cost import PROGRAM, Cost, cost_of_run, cost_of_search
from warp_plate.resolve import Resolved
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.solve.compiled_scene import choose_path, describe_plan
from warp_plate.solve.devices import find_device
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import bytes_per_plate

# Most frequencies of a drive that are listed one by one.
MOST_NAMED = 4


@dataclass(frozen=True)
class Check:
    """Properties of a scene, most of them numerical."""

    plate: str  # sides, thickness, mass and edges
    mass: float  # mass of the plate and its layers [kg]
    drive: str  # frequencies and number of actuators
    nodes: tuple[int, int]  # nodes (nx, ny)
    order: int  # spatial order
    precision: str  # precision of the time steps
    time_step: float  # time step [s]
    steps: int  # number of steps of the run
    limit: StabilityLimit  # stability limit
    stable: bool  # True if the time step is below the limit
    growth_a_step: float  # factor by which the fastest motion grows in a step; 1 if stable
    drive_frequency: float  # highest frequency of the drive [Hz]
    steps_a_period: float  # time steps in a period of this frequency
    points_a_wavelength: float  # grid spacings in a bending wave of this frequency
    slowest_frequency: float  # lowest natural frequency above zero [Hz]; 0 if there is none
    fastest_frequency: float  # highest natural frequency of the grid [Hz]
    condition: float  # condition number: largest over smallest eigenvalue
    # Order of magnitude of the relative error by rounding: one unit in the last place for each radian of the fastest
    # motion in a radian of the slowest (measured in docs/hard-cases.md)
    rounding: float
    # Amplitude of the lowest bending shape, in thicknesses, at which stretching lowers the limit to the time step
    stretching_amplitude: float | None
    bytes_a_plate: int  # device memory of a plate
    device: str  # Warp's name of the device
    path: str  # path of the solver
    plan: str  # distribution of plates over the device
    findings: tuple[Finding, ...]  # see ``find_warnings``

    def __repr__(self) -> str:
        return f"<Check {'stable' if self.stable else 'unstable'}, {len(self.warnings)} warnings>"

    @property
    def summary(self) -> dict[str, str]:
        """Plate, first mode, drive and engine as texts by name."""
        nx, ny = self.nodes
        engine = f"time steps on {self.device}, {nx} × {ny} nodes of order {self.order}, {self.precision}"
        if self.path == MODAL:
            engine = f"modes, without time steps or grid; pictures have {nx} × {ny} points"
        first = f"{self.slowest_frequency:.4g} Hz" if self.slowest_frequency else "none above zero"
        return {"plate": self.plate, "first natural frequency": first, "drive": self.drive, "engine": engine}

    @property
    def numerics(self) -> dict[str, str]:
        """Time step, its limit, and memory as texts by name; empty for a run by modes."""
        if self.path == MODAL:
            return {}
        limit = self.limit
        shares = sorted(limit.shares.items(), key=lambda share: -share[1])
        causes = ", ".join(f"{name} {100 * share:.3g} %" for name, share in shares if share >= 0.005)
        origin = "shortest wave on the grid, by formula"
        if limit.place is not None:
            x, y = limit.place
            origin = f"fastest motion of this scene's matrices, largest at x = {x:.3g} m, y = {y:.3g} m"
        grows = f"; too long, the fastest motion grows {self.growth_a_step:.3g} times in every step"
        texts = {
            "time step": f"{self.time_step:.6g} s, {self.time_step / limit.time_step:.3g} of the limit of "
            f"{limit.time_step:.6g} s; {self.steps} steps, {self.steps_a_period:.4g} a period"
            + grows
            * (not self.stable),
            "set by": f"{origin}: {causes}",
            "rounding": f"errors up to {self.rounding:.0e} of the motion; natural frequencies up to "
            f"{self.fastest_frequency:.0f} Hz, condition number {self.condition:.2g}",
            "memory": f"{bytes_text(self.bytes_a_plate)} a plate",
            "path": f"{self.path}: {self.plan}",
        }
        if (amplitude := self.stretching_amplitude) is not None:
            texts["stretching"] = (
                f"not in the limit: this time step is too long from an amplitude of about {amplitude:.3g} thicknesses "
                "on (of the lowest bending shape)"
            )
        return texts

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        return tuple(finding.sentence for finding in self.findings if finding.exceeded)

    def as_json(self) -> Mapping[str, object]:
        """Return the properties as numbers and texts."""
        limit, place = self.limit, self.limit.place
        return {
            **{key: value for key, value in vars(self).items() if key not in ("limit", "findings")},
            "nodes": list(self.nodes),
            "limit": limit.time_step,
            "limit_shares": dict(limit.shares),
            "limit_by_formula": limit.formula,
            "limit_place": None if place is None else list(place),
            "numbers": [vars(finding) for finding in self.findings],
            "sentences": [f"{name}: {text}" for name, text in {**self.summary, **self.numerics}.items()],
            "warnings": list(self.warnings),
        }


def check(scene: SceneSource, device: str = "auto", allow_unstable: bool = False, by_modes: bool = False) -> Check:
    """Check a scene with a grid without running it; with ``by_modes``, for a run by modes.

    Raises:
        SceneError: see ``discretize``, or there is no such device.
    """
    scene = Scene.load(scene)
    steps = not by_modes and scene.modal_only_key is None
    discretization = discretize(scene, allow_unstable=allow_unstable, stepped=steps)
    scheme = discretization.scheme
    specialized = Specialized(discretization, find_device(device))
    limit, frequency, slowest = scheme.stability, highest_frequency(scene), slowest_frequency(scene)
    bending, plate = scheme.bending, scene.plate
    mass = plate.area * plate.thickness * plate.density
    if bending is not None:
        # Nodes off an outline have a weight of 1, and masses beside its held pieces and at supports are raised.
        shape, grid = bending.mass.shape, bending.grid
        weight = cell_shares(shape) if grid is None else grid.count(np.ones(shape))
        mass = plate.area * float(np.average(bending.mass, weights=weight))
    return Check(
        plate=_plate_text(scene, mass),
        mass=mass,
        drive=_drive_text(scene),
        nodes=scheme.nodes,
        order=scheme.order,
        precision=scene.grid.precision,
        time_step=scheme.time_step,
        steps=scheme.steps,
        limit=limit,
        stable=scheme.stable,
        growth_a_step=1.0 if scheme.stable else math.exp(2 * math.acosh(scheme.time_step / limit.time_step)),
        drive_frequency=frequency,
        steps_a_period=1 / (frequency * scheme.time_step),
        points_a_wavelength=min(np.divide(wavelengths(scene), scheme.spacing).tolist()),
        slowest_frequency=slowest,
        fastest_frequency=limit.frequency,
        condition=(limit.frequency / slowest) ** 2 if slowest else math.inf,
        rounding=float(np.finfo(scene.grid.precision).eps) * limit.frequency / slowest if slowest else math.inf,
        stretching_amplitude=_critical_amplitude(scene, scheme),
        bytes_a_plate=bytes_per_plate(specialized, 4 * len(scene.record.points)),
        device=specialized.device.alias,
        path=choose_path(specialized) if steps else MODAL,
        plan=describe_plan(specialized) if steps else "without time steps",
        findings=tuple(find_warnings(scene, None, steps)),
    )


def _plate_text(scene: Scene, mass: float) -> str:
    width, height = scene.plate.size
    edges = {side: edge if isinstance(edge, str) else "on springs" for side, edge in scene.edge_conditions}
    around = ", ".join(f"{side} {edge}" for side, edge in edges.items())
    if len(set(edges.values())) == 1:
        around = f"all edges {next(iter(edges.values()))}"
    size = f"{1e3 * width:g} × {1e3 * height:g} × {1e3 * scene.plate.thickness:g} mm"
    if scene.plate.outline is not None:
        size += f", {scene.plate.outline.description}{', with holes' * bool(scene.plate.holes)}"
    weight = f"{mass:.4g} kg" if mass >= 1 else f"{1e3 * mass:.4g} g"
    kinds = Counter(next(kind for kind in ("point", "line", "ring") if getattr(row, kind)) for row in scene.supports)
    supports = ", ".join(f"{count} {kind}{'s'[: count > 1]}" for kind, count in kinds.items())
    held = f"; held at {supports}" if supports else ""
    return f"{size}, {weight}{' with layers' * bool(scene.layers)}; {around}{held}"


def _drive_text(scene: Scene) -> str:
    frequencies, count = sorted(carrier_frequencies(scene)), len(scene.actuators)
    named = ", ".join(f"{frequency:g}" for frequency in frequencies[:MOST_NAMED])
    if len(frequencies) > MOST_NAMED:
        named = f"{len(frequencies)} frequencies from {frequencies[0]:g} to {frequencies[-1]:g}"
    waveform = f" ({scene.drive.waveform_key})" if scene.drive.waveform_key else ""
    return f"{named} Hz{waveform}, {count} actuator{'s'[: count > 1]}"


def _critical_amplitude(scene: Scene, scheme: Scheme) -> float | None:
    """Return the amplitude, in thicknesses, at which stretching lowers the limit to the time step; None without it.

    A membrane force N, κN along y, adds N(4/hx² + 4κ/hy²)/ρH to the largest eigenvalue 4/limit². Berger's is
    proportional to ∫ u_x² + κu_y² dA, which is a²π²/4 · area · (1/width² + κ/height²) for the shape a sin sin.
    """
    bending = scheme.bending
    if bending is None or not scene.effects.stretches:
        return None
    (hx, hy), (width, height), ratio = scheme.spacing, scene.plate.size, bending.stretch_ratio
    spare = 4 / scheme.time_step**2 - 4 / scheme.stability.time_step**2
    force = max(spare, 0.0) * float(bending.mass.min()) / (4 / hx**2 + 4 * ratio / hy**2)
    slopes = math.pi**2 / 4 * width * height * (1 / width**2 + ratio / height**2)
    return math.sqrt(force / (bending.berger * slopes)) / scene.plate.thickness


def bytes_text(count: float) -> str:
    """Return a number of bytes with a suitable unit: "26.5 kB"."""
    power = min(int(math.log10(count) / 3), 3)
    return f"{count / 1000**power:.3g} {('B', 'kB', 'MB', 'GB')[power]}"


def costs_of(written: Scene, resolved: Resolved) -> dict[str, Cost | str]:
    """Return the costs of the run and of the search of a scene resolved for a check; the reason where it is refused."""
    costs: dict[str, Cost | str] = {"run": cost_of_run(resolved)}
    try:
        # A grid that was chosen for an accuracy serves the search too.
        searched = with_method_of_engine(resolved, written.search)
        if written.grid.accuracy is None:
            searched = resolve_search(written, resolved.device)
        costs["search"] = cost_of_search(searched)
    except SceneError as error:
        costs["search"] = str(error)
    return costs


def cost_text(cost: Cost | str) -> str:
    """Return a cost for people."""
    if isinstance(cost, str):
        return f"refused: {cost}"
    needed, room, parts = PROGRAM + sum(cost.memory.values()), memory_room(), []
    if cost.candidates > 1:
        parts.append(f"up to {cost.candidates} designs")
    if cost.plates:
        parts.append(f"{cost.plates} plates in time steps" if cost.plates > 1 else "a plate in time steps")
        parts.append(f"{cost.node_steps:.2g} node-steps")
    if cost.seconds is not None:
        parts.append(f"about {seconds_text(cost.seconds)} of a core")
    parts.append(f"about {bytes_text(needed)} of memory")
    largest = max(cost.memory, key=lambda key: cost.memory[key])
    if needed - PROGRAM > room:
        parts.append(f"more than the {bytes_text(room)} that may be taken here: lower {largest}")
    elif cost.memory[largest] > PROGRAM:
        parts.append(f"most of it by {largest}")
    return ", ".join(parts)
