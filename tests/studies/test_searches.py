"""Small searches for each kind of design variable, from the scene to the files."""

import json
from pathlib import Path

import numpy as np
import pytest

from support.scenes import scene_of
from support.searches import assert_same_results, interrupted_search
from warp_plate import PlateSolver, Scene, load_result, localize, resume
from warp_plate.analysis.motion import motions
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.methods import resolve_search
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve
from warp_plate.result.export import make_drive_signal
from warp_plate.result.model import save_result
from warp_plate.solve.response import largest_ratio, measure_response
from warp_plate.studies.searches import finish_search, search_optimizer
from warp_plate.studies.simulate import simulate
from warp_plate.studies.spectrum import factors_over

BURST = {"frequency": 290.0, "burst": {"duration": 0.004, "ramp": 0.001}}
SEARCHES = {
    "magnitude": {"magnitude": {"range": [0.0, 2.0]}, "phase": {}, "limits": {"power": 2.0}},
    "phase": {"phase": {}},
    "frequency": {"phase": {}, "frequency": {"range": [100.0, 300.0]}},
    "position": {"phase": {}, "position": {"area": [0.0, 0.2, 0.0, 0.15]}},
    "all": {
        "magnitude": {"range": [0.1, 2.0]},
        "phase": {},
        "frequency": {"range": [100.0, 400.0], "own": True},
        "position": {},
        "delay": {"range": [0.0, 0.004], "own": True},
    },
}
TITLES = {"frequency": "frequency (Hz)", "position": "x (m)", "delay": "burst from (s)"}


def small_search(name, particles=6, iterations=5, precision="float32", modal_density=0.5, **tables):
    search = {**SEARCHES[name], "particles": particles, "iterations": iterations, "seed": 2}
    drive = {"drive": BURST} if "delay" in search else {}
    return scene_of(
        nodes=(11, 11), damping=60.0, window=(0.004, 0.008), precision=precision, search=search,
        modal_density=modal_density, **drive, **tables,
    )  # fmt: skip


@pytest.mark.parametrize("name", SEARCHES)
def test_the_scene_found_simulates_to_the_result(name, tmp_path):
    """The best of the search, its case, its scene and the file of the result agree; the spectrum of a common frequency
    covers the range and bounds what the search finds."""
    result = localize(small_search(name), device="cpu", estimate=False)
    best, spectrum = result.cases["best"], result.spectrum
    # Kernels differ between a batch of plates with parameters of their own and a scene of its own.
    assert best.localization_factor == pytest.approx(result.history["best"][-1], abs=2e-5)
    assert np.all(np.diff(result.history["best"]) >= 0)
    path = "modal" if result.evaluator == "modal" else "auto"
    driven = result.driven_scene(best).with_tables(record={"times": tuple(result.times.tolist())})
    again = simulate(driven, device="cpu", path=path, estimate=False).cases["drive"]
    assert np.float32(again.localization_factor) == np.float32(best.localization_factor)
    np.testing.assert_array_equal(again.displacement, best.displacement)
    loaded = load_result(save_result(result, tmp_path / "one.h5"))
    np.testing.assert_equal(loaded.cases["best"].per_actuator, best.per_actuator)
    assert loaded.case_scene(loaded.cases["best"]) == result.case_scene(best)
    np.testing.assert_equal(loaded.spectrum, spectrum)
    assert not loaded.cases["equal"].per_actuator
    assert {heading for kind, heading in TITLES.items() if kind in SEARCHES[name]} <= best.per_actuator.keys()
    assert (result.bound is not None) == (name in ("magnitude", "phase"))
    assert bool(spectrum) == (name == "frequency")
    if spectrum:
        assert spectrum["frequency"][[0, -1]].tolist() == [100, 300]
        assert np.all(spectrum["best"] >= spectrum["equal"] - 1e-9)
        assert best.localization_factor <= np.interp(best.frequency[0], spectrum["frequency"], spectrum["best"]) + 0.02


LIMITED = [{"kind": "velocity", "rest_limit": 2e-5}]


@pytest.mark.parametrize(
    ("method", "objectives"),
    [
        *((method, [{"kind": "localization"}]) for method in ("pso", "cma")),
        ("gradient", LIMITED),
        *(pytest.param(method, LIMITED, marks=pytest.mark.slow) for method in ("pso", "ring", "cma")),
    ],
)
def test_more_freedom_gives_no_worse_drive(method, objectives):
    """A search of places and frequencies has at least the best drive for those that the scene has."""
    free = {"magnitude": {"range": [0.0, 2.0]}, "phase": {}, "objectives": objectives, "method": method}
    few = {**free, "particles": 4, "iterations": 3, "seed": 2}
    more = {**few, "position": {}, "frequency": {"range": [200.0, 300.0]}}
    scenes = [small_search("phase").with_tables(search=search) for search in ({**few, "method": "exact"}, more)]
    exact, freer = (localize(one, device="cpu", evaluator="modal", estimate=False, spectrum=False) for one in scenes)
    least = exact.history["best"][-1] * (1 - 1e-9)
    assert freer.history["best"][-1] >= least
    if objectives is LIMITED:
        assert freer.objective_values["velocity of the rest"] <= 2e-5


@pytest.mark.parametrize(("method", "particles"), [("constriction", 12), ("cma", 4)])
def test_a_swarm_of_places_leaves_those_of_the_scene(method, particles):
    """Where each place has its best drive, a swarm is drawn without the scene's own places, which would hold it there,
    and has them at the end where they are better; others begin at them."""
    search = {"magnitude": {"range": [0.0, 2.0]}, "phase": {}, "position": {}, "method": method}
    scene = small_search("phase").with_tables(search={**search, "particles": particles, "iterations": 1})
    problem = make_problem(resolve_search(scene, "cpu", evaluator="modal"))
    optimizer = search_optimizer(problem, 2)
    distances = np.abs(optimizer.ask() - problem.start).max(axis=1)
    assert (distances.min() == 0.0) == (method != "constriction")
    optimizer.tell(optimizer.ask(), np.ones(len(distances)))  # worse than the scene's, which then is the answer
    position, evaluations, history = finish_search(optimizer, problem, None, interrupted=True)
    if method == "constriction":
        np.testing.assert_array_equal(position, problem.complete(problem.start))
        assert evaluations == particles + 1 == history["evaluations"][-1]
    assert history["best"][-1] >= history["best"][0]


def test_an_interrupted_search_resumes_bit_identically(tmp_path):
    scene = small_search("all")
    _, checkpoint = interrupted_search(tmp_path, scene, device="cpu", after=2)
    assert_same_results(
        resume(checkpoint, estimate=False), localize(scene, source="mine", device="cpu", estimate=False)
    )


@pytest.fixture
def frequency_search(write_scene):
    """A search for a frequency and a position, in a file of the working folder."""
    scene = small_search("frequency")
    search = scene.search.model_dump() | {"position": {"actuators": ["0"]}, "method": "constriction", "inertia": 0.3}
    return write_scene(scene.with_tables(title="panel", search=search))


QUICK = ("--device", "cpu", "--no-estimate", "--no-pictures")


def test_the_command_writes_the_scene_that_it_found(frequency_search, command):
    record = json.loads(command("localize", "panel.toml", *QUICK, "--json")[1])
    assert record["files"] == ["panel-localize.h5", "panel-localize.best.toml"]
    assert {"magnitude", "phase"} <= record["drive"][0].keys()
    assert len(record["spectrum"]["frequency"]) >= 61
    assert "simulate panel-localize.best.toml --path modal\n" in Path(record["files"][1]).read_text()
    again = json.loads(command("simulate", "panel-localize.best.toml", "--path", "modal", *QUICK, "--json")[1])
    assert any(line.startswith("search.inertia = 0.3: method = 'constriction'") for line in record["warnings"])
    assert "search" not in "".join(again["warnings"])
    assert np.float32(again["localization_factor"]) == np.float32(record["localization_factor"]["best"])
    found = Scene.load("panel-localize.best.toml")
    assert found.drive.frequency == record["drive"][0]["frequency"]
    x0, x1, y0, y1 = found.actuators[0].area
    np.testing.assert_allclose([(x0 + x1) / 2, (y0 + y1) / 2], record["drive"][0]["centre"], rtol=1e-14)
    out = command("localize", "panel.toml", *QUICK, "--no-spectrum")[1]
    assert "x (m)" in out
    assert f"{found.drive.frequency:.5g}" in out
    assert not load_result("panel-localize.h5").spectrum


def test_motions_and_signals_use_the_frequency_and_positions_of_a_case(frequency_search):
    result = localize(frequency_search, device="cpu", estimate=False, spectrum=False)
    best = result.cases["best"]
    equal, found = motions(result.scene, {name: result.cases[name] for name in ("equal", "best")}, device="cpu")
    assert (equal.frequency, equal.scene) == (290, None)
    assert found.frequency == best.frequency[0]
    assert found.scene.actuators[0].area != result.scene.actuators[0].area
    assert found.span == equal.span
    assert found.span[1] - found.span[0] == pytest.approx(1 / min(290, best.frequency[0]))
    run = PlateSolver(result.driven_scene(best), "cpu").run(best.phasors[None], (float(found.times[3]),))
    np.testing.assert_array_equal(found.displacement[3], run.displacement[0, 0].astype(np.float32))
    assert make_drive_signal(result.case_scene(best), best, 48000, 1.0).frequency == best.frequency[0]
    pytest.importorskip("pyvista")
    from warp_plate.viz.fields import PictureStyle
    from warp_plate.viz.page import page_data

    page = page_data(result.scene, [equal, found], PictureStyle())
    assert page["plates"][0]["outlines"] is None
    moved = [one != other for one, other in zip(page["plates"][1]["outlines"], page["outlines"], strict=True)]
    assert (any(moved), all(moved)) == (True, False)  # those of the actuators


def best_of_all_phases(response):
    """The largest localization factor of three actuators of equal magnitude, by trying many phases."""
    turns = np.exp(1j * np.arange(0, 2 * np.pi, np.pi / 90))
    drives = np.stack(np.meshgrid(turns[:90:5], turns, turns), axis=-1).reshape(-1, 3)
    energy = response.energy(drives)
    return (energy[:, 1] / energy[:, 0]).max()


def test_the_spectrum_equals_scenes_of_one_frequency_each():
    """Equal drive, best single actuator and best drive, from Gram matrices of a scene of that frequency; the best of
    equal magnitudes by trying phases."""
    scene = small_search("frequency", precision="float64")
    frequencies = np.array([150.0, 290.0])
    found = factors_over(resolve(scene, "cpu", evaluator="direct"), frequencies)
    table = {"frequency": {"range": [100.0, 300.0]}}
    free, fixed = (
        factors_over(resolve(scene.with_tables(search={**table, **more}), "cpu", evaluator="direct"), frequencies)[
            "best"
        ]
        for more in ({"magnitude": {"range": [0.0, 2.0]}, "phase": {}}, {})
    )
    for index, frequency in enumerate(frequencies):
        grid = scene.grid.model_dump() | {"time_step": make_scheme(scene).time_step}
        solver = PlateSolver(scene.with_tables(drive={"frequency": frequency}, search={}, grid=grid), "cpu")
        response = measure_response(solver)
        tried = best_of_all_phases(response)
        assert tried - 1e-9 <= found["best"][index] <= tried + 2e-3
        assert free[index] == pytest.approx(largest_ratio(response.matrices)[0], rel=1e-9)
        assert fixed[index] == pytest.approx(found["equal"][index], rel=1e-9)
        energy = solver.run([[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).energy
        factors = energy[:, 1] / energy[:, 0]
        assert found["equal"][index] == pytest.approx(factors[0], rel=1e-9)
        assert found["single"][index] == pytest.approx(factors[1:].max(), rel=1e-9)


def test_a_search_without_any_finite_plate_says_so(write_scene, command):
    search = {"magnitude": {"range": [1e8, 1e9]}, "frequency": {"range": [100, 400]}, "particles": 3, "iterations": 2}
    effects = {"damping": {"viscous": 60.0}, "stretching": {}}
    write_scene(nodes=(11, 11), window=(0.004, 0.008), search=search, effects=effects)
    record = json.loads(command("localize", "panel.toml", *QUICK, "--json")[1])
    assert record["history"][-1]["best"] is None
    assert not record["spectrum"]
    assert record["warnings"][0].startswith("No plate that the search tried has energies")
