"""Searches by modes, against time stepping on fine grids and the plain Gram matrices."""

from dataclasses import replace

import numpy as np
import pytest

from support.scenes import MATERIAL, scene_of
from warp_plate import Scene, SceneError, localize, simulate, sweep
from warp_plate.analysis.result_warnings import result_warnings
from warp_plate.modal.gram import Means, gram_matrices
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.designs import Designs, PerPlate
from warp_plate.problem.methods import resolve_search, with_method
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve
from warp_plate.solve.solver import PlateSolver
from warp_plate.studies.spectrum import factors_over

FREE_DRIVES = {"magnitude": {"range": (0.0, 2.0)}, "phase": {}}
FINGER = {"area": (0.09, 0.11, 0.09, 0.11), "mass": 0.002, "stiffness": 400.0, "damping": 0.2}


def paper(**tables):
    return Scene.load("paper").with_tables(**tables)


@pytest.mark.parametrize(
    ("varied", "effects"),
    [
        ("places", {"damping": {"viscous": 80.0}}),
        ("common frequency", {"damping": {"viscous": 80.0}}),
        pytest.param("frequencies", {"oscillators": [FINGER]}, marks=pytest.mark.slow),
        ("steady", {"damping": {"viscous": 80.0}}),
        ("steady", {"oscillators": [FINGER]}),
    ],
)
def test_batches_have_the_energies_of_plain_gram_matrices(random, effects, varied):
    """E = zᵀ G z for every plate of a batch, by another route."""
    if varied == "steady":
        effects = {**effects, "loss_factor": {"eta": 0.02}}
    scene = paper(effects=effects, grid={"load": "moments"})
    solver = ModalSolver(scene, "cpu", per_plate=PerPlate(True, False, True, per_actuator=True))
    plates, tone = 5, 290.0
    drives = random.normal(size=(plates, 4)) + 1j * random.normal(size=(plates, 4))
    centre = random.uniform(0.02, 0.18, (plates, 4, 2))
    tones = {"common frequency": (plates, 1), "frequencies": (plates, 4)}.get(varied)
    frequency = np.full((plates, 4), tone) if tones is None else tone * random.uniform(0.6, 1, tones) * np.ones(4)
    run = solver.run(Designs(drives, frequency, centre))
    plate, scene = solver.plate, solver.scene
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    half = np.ptp(np.reshape(scene.actuators[0].area, (2, 2)), axis=1) / 2
    areas = np.stack([centre - half, centre + half], axis=-1).reshape(plates, 4, 4)
    forces = np.stack([plate.patch_forces(row) for row in areas])
    window = None if scene.steady else scene.window
    z = real_parts(drives)
    energy = np.einsum("pa,prab,pb->pr", z, gram_matrices(Means(plate, regions, window), forces, frequency), z)
    assert np.allclose(run.energy, energy, rtol=1e-5)


@pytest.mark.parametrize(
    "search",
    [
        {},
        {"frequency": {"range": [2e4, 4e4]}, "magnitude": {"range": [0.0, 1.0]}},
        {"robust": {"scenarios": 2, "young_modulus": 0.1}},
    ],
    ids=["drives", "frequency", "robust"],
)
def test_modes_need_no_stable_time_step(random, search):
    """A stiff plate has the losses of an ordinary grid also where it takes 2e8 steps, or has a step above the limit."""
    plate = {**MATERIAL, "size": (0.01, 0.01), "thickness": 1.9e-3, "young_modulus": 7e10}
    stiff = {"plate": plate, "size": (0.01, 0.01), "frequency": 3e4, "window": (0.05, 0.1), "search": search}
    ordinary, fine, above = (
        scene_of(**grid, **stiff) for grid in ({"nodes": (9, 9)}, {"nodes": (129, 129)}, {"time_step": 1e-6})
    )
    for scene in (fine, above):
        with pytest.raises(SceneError, match=r"steps of|above the stability limit"):
            PlateSolver(scene, "cpu")
    problems = [make_problem(resolve(scene, "cpu", evaluator="modal")) for scene in (ordinary, fine, above)]
    positions = problems[0].space.from_unit(random.random((4, problems[0].space.dimension)))
    losses = [problem.losses(positions) for problem in problems]
    assert np.isfinite(losses).all()
    assert np.array_equal(losses[0], losses[1])
    assert np.array_equal(losses[0], losses[2])


def test_robust_search_by_modes_is_the_limit_of_its_simulated_matrices():
    robust = {"scenarios": 2, "thickness": 0.05, "place": 0.002, "gain": 0.1}
    grid = {"nodes": (33, 33), "order": 4, "load": "moments"}
    scene = paper(search={"robust": robust}, grid=grid)
    drives = np.array([[1, 0.2, 0.1j, 0.4]])
    problems = [make_problem(resolve(scene, "cpu", evaluator=name)) for name in ("modal", "response")]
    losses = [problem.design_losses(Designs(drives)) for problem in problems]
    assert losses[0] == pytest.approx(losses[1], abs=3e-3)


def test_a_search_without_a_method_is_exact_and_by_modes_where_it_can_be():
    """Limits, fixed numbers and velocities take descents; keys of a swarm, sums and nonlinear scenes take a swarm."""
    result = localize(paper(search={}), device="cpu", estimate=False)
    assert (result.evaluator, result.scene.search.method) == ("modal", "exact")
    assert result.bound == pytest.approx(0.654001, rel=1e-5)
    # A common phase, which the search leaves out, moves it a little while start-up motion is left.
    assert result.cases["best"].localization_factor == pytest.approx(result.bound, rel=4e-5)
    chirp = {"frequency": 290.0, "chirp": {"end_frequency": 300.0, "duration": 0.1}}
    for tables, method in (
        ({"search": {"particles": 30}}, "pso"),
        ({"search": {"objectives": [{"kind": "contrast"}]}}, "exact"),
        ({"search": {"objectives": [{"kind": "uniformity"}]}}, "pso"),
        ({"search": {"objectives": [{"kind": "velocity"}], "limits": {"power": 1.0}}}, "gradient"),
        ({"search": {"objectives": [{}, {"kind": "contrast"}]}}, "pso"),
        ({"search": {}, "effects": {"stretching": {}}}, "pso"),
        ({"search": {"method": "ring"}}, "ring"),
        ({"search": {"limits": {"equal_magnitudes": True}}}, "gradient"),
        ({"search": {"magnitude": {"range": (0.5, 2.0)}, "phase": {}}}, "gradient"),
        ({"search": {"phase": {}}}, "gradient"),
        ({"search": {**FREE_DRIVES, "frequency": {"range": (200.0, 300.0)}}}, "pso"),
        ({"search": {}, "drive": chirp}, "exact"),
        ({"search": FREE_DRIVES}, "exact"),
        ({"search": {"limits": {"magnitude": 2.0, "power": 3.0}}}, "exact"),
        ({"search": {**FREE_DRIVES, "limits": {"least_velocity": 1e-3, "sound": 60.0}}}, "gradient"),
    ):
        assert with_method(paper(**tables)).search.method == method


def test_a_common_frequency_alone_is_taken_from_the_spectrum(scene):
    """Without a method, the best drive at every frequency that the spectrum has, and between them, is exact."""
    search = {"magnitude": {"range": [0.0, 1.0]}, "phase": {}, "frequency": {"range": [60.0, 200.0]}}
    made = scene(effects={"loss_factor": {"eta": 0.02}}, search=search, modal_density=0.5)
    found = localize(made, device="cpu", estimate=False)
    assert found.scene.search.method == "exact"
    best = found.cases["best"]
    assert best.localization_factor >= found.spectrum["best"].max() * (1 - 1e-9)
    swept = sweep(made, ["search.seed=3"], device="cpu").values
    assert swept["best"][0] == pytest.approx(best.localization_factor, rel=1e-12)
    # No frequency of a dense set around it is better.
    resolved = resolve(made, "cpu", evaluator="modal")
    near = best.frequency[0] + np.linspace(-0.5, 0.5, 41)
    factors = factors_over(resolved, near[(near >= 60) & (near <= 200)])["best"]
    assert best.localization_factor >= factors.max() * (1 - 1e-9)
    alone = localize(
        made.with_tables(search={"frequency": {"range": [60.0, 200.0]}}), device="cpu", estimate=False, spectrum=False
    )
    assert alone.scene.search.method == "exact"
    assert alone.cases["best"].localization_factor <= best.localization_factor
    for more in ({"method": "ring"}, {"position": {}}, {"particles": 4}):
        assert resolve_search(made.with_tables(search={**search, **more}), "cpu").scene.search.method != "exact"


def test_a_best_frequency_at_the_end_of_its_range_is_said(scene):
    drives = {"magnitude": {"range": [0.0, 1.0]}, "phase": {}}
    made = scene(effects={"loss_factor": {"eta": 0.02}}, modal_density=0.5)

    def ends_of(low, high):
        searched = made.with_tables(search={**drives, "frequency": {"range": [low, high]}})
        result = localize(searched, device="cpu", estimate=False, spectrum=False)
        return result.cases["best"].frequency[0], [line for line in result.warnings if "search.frequency" in line]

    best, lines = ends_of(60.0, 200.0)
    assert 61 < best < 199
    assert not lines
    end, lines = ends_of(best - 3, best - 1)
    assert end == pytest.approx(best - 1)
    assert [line.split(":")[0] for line in lines] == [f"search.frequency.range = [{best - 3:g}, {best - 1:g}]"]


def test_a_spectrum_follows_every_resonance(scene):
    """Within its half-width ηf/2, and the drive found is as good as the best there."""
    drives = {"magnitude": {"range": [0.0, 1.0]}, "phase": {}, "frequency": {"range": [30.0, 250.0]}}
    search = {"particles": 8, "iterations": 4, **drives}
    made = scene(effects={"loss_factor": {"eta": 0.002}}, search=search, modal_density=0.5)
    found = localize(made, device="cpu", estimate=False)
    frequencies, resonances = found.spectrum["frequency"], found.spectrum["resonances"]
    assert len(resonances) > 3
    gaps = np.abs(frequencies[:, None] - resonances).min(axis=0)
    np.testing.assert_array_less(gaps, 0.001 * resonances)
    assert found.spectrum["best"].max() <= found.cases["best"].localization_factor + 1e-6


def test_the_accuracy_asked_for_holds_at_the_places_found():
    """Modes that keep it where the search begins, and not where it ends, are replaced by more."""
    scene = paper(
        search={"position": {"actuators": ["upper left"]}, "particles": 4, "iterations": 2},
        effects={"loss_factor": {"eta": 0.02}},
        drive={"frequency": 150.0},
    )
    few = localize(scene.with_accuracy(0.4), device="cpu")
    before, after = few.accuracy["expected"], few.accuracy["estimate"]["error"]
    assert before < after
    asked = (before * after) ** 0.5
    more = localize(scene.with_accuracy(asked), device="cpu")
    best = more.cases["best"]
    assert more.accuracy["estimate"]["error"] <= asked
    assert (few.scene.grid.modal_density, more.scene.grid.modal_density) == (1.0, 1.5)
    assert "at the places or frequency found" in more.accuracy["reason"]
    assert best.localization_factor == pytest.approx(few.cases["best"].localization_factor, rel=2 * after)
    again = simulate(more.driven_scene(best), device="cpu", path="modal", estimate=False)
    assert again.cases["drive"].localization_factor == pytest.approx(best.localization_factor, rel=1e-12)
    assert more.history["best"][-1] == pytest.approx(best.localization_factor, rel=1e-9)


def test_weak_drives_and_actuators_in_the_target_are_said():
    search = {"position": {"actuators": ["upper left"], "area": [0.05, 0.09, 0.05, 0.09]}}
    moved = paper(search={**search, "particles": 3, "iterations": 1}, grid={"load": "overlap"})
    result = localize(moved, device="cpu", estimate=False)
    best = result.cases["best"]

    def said(part, **changes):
        changed = replace(result, cases={**result.cases, "best": replace(best, **changes)})
        return [line for line in result_warnings(changed) if part in line]

    assert not said("is weak")
    assert said("is weak", phasors=100 * best.phasors)  # a hundred times the force for the same motion
    assert said("sit in the target: upper left", centre=np.full((4, 2), [0.03, 0.03]))
    assert not said("sit in the target", centre=np.full((4, 2), [0.15, 0.15]))
