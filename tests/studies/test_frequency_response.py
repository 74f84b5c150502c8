"""Frequency responses: against Navier's series, reciprocity, derivatives, peaks however sharp, and their files."""

import csv
import math

import numpy as np
import pytest
import scipy
from numpy.polynomial import legendre

from support.series import patch_pressures, supported_plate
from warp_plate.modal.modes import solve_modes
from warp_plate.plate import memory
from warp_plate.plate.designs import scene_phasors
from warp_plate.result.frequency_response import write_csv, write_hdf5
from warp_plate.scene.errors import SceneError
from warp_plate.studies.frequency_response import default_range, frf

SUPPORTED = ("supported",) * 4
POINTS = [(0.05, 0.07), (0.13, 0.11)]
OSCILLATOR = {"area": (0.12, 0.15, 0.05, 0.08), "mass": 0.002, "stiffness": 400.0, "damping": 1.0}
COUPLED = {"damping": {"viscous": 0.01}, "oscillators": [{**OSCILLATOR, "damping": 50.0}]}
MIXED = {
    "edges": ("supported", "supported", "supported", {"translation": 2000.0, "rotation": 0.2}),
    "effects": {"damping": {"viscous": 3.0}, "foundation": {"stiffness": 500.0}, "oscillators": [OSCILLATOR]},
}


@pytest.fixture
def driven_panel(scene):
    """A damped supported panel with unequal phasors."""
    made = scene(size=(0.2, 0.16), edges=SUPPORTED, damping=20.0, modal_density=1.0)
    rows = zip(made.actuators, (1.0, 0.4, 2.0), (0.0, 1.0, -2.0), strict=True)
    return made.with_tables(actuators=[{**row.model_dump(), "magnitude": w, "phase": p} for row, w, p in rows])


def modal_sums(scene, frequencies, pressures):
    """Return (frequencies, terms, terms) amplitudes Q = Z / (D k⁴ − ρHω² + icω) of the sine modes, n by row."""
    plate, orders = supported_plate(scene), np.arange(1, pressures.shape[1] + 1) * math.pi
    squared = (orders / plate.size[0]) ** 2 + (orders[:, None] / plate.size[1]) ** 2
    omega = 2 * math.pi * np.asarray(frequencies)[:, None, None]
    dynamic = plate.rigidity * squared**2 - plate.surface_density * omega**2 + 1j * plate.viscous * omega
    return pressures / dynamic


def at(scene, amplitudes, point):
    """Return the sums of (…, terms, terms) amplitudes of the sine modes at a point."""
    terms = np.arange(1, amplitudes.shape[-1] + 1) * math.pi
    along, across = (np.sin(terms * place / side) for place, side in zip(point, scene.plate.size, strict=True))
    return across @ amplitudes @ along


def unit_pressures(scene, actuator, terms):
    """Return the modal pressures of 1 N/m² on an actuator."""
    return patch_pressures(scene, np.eye(len(scene.actuators))[actuator], terms)


def test_responses_beyond_the_memory_are_refused(scene, monkeypatch):
    monkeypatch.setattr(memory, "machine_memory", lambda: 2.0**28)
    assert frf(scene(damping=20.0), points=[(0.1, 0.1)]).responses.shape[0] == 3
    with pytest.raises(SceneError, match=r"^points: 60000 responses at \d+ frequencies: takes about .* GiB of memory"):
        frf(scene(damping=20.0), points=[(0.1, 0.1)] * 20_000)


def test_receptance_is_that_of_the_sine_series(driven_panel):
    """Also of a point force, whose series converges slowly, 4/ab sin sin the modal pressures."""
    found = frf(driven_panel, ["1", (0.11, 0.04)], POINTS, (20, 400), "receptance")
    assert found.inputs == ("1", "0.11,0.04")
    assert found.unit == "m/N"
    chosen = slice(None, None, 25)
    x0, x1, y0, y1 = driven_panel.actuators[1].area
    patch = unit_pressures(driven_panel, 1, 90) / ((x1 - x0) * (y1 - y0))
    (width, height), orders = driven_panel.plate.size, np.arange(1, 301) * math.pi
    point = 4 / (width * height) * np.outer(np.sin(orders * 0.04 / height), np.sin(orders * 0.11 / width))
    for index, (pressures, tolerance) in enumerate([(patch, 1e-5), (point, 1e-3)]):
        amplitudes = modal_sums(driven_panel, found.frequencies[chosen], pressures)
        exact = np.stack([at(driven_panel, amplitudes, place) for place in POINTS])
        got = found.responses[2 * index : 2 * index + 2, chosen]
        np.testing.assert_allclose(got, exact, atol=tolerance * np.abs(exact).max(), rtol=10 * tolerance)


def test_localization_bound_and_velocity_are_those_of_the_sine_series(driven_panel):
    """Sines have the mean square 1/4 over the plate; over the target, a quarter, Gauss's rule gives their products."""
    found, terms = frf(driven_panel, frequency_range=(20, 400)), 60
    chosen = slice(3, None, 40)
    omega = 2 * math.pi * found.frequencies[chosen]
    amplitudes = np.stack(
        [modal_sums(driven_panel, found.frequencies[chosen], unit_pressures(driven_panel, k, terms)) for k in range(3)]
    )
    nodes, weights = legendre.leggauss(150)
    sines = np.sin(np.outer(np.arange(1, terms + 1) * math.pi, (nodes + 1) / 4))
    overlap = (sines * weights / 4) @ sines.T  # over half a side, of a length of one
    target = np.einsum("kfnm,np,mq,lfpq->fkl", amplitudes.conj(), overlap, overlap, amplitudes, optimize=True)
    plate = np.einsum("kfnm,lfnm->fkl", amplitudes.conj(), amplitudes) / 4
    drive = scene_phasors(driven_panel)
    share, whole = (np.einsum("k,fkl,l->f", drive.conj(), gram, drive).real for gram in (target, plate))
    np.testing.assert_allclose(found.localization_factor[chosen], share / whole, rtol=1e-4)
    largest = [scipy.linalg.eigh(a, b, eigvals_only=True)[-1] for a, b in zip(target, plate, strict=True)]
    np.testing.assert_allclose(found.bound[chosen], largest, rtol=1e-4)
    assert (found.localization_factor <= found.bound + 1e-12).all()
    areas = [(x1 - x0) * (y1 - y0) for x0, x1, y0, y1 in (actuator.area for actuator in driven_panel.actuators)]
    for index, area in enumerate(areas):
        velocity = omega**2 * plate[:, index, index].real / area**2 / 2
        np.testing.assert_allclose(found.mean_square_velocity[index, chosen], velocity, rtol=1e-4)


def test_reciprocity_of_a_plate_with_coupled_modes(scene):
    """H(a → b) = H(b → a), and the responses are those of the full system, frequency by frequency."""
    made = scene(size=(0.2, 0.16), **MIXED)
    found = frf(made, POINTS, POINTS, (15, 30), "receptance")
    assert found.pairs[1] == ("0.05,0.07", POINTS[1])
    np.testing.assert_allclose(found.responses[1], found.responses[2], rtol=1e-4)
    assert (found.bound < 1).all()
    plate, chosen = solve_modes(made, 30), slice(None, None, len(found.frequencies) // 3)
    shapes = plate.at_points(POINTS)
    omega = 2 * math.pi * found.frequencies[chosen, None, None]
    stiffness = np.diag(plate.angular_frequencies**2) - omega**2 * np.eye(len(shapes))
    exact = shapes.T @ np.linalg.solve(stiffness + 1j * (omega * plate.damping + plate.hysteretic), shapes)
    np.testing.assert_allclose(found.responses[:, chosen].T, exact.reshape(-1, 4), rtol=1e-5)


def test_a_free_plate_moves_as_its_mass(scene):
    """Far below its resonances 1 N at the centre of mass M gives the velocity v = 1/ωM everywhere, and ⟨v²⟩ = v²/2;
    an oscillator's mass moves with it."""
    layer = {"area": (0.0, 0.2, 0.08, 0.16), "thickness": 3e-4, "young_modulus": 0.0, "density": 1500.0}
    oscillator = {"area": (0.08, 0.12, 0.06, 0.1), "mass": 0.004, "stiffness": 1e5}
    effects = {"layers": [layer], "oscillators": [oscillator]}
    free = scene(size=(0.2, 0.16), edges=("free",) * 4, effects=effects)
    parts = np.array([0.5 * 0.2 * 0.08, 0.95 * 0.2 * 0.08, 0.004])
    centre = (0.1, parts @ [0.04, 0.12, 0.08] / parts.sum())
    found = frf(free, [centre], [centre, (0.0, 0.0)], (0.01, 0.1))
    speed = 1 / (2 * math.pi * found.frequencies * parts.sum())
    np.testing.assert_allclose(np.abs(found.responses), [speed, speed], rtol=1e-3)
    np.testing.assert_allclose(found.mean_square_velocity[0], speed**2 / 2, rtol=1e-3)


@pytest.mark.parametrize(
    "effects",
    [
        *({"damping": {"viscous": viscous}} for viscous in (0.003, 0.3, 30.0)),
        {"loss_factor": {"eta": 0.002}},
        pytest.param(COUPLED, marks=pytest.mark.slow),
    ],
    ids=["loss 1e-5", "loss 1e-3", "loss 0.1", "hysteretic", "coupled"],
)
def test_no_peak_is_missed(scene, effects):
    """Each local maximum of a dense scan around a resonance is in the curve to 1 %, and no resonance costs more than a
    number of frequencies that grows with the logarithm of its sharpness."""
    made = scene(size=(0.2, 0.16), effects=effects)
    found = frf(made, ["0"], POINTS[:1], (20, 200), "receptance")
    plate = solve_modes(made, 200)
    force = plate.patch_forces([made.actuators[0].area])
    shape = plate.at_points(POINTS[:1])[:, 0]

    def amplitude(frequencies):
        return np.abs(shape @ plate.respond(frequencies, force)[:, :, 0].T)

    checked, curve = 0, np.abs(found.responses[0]) * amplitude(found.frequencies[:1]) / np.abs(found.responses[0, 0])
    starts = found.frequencies[1:-1][(curve[1:-1] > curve[:-2]) & (curve[1:-1] > curve[2:])]
    spread = 1 + 3 * np.maximum(found.loss_factors, 1e-6)
    ranges = [*zip(found.natural_frequencies / spread, found.natural_frequencies * spread, strict=True)]
    ranges += [(start * 0.999, start * 1.001) for start in starts]
    for low, high in ranges:
        dense = np.linspace(max(low, 20), min(high, 200), 401)
        height = amplitude(dense)
        for index in np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] > height[2:])) + 1:
            inside = (found.frequencies >= dense[0]) & (found.frequencies <= dense[-1])
            near = inside & (np.abs(found.frequencies - dense[index]) < 0.02 * dense[index])
            assert curve[near].max() >= 0.99 * height[index]
            checked += 1
    assert checked >= len(found.natural_frequencies) / 2
    assert len(found.frequencies) < 400 + 60 * (len(found.natural_frequencies) + 1)
    assert found.frequencies[[0, -1]] == pytest.approx([20, 200])


MAP = {"young_modulus": [[1.0, 0.6, 1.3], [0.7, 1.2, 0.8]]}
JUMP = {"area": (0.03, 0.11, 0.02, 0.1), "thickness": 8e-4, "young_modulus": 2e10, "density": 3000.0}


@pytest.mark.parametrize(
    "effects",
    [
        {"damping": {"viscous": 1.0}, "variation": MAP},
        pytest.param({"loss_factor": {"eta": 0.001}, "layers": [JUMP]}, marks=pytest.mark.slow),
    ],
    ids=["map", "layer"],
)
def test_errors_hold_the_curves_of_many_more_functions(scene, effects):
    """Also beside sharp resonances, whose peaks the layer shifts by more than their widths."""
    coarse = scene(size=(0.2, 0.16), effects=effects)
    made = coarse.with_tables(grid={**coarse.grid.model_dump(exclude_unset=True), "modal_density": 0.5})
    found = frf(made, ["0", "1"], POINTS, (15, 60))
    plate = solve_modes(made, 60, density=2.2)
    forces = np.stack(
        [
            plate.patch_forces([actuator.area])[:, 0] / np.prod(np.diff(np.reshape(actuator.area, (2, 2))))
            for actuator in made.actuators[:2]
        ],
        axis=1,
    )
    amplitudes = plate.respond(found.frequencies, forces)
    omega = 2 * math.pi * found.frequencies
    true = {"responses": omega * np.abs(np.moveaxis(amplitudes, 1, 2) @ plate.at_points(POINTS)).reshape(-1, 4).T}
    driven = plate.respond(found.frequencies, plate.actuator_forces() @ scene_phasors(made)[:, None])[:, :, 0]
    target, whole = (plate.kinetic_matrix(region) for region in (made.target, "plate"))
    share = [np.einsum("fm,mn,fn->f", driven.conj(), matrix, driven).real for matrix in (target, whole)]
    true["localization_factor"] = share[0] / share[1]
    for curve, values in true.items():
        least, largest = found.band(curve)
        assert least.shape == getattr(found, curve).shape
        inside = np.isfinite(least)
        assert ((least <= values) & (values <= largest))[inside].all()
        assert inside.mean() > 0.9
    assert 0 < found.errors.frequencies.max() < 0.2
    assert np.median(found.errors.localization_factor) < 0.02


def test_undamped_plates_have_finite_responses_beside_their_resonances(scene):
    found = frf(scene(), frequency_range=(20, 200))
    assert found.undamped
    assert "undamped modes" in found.warnings[0]
    for values in (found.responses, found.localization_factor, found.bound, found.mean_square_velocity):
        assert np.isfinite(values).all()
    assert not frf(scene(damping=1.0), frequency_range=(20, 200)).undamped
    distance = np.abs(found.frequencies[:, None] - found.natural_frequencies).min(axis=0) / found.natural_frequencies
    assert (distance < 1e-5).all()


def test_defaults_and_refusals(scene):
    """Points come from record.points, else from the middles of the targets; the range holds drive and modes."""
    made = scene(damping=5.0)
    assert frf(made, frequency_range=(20, 30)).pairs == [(name, (0.05, 0.05)) for name in "012"]
    recorded = frf(made.with_tables(record={"points": POINTS}), ["2"])
    assert recorded.pairs == [("2", point) for point in POINTS]
    low, high = default_range(made)
    assert recorded.frequencies[[0, -1]] == pytest.approx([low, high])
    assert low < recorded.natural_frequencies[0] < 290 < high
    slow = scene(frequency=0.1, window=(0.0, 1.0))
    assert default_range(slow)[0] == pytest.approx(0.05)
    assert (solve_modes(slow, 200).frequencies < default_range(slow)[1]).sum() == 6
    for key, tables in {
        "effects.stretching": {"effects": {"stretching": {}}},
        "effects.moving_load": {"effects": {"moving_load": {"force": 1.0, "start": (0.1, 0.1)}}},
    }.items():
        with pytest.raises(SceneError, match=f"^{key}: "):
            frf(scene(**tables))
    for wrong in ({"inputs": ["3"]}, {"inputs": [(0.3, 0.1)]}, {"points": [(0.1, -0.1)]}, {"frequency_range": (9, 9)}):
        with pytest.raises(SceneError):
            frf(made, **wrong)


@pytest.fixture
def response(scene):
    made = scene(damping=0.01, title="Panel 200 × 200").with_tables(record={"points": POINTS})
    return frf(made, ["2", (0.1, 0.05)], quantity="accelerance", frequency_range=(20, 90))


def test_csv_has_a_column_for_each_part(response, tmp_path):
    write_csv(response, path := tmp_path / "a.csv")
    with path.open(encoding="utf-8", newline="") as file:
        heading, *rows = csv.reader(file)
    values = np.array(rows, dtype=float)
    np.testing.assert_allclose(values[:, 0], response.frequencies, rtol=1e-14)
    np.testing.assert_allclose(values[:, 1:9:2] + 1j * values[:, 2:9:2], response.responses.T, rtol=1e-8)
    parts = np.column_stack([response.localization_factor, response.bound, *response.mean_square_velocity])
    np.testing.assert_allclose(values[:, 9:13], parts, rtol=1e-8)
    errors = response.errors
    parts = [errors.frequencies, *errors.responses, errors.localization_factor, errors.bound]
    np.testing.assert_allclose(values[:, 13:].T, [*parts, *errors.mean_square_velocity], rtol=1e-8)
    assert heading[14] == "error 2 → 0.05,0.07 [(m/s²)/N]"
    assert heading[0] == "frequency [Hz]"
    assert heading[3] == "Re 2 → 0.13,0.11 [(m/s²)/N]"
    assert len(heading) == values.shape[1] == 22


def test_xarray_opens_the_hdf5_file(response, tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    write_hdf5(response, tmp_path / "a.h5")
    with xarray.open_dataset(tmp_path / "a.h5", engine="h5netcdf") as data:
        assert data["real"].dims == ("pair", "frequency")
        got = (data["real"] + 1j * data["imaginary"]).sel(pair="0.1,0.05 → 0.13,0.11")
        np.testing.assert_array_equal(got, response.responses[3])
        np.testing.assert_array_equal(data.frequency, response.frequencies)
        np.testing.assert_array_equal(data.mean_square_velocity.sel(input="2"), response.mean_square_velocity[0])
        np.testing.assert_array_equal(data.bound, response.bound)
        np.testing.assert_array_equal(data.natural_frequency, response.natural_frequencies)
        np.testing.assert_array_equal(data.response_error, response.errors.responses)
        np.testing.assert_array_equal(data.mean_square_velocity_error, response.errors.mean_square_velocity)
        assert data.frequency_error.dims == data.bound_error.dims == ("frequency",)
        assert (data["real"].units, data.frequency.units) == ("(m/s^2)/N", "Hz")
