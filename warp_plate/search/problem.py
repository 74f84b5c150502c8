"""What a search is about: from positions, by way of designs and of what their plates do, to losses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from warp_plate.plate.designs import Designs, own_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Record, Scene
from warp_plate.search.free import with_step
from warp_plate.search.objective import loss
from warp_plate.search.space import Space
from warp_plate.search.variables import Variables, variables_of
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver

Evaluator = Literal["direct", "response"]
Energies = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Problem:
    """A scene's search, compiled.

    variables: what is free; plain: plates of the scene that differ in their drives alone; solver: the ones that the
    search runs, which is the same where nothing but drives is free; response: energies of all drives in Gram matrices,
    None where they are no quadratic forms; evaluator: "response" takes energies from these instead of from plates;
    path: as asked for; spent: seconds that compiling took, and node-steps of what was measured, before the search.
    """

    variables: Variables
    plain: PlateSolver
    solver: PlateSolver
    response: Response | None
    evaluator: str
    path: str
    spent: tuple[float, int]

    @property
    def scene(self) -> Scene:
        """With a grid and a time step that carry all that may be found."""
        return self.variables.scene

    @property
    def space(self) -> Space:
        """The numbers that are searched."""
        return self.variables.space

    @property
    def node_steps(self) -> int:
        """Of all plates so far."""
        return self.spent[1] + sum(one.node_steps for one in {self.plain, self.solver})

    @property
    def compile_seconds(self) -> float:
        """Of all solvers."""
        return self.spent[0] + sum(one.compile_seconds for one in {self.plain, self.solver})

    def energies(self, designs: Designs) -> np.ndarray:
        """(plates, regions) energies [J]."""
        if designs.only_drives:
            return self.energies_of_drives(designs.drives)
        return self.solver.run(designs).energy

    def energies_of_drives(self, drives: np.ndarray) -> np.ndarray:
        """(plates, regions) energies [J] of drives (plates, actuators) where the scene has its frequency and places."""
        if self.evaluator == "response" and self.response is not None:
            return self.response.energy(drives)
        return self.plain.run(drives).energy

    def losses(self, positions: np.ndarray) -> np.ndarray:
        """(n,) what is to be made small, of positions (n, dimension); NaN where a plate has no energies."""
        return loss(self.energies(self.variables.designs(positions)))

    @cached_property
    def bound(self) -> float | None:
        """The largest localization factor that any drive can reach; None where none is claimed."""
        return None if self.response is None else self.response.bound()


def make_problem(
    scene: Scene,
    device: str = "auto",
    path: str = "auto",
    evaluator: str = "direct",
    matrices: np.ndarray | None = None,
) -> Problem:
    """The problem of a scene with a grid.

    Args:
        device, path: see :class:`PlateSolver`; evaluator: see :class:`Problem`.
        matrices: of the response, where they are known already.

    Raises:
        SceneError: see ``variables_of``, ``with_step`` and :class:`PlateSolver`; "response" for what is no quadratic
            form of the drives.
    """
    variables = variables_of(with_step(scene))
    scene = variables.scene
    if evaluator == "response" and not variables.quadratic:
        raise SceneError(f"evaluator = 'response': {_why_not_quadratic(variables)}; write 'direct'")
    plain = PlateSolver(scene, device, path)
    solver = plain if variables.only_drives else PlateSolver(scene, device, path, own=own_of(scene))
    spent = 0.0, 0
    if matrices is None and variables.quadratic:
        exact = plain if scene.grid.precision == "float64" else PlateSolver(in_float64(scene), device, path)
        matrices = measure_response(exact).matrices
        if exact is not plain:
            spent = exact.compile_seconds, exact.node_steps
    response = None if matrices is None else Response(matrices)
    return Problem(variables, plain, solver, response, evaluator, path, spent)


def _why_not_quadratic(variables: Variables) -> str:
    if not variables.scene.linear:
        return f"{variables.scene.not_linear} is not linear in the drives"
    kinds = {one.kind: None for one in variables.numbers if one.kind not in ("magnitude", "phase")}
    return f"no Gram matrix holds where {', '.join(kinds)} is searched"


def in_float64(scene: Scene) -> Scene:
    """For energies whose differences lose digits; nothing is recorded."""
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": "float64"}), "record": Record()})
