"""Small searches for each kind of number, from the scene to the files: what is found is what was judged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import scene_of
from test_resume import assert_same, stop_after, stopped  # noqa: F401 (a fixture)

from warp_plate import PlateSolver, Scene, SceneError, load_result, localize, resume
from warp_plate.analysis.motion import motions
from warp_plate.cli.main import main
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scheme import make_scheme
from warp_plate.result import save_result
from warp_plate.result.export.drive_signals import make_drive_signal
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.model import Grid
from warp_plate.solve.response import largest_ratio, measure_response
from warp_plate.studies.simulate import simulate
from warp_plate.studies.spectrum import factors_over, resonances

BURST = {"frequency": 290.0, "burst": {"duration": 0.004, "ramp": 0.001}}
SEARCHES = {
    "magnitude": {"magnitude": {"range": [0.0, 2.0]}, "phase": {}, "limits": {"power": 2.0}},
    "phase": {"phase": {}},
    "frequency": {"phase": {}, "frequency": {"range": [100.0, 400.0]}},
    "own frequencies": {"frequency": {"range": [100.0, 400.0], "own": True}},
    "position": {"phase": {}, "position": {"area": [0.0, 0.2, 0.0, 0.15]}},
    "delay": {"delay": {"range": [0.0, 0.004]}},
    "delay of one": {"delay": {"range": [0.0, 0.004], "actuators": ["1"]}},
    "own delays": {"delay": {"range": [0.0, 0.004], "own": True}},
    "all": {
        "magnitude": {"range": [0.1, 2.0]},
        "phase": {},
        "frequency": {"range": [100.0, 400.0], "own": True},
        "position": {},
        "delay": {"range": [0.0, 0.004], "own": True},
    },
}
TITLES = {"frequency": "frequency (Hz)", "position": "x (m)", "delay": "burst from (s)"}


def searched(name, particles=6, iterations=5, precision="float32", **tables):
    search = {**SEARCHES[name], "particles": particles, "iterations": iterations, "seed": 2}
    drive = {"drive": BURST} if "delay" in search else {}
    return scene_of(
        nodes=(11, 11), damping=60.0, window=(0.004, 0.008), precision=precision, search=search, **drive, **tables
    )


@pytest.mark.parametrize("name", SEARCHES)
def test_what_is_found_is_a_scene_that_gives_the_same(name, tmp_path):
    """The best of the batch, its last run, the scene of it and the file of the result agree."""
    result = localize(searched(name), device="cpu", estimate=False)
    best = result.cases["best"]
    # A plate of a batch whose plates differ and a scene of its own are stepped by other kernels.
    assert best.localization_factor == pytest.approx(result.history["best"][-1], abs=2e-5)
    assert np.all(np.diff(result.history["best"]) >= 0)
    again = simulate(result.driven_scene(best), device="cpu", estimate=False).cases["drive"]
    assert np.float32(again.localization_factor) == np.float32(best.localization_factor)
    np.testing.assert_array_equal(again.displacement, best.displacement)
    loaded = load_result(save_result(result, tmp_path / "one.h5"))
    assert loaded.cases["best"].per_actuator.keys() == best.per_actuator.keys()
    for heading, values in best.per_actuator.items():
        np.testing.assert_array_equal(loaded.cases["best"].per_actuator[heading], values)
    assert loaded.case_scene(loaded.cases["best"]) == result.case_scene(best)
    assert not loaded.cases["equal"].per_actuator
    assert {heading for kind, heading in TITLES.items() if kind in SEARCHES[name]} <= best.per_actuator.keys()
    assert (result.bound is not None) == (name in ("magnitude", "phase"))


@pytest.mark.parametrize("name", ["frequency", "all"])
def test_a_search_that_was_stopped_finds_the_same(name, stopped):  # noqa: F811
    made = searched(name)
    whole = localize(made, "mine", "cpu", estimate=False, spectrum=False)
    checkpoint = stopped(made, "cpu", on_progress=stop_after(3))
    after = resume(checkpoint, estimate=False, spectrum=False)
    assert_same(after, whole)
    for heading, values in whole.cases["best"].per_actuator.items():
        np.testing.assert_array_equal(after.cases["best"].per_actuator[heading], values)


def test_a_stopped_search_of_another_scene_is_refused(stopped):  # noqa: F811
    checkpoint = stopped(searched("frequency"), "cpu", on_progress=stop_after(2))
    other = checkpoint.scene.with_tables(search={**SEARCHES["phase"], "particles": 6, "iterations": 5})
    with pytest.raises(SceneError, match="checkpoint: "):
        resume(replace(checkpoint, scene=other), estimate=False)


@pytest.mark.parametrize("method", ["ring", "constriction", "gradient"])
def test_other_methods_stop_and_go_on(method, stopped):  # noqa: F811
    made = searched("phase")
    made = made.with_tables(search={**made.search.model_dump(), "method": method})
    whole = localize(made, "mine", "cpu", estimate=False)
    assert_same(resume(stopped(made, "cpu", on_progress=stop_after(2)), estimate=False), whole)


def test_other_objectives_are_followed_and_their_history_says_so():
    """Of RMS velocity with all magnitudes bounded the history holds the weighted sum; no bound of LF is claimed."""
    made = searched("magnitude")
    objectives = [{"kind": "velocity", "weight": 1e3}, {"kind": "displacement", "weight": 1e5}]
    made = made.with_tables(search={**made.search.model_dump(), "objectives": objectives})
    direct = localize(made, device="cpu", estimate=False)
    by_matrices = localize(made, device="cpu", estimate=False, evaluator="response")
    assert direct.bound is None
    assert not direct.only_localization
    np.testing.assert_allclose(direct.history["best"], by_matrices.history["best"], rtol=1e-3)
    assert direct.history["best"][0] > 0


@pytest.mark.parametrize("name", ["frequency", "own frequencies"])
def test_a_grid_chosen_for_an_accuracy_carries_every_frequency(name):
    """The grid is chosen where the range ends; the scene keeps its own frequency, and nothing else of the grid."""
    made = searched(name)
    result = localize(made.model_copy(update={"grid": Grid(accuracy=0.3)}), device="cpu", estimate=False)
    assert result.accuracy["asked"] == 0.3
    assert result.scene.drive.frequency == made.drive.frequency
    assert result.scene.grid.time_step <= 1 / 20 / made.search.frequency.range[1]
    assert np.isfinite(result.cases["best"].localization_factor)


@pytest.fixture
def panel(tmp_path, monkeypatch):
    """A search for a frequency and places in a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    made = searched("frequency").with_tables(title="panel")
    search = made.search.model_dump() | {"position": {}, "method": "constriction", "inertia": 0.3}
    made = made.with_tables(search=search)
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


def run(capsys, *arguments):
    main([*map(str, arguments), "--device", "cpu", "--no-estimate", "--json"])
    return json.loads(capsys.readouterr().out)


def test_the_command_writes_the_scene_that_it_found(panel, capsys):
    told = run(capsys, "localize", "panel.toml", "--no-pictures")
    assert told["files"] == ["panel-localize.h5", "panel-localize.best.toml"]
    assert {"frequency", "centre", "magnitude", "phase"} <= told["drive"][0].keys()
    assert len(told["spectrum"]["frequency"]) >= 61
    again = run(capsys, "simulate", "panel-localize.best.toml", "--no-pictures")
    in_vain = "search.inertia = 0.3: method = 'constriction' does not read it, only 'pso'; delete it"
    assert [line for line in told["warnings"] if line.startswith(in_vain)]
    assert "search" not in "".join(again["warnings"])
    assert np.float32(again["localization_factor"]) == np.float32(told["localization_factor"]["best"])
    found = Scene.load("panel-localize.best.toml")
    assert found.drive.frequency == told["drive"][0]["frequency"]
    x0, x1, y0, y1 = found.actuators[0].area
    np.testing.assert_allclose([(x0 + x1) / 2, (y0 + y1) / 2], told["drive"][0]["centre"], rtol=1e-14)


def test_the_table_shows_frequency_and_place(panel, capsys):
    main(["localize", "panel.toml", "--device", "cpu", "--no-estimate", "--no-pictures", "--no-spectrum"])
    out = capsys.readouterr().out
    assert "frequency" in out
    assert "x (m)" in out
    result = load_result("panel-localize.h5")
    assert f"{result.cases['best'].frequency[0]:.5g}" in out
    assert not result.spectrum


def test_a_scene_that_does_not_fit_is_named_before_anything_runs(panel, capsys):
    text, table = Path("panel.toml").read_text(encoding="utf-8"), "[search.position]"
    Path("panel.toml").write_text(text.replace(table, f'{table}\nactuators = ["x"]'), encoding="utf-8")
    with pytest.raises(SystemExit) as gone:
        main(["localize", "panel.toml", "--device", "cpu"])
    assert gone.value.code == 2
    assert "panel.toml: search.position.actuators[0] = 'x'" in capsys.readouterr().err
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


def test_motions_and_signals_have_the_cases_own_frequency_and_places(panel):
    result = localize(panel, device="cpu", estimate=False, spectrum=False)
    best = result.cases["best"]
    equal, found = motions(result.scene, {name: result.cases[name] for name in ("equal", "best")}, device="cpu")
    assert equal.frequency == 290
    assert equal.scene is None
    assert found.frequency == best.frequency[0]
    assert found.scene.actuators[0].area != result.scene.actuators[0].area
    assert found.span == equal.span
    assert found.span[1] - found.span[0] == pytest.approx(1 / min(290, best.frequency[0]))
    # A step of this motion is one of the scene that was found.
    alone = PlateSolver(result.driven_scene(best), "cpu")
    moment = float(found.times[3])
    field = alone.run(best.phasors[None], (moment,)).displacement[0, 0]
    np.testing.assert_array_equal(found.displacement[3], field.astype(np.float32))
    signal = make_drive_signal(result.case_scene(best), best, 48000, 1.0)
    assert signal.frequency == best.frequency[0]
    pytest.importorskip("pyvista")
    from warp_plate.viz.page import page_data

    page = page_data(result.scene, [equal, found], "displacement", 30.0, None)
    assert page["plates"][0]["outlines"] is None
    own = page["plates"][1]["outlines"]
    assert len(own) == len(page["outlines"])
    moved = [one != other for one, other in zip(own, page["outlines"], strict=True)]
    assert any(moved)  # the actuators'
    assert not all(moved)


def test_several_frequencies_are_no_file_to_play():
    result = localize(searched("own frequencies"), device="cpu", estimate=False)
    best = result.cases["best"]
    with pytest.raises(SceneError, match=r"actuators\[\d\].frequency: only tones"):
        make_drive_signal(result.case_scene(best), best, 48000, 1.0)


def of_all_phases(response):
    """The largest localization factor of three actuators alike but for their phases, by trying many."""
    turns = np.exp(1j * np.arange(0, 2 * np.pi, np.pi / 90))
    second, third = (one.ravel() for one in np.meshgrid(turns, turns))
    energy = response.energy(np.stack([np.ones_like(second), second, third], axis=1))
    return (energy[:, 1] / energy[:, 0]).max()


def test_the_spectrum_is_that_of_each_frequency_alone():
    """Equal drive, best single actuator and what no drive passes that may be chosen at a frequency: whatever it is, by
    Gram matrices of a scene of its own; one of equal magnitudes, by trying; and the scene's own."""
    made = searched("frequency", precision="float64")
    frequencies = np.array([150.0, 290.0, 360.0])
    found = factors_over(made, frequencies, device="cpu")
    free = {"frequency": {"range": [100.0, 400.0]}}
    whatever, own = (
        factors_over(made.with_tables(search={**free, **tables}), frequencies, device="cpu")["best"]
        for tables in ({"magnitude": {"range": [0.0, 2.0]}, "phase": {}}, {})
    )
    for index, frequency in enumerate(frequencies):
        grid = made.grid.model_dump() | {"time_step": make_scheme(made).time_step}
        alone = made.with_tables(drive={"frequency": frequency}, search={}, grid=grid)
        solver = PlateSolver(alone, "cpu")
        response = measure_response(solver)
        tried = of_all_phases(response)
        assert tried - 1e-9 <= found["best"][index] <= tried + 2e-3
        held = np.delete(np.delete(response.matrices, 3, axis=1), 3, axis=2)  # the first one's phase is 0
        assert whatever[index] == pytest.approx(largest_ratio(held)[0], rel=1e-9)
        assert own[index] == pytest.approx(found["equal"][index], rel=1e-9)
        energy = solver.run([[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).energy
        factors = energy[:, 1] / energy[:, 0]
        assert found["equal"][index] == pytest.approx(factors[0], rel=1e-9)
        assert found["single"][index] == pytest.approx(factors[1:].max(), rel=1e-9)


def test_resonances_are_the_natural_frequencies_in_the_range():
    made = searched("frequency")
    every = natural_modes(made, 60).frequencies
    low, high = every[2] - 1, every[40] + 1e-6
    np.testing.assert_allclose(resonances(made, low, high), every[(every >= low) & (every <= high)], rtol=1e-9)


def test_the_spectrum_of_a_search_covers_its_range_and_bounds_what_it_finds(tmp_path):
    result = localize(searched("frequency"), device="cpu", estimate=False)
    spectrum, best = result.spectrum, result.cases["best"]
    assert spectrum["frequency"][[0, -1]].tolist() == [100, 400]
    assert np.all(spectrum["best"] >= spectrum["equal"] - 1e-9)
    assert best.localization_factor <= np.interp(best.frequency[0], spectrum["frequency"], spectrum["best"]) + 0.02
    loaded = load_result(save_result(result, tmp_path / "one.h5"))
    for name, values in spectrum.items():
        np.testing.assert_array_equal(loaded.spectrum[name], values)


def test_no_spectrum_where_drives_do_not_superpose_or_frequencies_are_several():
    made = searched("frequency", effects={"damping": {"viscous": 60.0}, "stretching": {}})
    assert localize(made, device="cpu", estimate=False).spectrum == {}
    assert localize(searched("own frequencies"), device="cpu", estimate=False).spectrum == {}


def test_the_spectrum_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    from warp_plate.viz.plots.spectrum import draw_spectrum

    result = localize(searched("frequency"), device="cpu", estimate=False)
    drawn = draw_spectrum(result, tmp_path / "spectrum.svg").read_text(encoding="utf-8")
    assert drawn.startswith("<?xml")
    with pytest.raises(ValueError, match="holds no spectrum"):
        draw_spectrum(replace(result, spectrum={}), tmp_path / "none.svg")
    assert not (tmp_path / "none.svg").exists()


def test_a_search_that_found_nothing_says_so(tmp_path, monkeypatch, capsys):
    """Drives beyond all bounds on a plate that stretches: no plate has energies, which is no find of the search."""
    monkeypatch.chdir(tmp_path)
    search = {"magnitude": {"range": [1e8, 1e9]}, "particles": 3, "iterations": 2}
    effects = {"damping": {"viscous": 60.0}, "stretching": {}}
    made = scene_of(nodes=(11, 11), window=(0.004, 0.008), search=search, effects=effects)
    Path("lost.toml").write_text(dump_scene(made), encoding="utf-8")
    told = run(capsys, "localize", "lost.toml", "--no-pictures")
    assert told["history"][-1]["best"] is None
    assert told["warnings"][0].startswith("No plate that the search tried has energies")
