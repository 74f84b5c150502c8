"""Impulse responses: against Navier's series and against time stepping under a force that they are convolved with."""

import math

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate import PlateSolver, SceneError
from warp_plate.reference.series import supported_plate
from warp_plate.studies.frequency_response import compute_impulse_response

SUPPORTED = ("supported",) * 4


@pytest.mark.parametrize("quantity", ["receptance", "mobility"])
def test_point_to_point_is_the_sum_of_sine_modes(quantity):
    """Modes up to 300 Hz of 4 sin sin / (ρH·area), each exp(−γt) sin(Ωt) / Ω or its derivative."""
    scene, source, point = scene_of(edges=SUPPORTED, damping=20.0), (0.03, 0.07), (0.13, 0.11)
    found = compute_impulse_response(scene, [source], [point], 0.03, 8000, 300.0, quantity)
    plate, orders = supported_plate(scene), np.arange(1, 12) * math.pi
    width, height = plate.size
    squared = (orders / width) ** 2 + (orders[:, None] / height) ** 2
    natural = math.sqrt(plate.rigidity / plate.surface_density) * squared
    sizes = [
        np.sin(orders * x / width) * np.sin(orders[:, None] * y / height) for x, y in (source, point)
    ]  # fmt: skip
    sizes = 4 / (plate.surface_density * width * height) * sizes[0] * sizes[1]
    decay, kept = plate.viscous / plate.surface_density / 2, natural < 2 * math.pi * 300
    turn, times = np.sqrt(natural[kept] ** 2 - decay**2)[:, None], found.times
    motion = np.sin(turn * times) / turn
    if quantity == "mobility":
        motion = np.cos(turn * times) - decay * motion
    expected = np.exp(-decay * times) * (sizes[kept] @ motion)
    assert found.modes == kept.sum()
    np.testing.assert_allclose(found.responses[0, 0], expected, rtol=0, atol=2e-4 * np.abs(expected).max())


@pytest.mark.slow
def test_convolved_with_a_force_it_is_what_stepping_gives(tmp_path):
    """A burst of 250 Hz on one actuator agrees to 1 % with 81 nodes a side, of fourth order."""
    rate = 16000
    times = np.arange(160) / rate
    force = np.hanning(160) * np.sin(2 * math.pi * 250 * times)
    np.savetxt(tmp_path / "force.csv", force)
    signal = {"frequency": 400.0, "signal": {"file": "force.csv", "rate": float(rate)}}
    grid = {"nodes": (81, 81), "order": 4, "load": "moments", "precision": "float64"}
    scene = scene_of(damping=88.0, window=(0.0, 0.02)).with_tables(drive=signal, grid=grid).in_folder(tmp_path)
    points, phasors = [(0.05, 0.1), (0.15, 0.06)], np.eye(len(scene.actuators))[:1]
    run = PlateSolver(scene, "cpu").run(phasors, points=points)
    actuator = scene.actuators[0]
    found = compute_impulse_response(scene, [actuator.name], points, 0.02, rate, 4000.0, "receptance")
    x0, x1, y0, y1 = actuator.area
    for response, stepped in zip(found.responses[0], run.trace[0], strict=True):
        moved = np.convolve(response, force)[: found.times.size] / rate * (x1 - x0) * (y1 - y0)
        wanted = np.interp(run.trace_times, found.times, moved)
        inside = run.trace_times < found.times[-1]
        assert np.abs(stepped - wanted)[inside].max() < 0.01 * np.abs(wanted).max()


@pytest.mark.parametrize(
    ("options", "tables", "words"),
    [
        ({"quantity": "accelerance"}, {}, "quantity accelerance"),
        ({"duration": 0.0}, {}, "impulse 0 s"),
        ({"duration": 1e6}, {}, r"impulse 1e\+06 s"),
        ({"highest": 1.0}, {}, "has no mode up to it"),
        ({}, {"effects": {"loss_factor": {"eta": 0.1}}}, r"effects\.loss_factor"),
    ],
)
def test_what_has_no_impulse_response_is_refused(options, tables, words):
    with pytest.raises(SceneError, match=words):
        compute_impulse_response(scene_of().with_tables(**tables), **options)
