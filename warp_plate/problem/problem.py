"""What a search is about: from positions, by way of designs and of what their plates do, to losses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from warp_plate.cluster.evaluator import Evaluator, make_evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.space import Space
from warp_plate.plate.designs import Batch, Designs, per_plate_of
from warp_plate.plate.row_blocks import GrowingRows
from warp_plate.plate.weights import Region
from warp_plate.problem.bounds import Bound
from warp_plate.problem.design_variables import has_design_tables, with_common_step
from warp_plate.problem.loss_bounds import bound_loss
from warp_plate.problem.objectives import Objectives, make_objectives
from warp_plate.problem.parametrization import Parametrization, Positions, parametrization_of
from warp_plate.result.crosstalk import target_regions
from warp_plate.result.model import BoundKind
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Record, Scene
from warp_plate.scene.search import Limits
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver

EvaluatorName = Literal["direct", "response"]
Energies = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Problem:
    """A scene's search, compiled.

    variables: what is free; judge: of energies. plain: plates of the scene that differ in their drives alone; solver:
    the ones that the search runs, which is the same where nothing but drives is free; moved: the same for ½ ∫ ρH u² dA,
    None where displacements are not judged. response, displacement_response: of plain and moved, energies of all
    drives in
    Gram matrices, None where they are no quadratic forms. evaluator: "response" takes energies from these instead of
    from plates; path: as asked for; spent: seconds that compiling took, and node-steps of what was measured, before the
    search. pool: which runs the plates of plain, solver and moved; None: this process.
    """

    parametrization: Parametrization
    objectives: Objectives
    drive_evaluator: Evaluator
    design_evaluator: Evaluator
    displacement_evaluator: Evaluator | None
    response: Response | None
    displacement_response: Response | None
    evaluator_name: str
    path: str
    spent: tuple[float, int]
    pool: WorkerPool | None

    @property
    def drive_solver(self) -> PlateSolver:
        """The solver of ``drive_evaluator``."""
        return self.drive_evaluator.solver

    @property
    def design_solver(self) -> PlateSolver:
        """The solver of ``design_evaluator``."""
        return self.design_evaluator.solver

    @property
    def scene(self) -> Scene:
        """With a grid and a time step that carry all that may be found."""
        return self.parametrization.scene

    @property
    def space(self) -> Space:
        """The numbers that are searched."""
        return self.parametrization.space

    @property
    def only_localization(self) -> bool:
        """Whether losses are 1 − LF."""
        return self.objectives.only_localization

    @property
    def node_steps(self) -> int:
        """Of all plates so far."""
        return self.spent[1] + sum(one.node_steps for one in self._evaluators)

    @property
    def compile_seconds(self) -> float:
        """Of all solvers."""
        return self.spent[0] + sum(one.compile_seconds for one in self._evaluators)

    @property
    def lost(self) -> Counter[str]:
        """Plates without energies because workers failed, by what went wrong."""
        return lost_plates(self._evaluators)

    @property
    def matrices(self) -> np.ndarray | None:
        """(regions, 2M, 2M) of the response, and after them those of displacements; what ``make_nominal_problem``
        takes."""
        known = [one.matrices for one in (self.response, self.displacement_response) if one is not None]
        return np.concatenate(known) if known else None

    def energies(self, designs: Batch) -> np.ndarray:
        """(plates, regions) energies [J]."""
        if self._of_response(designs):
            return self.energies_of_phasors(designs[:].drives)
        return self._evaluator_of(designs).run(designs).energy

    def energies_of_phasors(self, drives: np.ndarray) -> np.ndarray:
        """(plates, regions) energies [J] of drives (plates, actuators) where the scene has its frequency and places."""
        if self.evaluator_name == "response" and self.response is not None:
            return self.response.energy(drives)
        return self.drive_evaluator.run(drives).energy

    def losses_of(self, designs: Batch) -> np.ndarray:
        """(plates,) what is to be made small; NaN where a plate has no energies."""
        if self.objectives.needs_displacement or self._of_response(designs):
            return self.objectives.losses(self.energies(designs), self._displaced(designs))
        losses = np.empty(len(designs))

        def judge(some: slice, energy: np.ndarray) -> None:
            losses[some] = self.objectives.losses(energy)

        self._evaluator_of(designs).run(designs, on_block=judge)  # some are judged while others are simulated
        return losses

    def losses(self, positions: np.ndarray | GrowingRows) -> np.ndarray:
        """(n,) the same of positions (n, dimension)."""
        return self.losses_of(Positions(self.parametrization, positions))

    def value_from_loss(self, loss: float | np.ndarray) -> float | np.ndarray:
        """What people want large: LF, or the weighted sum of the objectives."""
        return 1 - loss if self.only_localization else -loss

    def objective_values(self, position: np.ndarray) -> dict[str, float]:
        """What a position (dimension,) is worth: ``Objectives.worth``, and the "bound" of its sum where one is known
        and the
        limits are kept. Nothing where the localization factor is all that is sought: a result has it."""
        if self.only_localization:
            return {}
        designs = self.parametrization.designs(position[None])
        worth = self.objectives.values(self.energies(designs), self._displaced(designs))
        found = {name: float(value[0]) for name, value in worth.items()}
        if self.loss_bound is None or not self.objectives.within_limits(found):
            return found
        return {**found, "bound": -self.loss_bound.value}

    @cached_property
    def quadratic(self) -> Quadratic | None:
        """For methods that need no plates; None where energies are no quadratic forms of the drive."""
        if self.response is None or self.matrices is None:
            return None
        count = len(self.response.matrices)

        def losses_of(energy: np.ndarray) -> np.ndarray:
            return self.objectives.losses(energy[:, :count], energy[:, count:] if self.displacement_response else None)

        return Quadratic(
            matrices=self.matrices,
            drives=lambda positions: self.parametrization.designs(positions).drives,
            positions=lambda drives: self.parametrization.positions_of(Designs(drives)),
            losses_of=losses_of,
            localization=self.only_localization,
        )

    @cached_property
    def loss_bound(self) -> Bound | None:
        """The least loss that is proved to be out of reach; None where none is claimed."""
        return bound_loss(self.parametrization, self.objectives, self.response, self.displacement_response)

    @cached_property
    def bound(self) -> float | None:
        """The largest localization factor that any drive can reach; None where none is claimed, or something else is
        sought."""
        if self.response is None or not self.only_localization or self.loss_bound is None:
            return None
        return 1 - self.loss_bound.value if self._limited else self.response.bound()

    @property
    def bound_kind(self) -> BoundKind:
        """Of that bound, or of that of the objectives' sum."""
        if self.loss_bound is None:
            return ""
        if self.only_localization and not self._limited:
            return "attained"
        return "bound only" if self.loss_bound.kind == "bound only" else "attained within limits"

    @property
    def _limited(self) -> bool:
        """Whether some drives may not be chosen."""
        return has_design_tables(self.scene) or self.scene.search.limits != Limits()

    def _evaluator_of(self, designs: Batch) -> Evaluator:
        return self.drive_evaluator if designs.only_drives else self.design_evaluator

    def _of_response(self, designs: Batch) -> bool:
        """Whether Gram matrices give their energies."""
        return self.evaluator_name == "response" and designs.only_drives

    def _displaced(self, designs: Batch) -> np.ndarray | None:
        """(plates, regions) energies of displacements, where these are judged."""
        if self.evaluator_name == "response" and self.displacement_response is not None:
            return self.displacement_response.energy(designs[:].drives)
        return None if self.displacement_evaluator is None else self.displacement_evaluator.run(designs).energy

    @property
    def _evaluators(self) -> set[Evaluator]:
        evaluators = (self.drive_evaluator, self.design_evaluator, self.displacement_evaluator)
        return {evaluator for evaluator in evaluators if evaluator is not None}


def make_nominal_problem(
    scene: Scene,
    device: str = "auto",
    path: str = "auto",
    evaluator: str = "direct",
    matrices: np.ndarray | None = None,
    pool: WorkerPool | None = None,
) -> Problem:
    """The problem of a scene with a grid.

    Args:
        device, path: see :class:`PlateSolver`; evaluator: see :class:`Problem`.
        matrices: see ``Problem.matrices``, where they are known already.
        pool: see :class:`Problem`.

    Raises:
        SceneError: see ``parametrization_of``, ``with_common_step``, ``make_objectives`` and :class:`PlateSolver`;
        "response" for what is
            no quadratic form of the drives.
    """
    variables = parametrization_of(with_common_step(scene))
    scene, per_plate = variables.scene, per_plate_of(variables.scene)
    if evaluator == "response" and not variables.quadratic:
        raise SceneError(f"evaluator = 'response': {_why_not_quadratic(variables)}; write 'direct'")
    judge = make_objectives(scene)
    areas = summed_regions(scene, judge)
    plain = make_evaluator(scene, device, path, pool, areas=areas)
    solver, moved = plain, None
    if not variables.only_drives:
        solver = make_evaluator(scene, device, path, pool, areas=areas, per_plate=per_plate)
    if judge.needs_displacement:
        moved = make_evaluator(scene, device, path, pool, areas=areas, per_plate=per_plate, quantity="displacement")
    seconds, node_steps = 0.0, 0
    if matrices is None and variables.quadratic:
        parts = []
        for one in (plain, moved):
            if one is not None:
                exact = one.solver if scene.grid.precision == "float64" else _in_float64(one.solver, path)
                parts.append(measure_response(exact).matrices)
                if exact is not one.solver:
                    seconds, node_steps = seconds + exact.compile_seconds, node_steps + exact.node_steps
        matrices = np.concatenate(parts)
    sets = 1 if moved is None else 2
    regions = sets * len(plain.solver.specialized.regions)
    if matrices is not None and len(matrices) != regions:
        raise SceneError(f"matrices: of {len(matrices)} regions; must be {regions}")
    known = [] if matrices is None else np.split(matrices, sets)
    responses = [Response(one) for one in known] + [None, None]
    return Problem(
        variables, judge, plain, solver, moved, responses[0], responses[1], evaluator, path, (seconds, node_steps), pool
    )


def lost_plates(evaluators: Iterable[Evaluator]) -> Counter[str]:
    """Plates that these evaluators have lost, by what went wrong."""
    return sum((evaluator.lost for evaluator in evaluators), Counter())


def _why_not_quadratic(variables: Parametrization) -> str:
    if not variables.scene.linear:
        return f"{variables.scene.nonlinear_table} is not linear in the drives"
    kinds = {one.kind: None for one in variables.numbers if one.kind not in ("magnitude", "phase")}
    return f"no Gram matrix holds where {', '.join(kinds)} is searched"


def in_float64(scene: Scene) -> Scene:
    """For energies whose differences lose digits; nothing is recorded."""
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": "float64"}), "record": Record()})


def _in_float64(solver: PlateSolver, path: str) -> PlateSolver:
    made, quantity = in_float64(solver.scene), solver.specialized.quantity
    areas = summed_regions(made, make_objectives(made))
    return PlateSolver(made, solver.device.alias, path, areas=areas, quantity=quantity)


def summed_regions(scene: Scene, judge: Objectives) -> dict[str, Region]:
    """What is summed beside the plate and the target: what the judge needs, then all of several targets."""
    return {**judge.regions, **target_regions(scene)}
