"""What a scene asks of the machine and of the numbers, told before anything runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.analysis.warnings import Finding, find_warnings, slowest_frequency, wavelengths
from warp_plate.plate.bending import Bending
from warp_plate.plate.discretization import discretize
from warp_plate.plate.scheme import Scheme
from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.stability_limit import StabilityLimit
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.paths import choose_path
from warp_plate.solve.specialize import specialize
from warp_plate.solve.state import bytes_per_plate


@dataclass(frozen=True)
class Check:
    """nodes: (nx, ny); time_step, limit.time_step [s]; steps: of the run; growth: by which factor the fastest motion
    grows in a step, 1 where it does not; steps_a_period, points_a_wavelength: of the highest drive frequency [Hz];
    slowest, fastest: natural frequencies of the grid [Hz]; amplitude: of the lowest bending shape, in thicknesses, at
    which stretching brings the limit down to the time step, None without stretching; plate_bytes: device memory of a
    plate; plates: of a search at once; device, path, precision: where and how it runs; findings: see ``warnings``.
    """

    nodes: tuple[int, int]
    order: int
    precision: str
    time_step: float
    steps: int
    limit: StabilityLimit
    stable: bool
    growth: float
    frequency: float
    steps_a_period: float
    points_a_wavelength: float
    slowest: float
    fastest: float
    amplitude: float | None
    plate_bytes: int
    plates: int
    device: str
    path: str
    findings: tuple[Finding, ...]

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue: the square of the ratio of the fastest frequency to the slowest."""
        return (self.fastest / self.slowest) ** 2 if self.slowest else math.inf

    @property
    def rounding(self) -> float:
        """What rounding leaves of a motion of the slowest mode, relative, of the order of: the unit of the last place,
        once for each radian of the fastest motion in one of the slowest (docs/hard-cases.md has it measured)."""
        return float(np.finfo(self.precision).eps) * self.fastest / self.slowest if self.slowest else math.inf

    def sentences(self) -> list[str]:
        """All of it in words."""
        return [_of_step(self), _of_limit(self), _of_drive(self), _of_condition(self), _of_machine(self)] + (
            [_of_stretching(self)] if self.amplitude is not None else []
        )

    def as_json(self) -> Mapping[str, object]:
        """The same as numbers."""
        return {
            "nodes": list(self.nodes),
            "order": self.order,
            "precision": self.precision,
            "time_step": self.time_step,
            "steps": self.steps,
            "limit": self.limit.time_step,
            "limit_shares": dict(self.limit.shares),
            "limit_by_formula": self.limit.formula,
            "limit_place": None if self.limit.place is None else list(self.limit.place),
            "stable": self.stable,
            "growth_a_step": self.growth,
            "drive_frequency": self.frequency,
            "steps_a_period": self.steps_a_period,
            "points_a_wavelength": self.points_a_wavelength,
            "slowest_frequency": self.slowest,
            "fastest_frequency": self.fastest,
            "condition": self.condition,
            "rounding": self.rounding,
            "stretching_amplitude": self.amplitude,
            "bytes_a_plate": self.plate_bytes,
            "plates": self.plates,
            "device": self.device,
            "path": self.path,
            "numbers": [vars(finding) for finding in self.findings],
            "sentences": self.sentences(),
            "warnings": [finding.sentence for finding in self.findings if finding.exceeded],
        }


def check(scene: Scene, device: str = "auto", allow_unstable: bool = False) -> Check:
    """Look at a scene with a grid, without running it.

    Raises:
        SceneError: see ``discretize``; no such device.
    """
    specialized = specialize(discretize(scene, allow_unstable=allow_unstable), find_device(device))
    scheme = specialized.scheme
    limit, bending = scheme.stability, scheme.bending
    pairs = zip(wavelengths(scene), scheme.spacing, strict=True)
    over = scheme.time_step / limit.time_step
    return Check(
        nodes=scheme.nodes,
        order=scheme.order,
        precision=scene.grid.precision,
        time_step=scheme.time_step,
        steps=scheme.steps,
        limit=limit,
        stable=scheme.stable,
        growth=1.0 if scheme.stable else math.exp(2 * math.acosh(over)),
        frequency=highest_frequency(scene),
        steps_a_period=1 / (highest_frequency(scene) * scheme.time_step),
        points_a_wavelength=min(wave / spacing for wave, spacing in pairs),
        slowest=slowest_frequency(scene),
        fastest=limit.frequency,
        amplitude=_amplitude(scene, scheme, bending, limit) if scene.effects.stretching and bending else None,
        plate_bytes=bytes_per_plate(specialized, 4 * len(scene.record.points)),
        plates=scene.search.particles,
        device=specialized.device.alias,
        path=choose_path(specialized),
        findings=tuple(find_warnings(scene, None)),
    )


def _amplitude(scene: Scene, scheme: Scheme, bending: Bending, limit: StabilityLimit) -> float:
    """In thicknesses: see ``Check``.

    A tension N, κN along y, adds N(4/hx² + 4κ/hy²)/ρH to the largest eigenvalue 4/limit², and Berger's is proportional
    to ∫ u_x² + κu_y² dA, which is a²π²/4 · area · (1/width² + κ/height²) of a sin sin.
    """
    (hx, hy), (width, height), ratio = scheme.spacing, scene.plate.size, bending.stretch_ratio
    spare = 4 / scheme.time_step**2 - 4 / limit.time_step**2
    tension = max(spare, 0.0) * float(bending.mass.min()) / (4 / hx**2 + 4 * ratio / hy**2)
    slopes = math.pi**2 / 4 * width * height * (1 / width**2 + ratio / height**2)
    return math.sqrt(tension / (bending.berger * slopes)) / scene.plate.thickness


def _of_step(check: Check) -> str:
    ratio = check.time_step / check.limit.time_step
    text = f"The time step is {check.time_step:.6g} s, {ratio:.3g} of the limit of {check.limit.time_step:.6g} s; the "
    text += f"run takes {check.steps} steps."
    if not check.stable:
        text += f" It is too long: the fastest motion grows {check.growth:.3g} times in every step."
    return text


def _of_limit(check: Check) -> str:
    shares = sorted(check.limit.shares.items(), key=lambda pair: -pair[1])
    words = ", ".join(f"{name} {100 * part:.3g} %" for name, part in shares if part >= 0.005)
    if check.limit.formula:
        return f"What sets the limit is the shortest wave that the grid carries, by formula: {words}."
    assert check.limit.place is not None
    x, y = check.limit.place
    return (
        f"What sets the limit is the fastest motion of this scene's own matrices, strongest at x = {x:.3g} m, "
        f"y = {y:.3g} m: {words}."
    )


def _of_drive(check: Check) -> str:
    return (
        f"The highest drive frequency, {check.frequency:g} Hz, has {check.steps_a_period:.3g} steps a period and "
        f"{check.points_a_wavelength:.3g} points a bending wavelength."
    )


def _of_condition(check: Check) -> str:
    if not check.slowest:
        return f"The fastest natural frequency of the grid is {check.fastest:.4g} Hz; nothing holds the plate."
    return (
        f"Natural frequencies go from {check.slowest:.4g} to {check.fastest:.4g} Hz, a condition number of "
        f"{check.condition:.2g}: rounding in {check.precision} leaves errors of {check.rounding:.0e} of the motion or "
        "less."
    )


def _of_machine(check: Check) -> str:
    whole = check.plate_bytes * check.plates
    how = "all steps in one launch" if check.path == "resident" else "one or a few steps a launch"
    return (
        f"{check.nodes[0]} × {check.nodes[1]} nodes of order {check.order} take {_bytes(check.plate_bytes)} a plate, "
        f"{_bytes(whole)} for the {check.plates} plates of a search, on {check.device}, path {check.path} ({how})."
    )


def _of_stretching(check: Check) -> str:
    return (
        f"Stretching is not in the limit: from an amplitude of about {check.amplitude:.3g} thicknesses on (of the "
        "lowest bending shape) it makes this time step too long."
    )


def _bytes(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"
