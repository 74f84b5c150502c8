"""Numbers of panels from frequency responses by Navier's series, with seeded noise, in CSV and universal files."""

import json
import math
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fits.campaign import ALLOWED, INSEPARABLE, measured, summary
from scipy.io import wavfile

from support.commands import error_of, output_of
from support.scenes import MATERIAL, refused, scene_of
from warp_plate import SceneError, fit
from warp_plate.fitting.fit import fit_responses
from warp_plate.fitting.measured_modes import read_modes
from warp_plate.fitting.measured_responses import MeasuredResponses, read_responses
from warp_plate.result.frequency_response import write_csv
from warp_plate.studies.frequency_response import frf

SIZE, ETA, HIT = (0.23, 0.17), 0.02, (0.05, 0.06)
MODULUS, SURFACE_DENSITY = MATERIAL["young_modulus"], MATERIAL["density"] * MATERIAL["thickness"]
RIGIDITY = MODULUS * MATERIAL["thickness"] ** 3 / 12 / (1 - MATERIAL["poisson_ratio"] ** 2)
POINTS = (0.1, 0.05), (0.17, 0.12), (0.03, 0.13)
MODULI = {"plate.young_modulus": (0.7 * MODULUS, 1.4 * MODULUS)}
# Stepped panels: one with a loss factor, and one with springs and viscous damping.
PANELS = 16, 17
FREE = {**MODULI, "effects.loss_factor.eta": (0.002, 0.2)}


def wrong_panel(rows=None, free=FREE, density=0.5, **fit):
    """Return a panel whose own modulus and loss factor are wrong."""
    return scene_of(
        size=SIZE,
        edges=("supported",) * 4,
        effects={"loss_factor": {"eta": 0.05}},
        fit={"starts": 1, **fit, "free": free},
        measurement=rows or [{"force_at": HIT, "point": point} for point in POINTS],
    ).with_tables(plate={"size": SIZE, **MATERIAL, "young_modulus": 0.85 * MODULUS}, grid={"modal_density": density})


def navier(frequencies, points=POINTS, waves=80, decay=0.0):
    """Return (points, n) accelerances of a point force at iω + decay [1/s]."""
    numbers = np.arange(1, waves + 1) * math.pi
    along = [numbers / side for side in SIZE]

    def shapes(point):
        return np.outer(*(np.sin(k * place) for k, place in zip(along, point, strict=True)))

    stiffness = RIGIDITY * (1 + 1j * ETA) * (along[0][:, None] ** 2 + along[1] ** 2) ** 2
    omega = 2 * math.pi * frequencies - 1j * decay
    motion = 4 / math.prod(SIZE) * shapes(HIT) / (stiffness - SURFACE_DENSITY * omega[:, None, None] ** 2)
    return np.array([-(omega**2) * (motion * shapes(point)).sum(axis=(1, 2)) for point in points])


def noisy(random, noise=0.01, frequencies=None):
    """Return responses with complex noise relative to each."""
    frequencies = np.linspace(6, 80, 75) if frequencies is None else frequencies
    exact = navier(frequencies)
    errors = (random.normal(size=exact.shape) + 1j * random.normal(size=exact.shape)) * noise / math.sqrt(2)
    return MeasuredResponses("data.csv", frequencies, exact * (1 + errors))


def test_command(command, write_scene, random):
    write_scene(wrong_panel(free=MODULI).replace("effects.loss_factor.eta", ETA))
    data = noisy(random)
    data.responses[1, 30] *= -20
    parts = np.stack([data.responses.real, data.responses.imag], axis=1).reshape(6, -1)
    np.savetxt("data.csv", np.column_stack([data.frequencies, *parts]), delimiter=",", header="f")
    record = json.loads(output_of(command("fit", "panel.toml", "--data", "data.csv", "--no-pictures", "--json")))
    fitted = {key: row["value"] for key, row in record["parameters"].items()}
    assert fitted["plate.young_modulus"] == pytest.approx(MODULUS, rel=5e-3)
    assert max(record["rms_decibels"][::2]) < 0.3 < record["rms_decibels"][1]
    Path("data.csv").write_text("f,re,im\n10,1,2\n20,1,2\n", encoding="utf-8")
    message = "data.csv: has 1 responses; the scene has 3 tables [[measurement]]"
    assert message in error_of(command("fit", "panel.toml", "--data", "data.csv"))


FAULTS = {
    "none": lambda values, omega: values,
    "sign": lambda values, omega: -values,
    "gravity": lambda values, omega: values / 9.80665,
    "quantity": lambda values, omega: values / omega,
    "phase": lambda values, omega: values.conj(),
    "order": lambda values, omega: values[[1, 0, 2]],
    "sign of a sensor": lambda values, omega: values * np.array([[1], [-1], [1]]),
}
QUICK = "none", "order"


@pytest.mark.parametrize(
    "fault", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FAULTS]
)
def test_verdict(fault, random):
    """The likely cause is named, and there are no intervals; white noise is no reason, even if it is large."""
    data = noisy(random, 0.3 if fault == "none" else 0.01, np.linspace(6, 80, 70))
    changed = FAULTS[fault](data.responses, 2j * np.pi * data.frequencies)
    found = fit_responses(wrong_panel(), replace(data, responses=changed))
    assert found.verdict.describes == np.isfinite(found.low).all() == (fault == "none")
    assert found.verdict.cause == (None if fault == "none" else fault)
    assert found.warnings[:1] == found.verdict.lines
    assert ("Likely cause: " in found.verdict.text) == (fault != "none")


def test_an_exponential_window_is_named_and_its_damping_taken_out(tmp_path, random):
    """The damping of the window is 3 to 0.3 times that of the panel."""
    frequencies = np.linspace(6, 80, 80)
    data = navier(frequencies, decay=2.5) * (1 + 0.01 * random.normal(size=(3, 80)))
    found = fit_responses(wrong_panel(), MeasuredResponses("data.csv", frequencies, data))
    assert (found.verdict.describes, found.verdict.cause) == (False, "exponential window")
    assert "write fit.exponential = 0.4, or if there is none, free effects.damping.viscous" in found.verdict.text
    assert np.isnan(found.low).all()
    parts = np.stack([data.real, data.imag], axis=1).reshape(6, -1)
    np.savetxt(tmp_path / "data.csv", np.column_stack([frequencies, *parts]), delimiter=",", header="f")
    again = fit(wrong_panel(exponential=0.4), tmp_path / "data.csv")
    assert again.verdict.cause is None
    assert again.values == pytest.approx((MODULUS, ETA), rel=0.01)


@pytest.mark.slow
def test_the_channel_of_the_force_is_named(random):
    """Of three sensors the first stands for the force, which is in the third of four channels."""
    data = noisy(random, frequencies=np.linspace(6, 80, 100))
    first, second, third = data.responses
    wrong = replace(data, responses=np.array([second, np.ones(100), third]) / first)
    verdict = fit_responses(wrong_panel(signals={"segment": 10.0}), wrong).verdict
    assert (verdict.describes, verdict.cause) == (False, "channels")
    assert verdict.text.endswith("write fit.signals.force_channel = 3.")


@pytest.mark.parametrize(("part", "bits"), [(0.6, None), (0.75, 16), (1.0, None), (1.0, 16), (1.0, 6)])
def test_clipped_records_are_named(part, bits, tmp_path, random):
    """A sensor is clipped at a part of its largest value, in numbers of so many bits."""
    force, decay = random.normal(size=20_000), np.exp(-0.02 * np.arange(300)) * np.sin(0.9 * np.arange(300))
    motion = np.convolve(force, decay)[: force.size]
    motion = motion.clip(*(part * np.abs(motion).max() * np.array([-1, 1]))) / np.abs(motion).max()
    signals = np.stack([motion, force / np.abs(force).max()], axis=1)
    if bits:
        signals = np.round(signals * 2.0 ** (bits - 1)) / 2.0 ** (bits - 1)
    wavfile.write(tmp_path / "a.wav", 200, signals.astype(np.float32))
    signals = {"segment": 5.0, "force_channel": 2}
    scene = wrong_panel([{"force_at": HIT, "point": POINTS[0]}], range=(6.0, 80.0), signals=signals)
    data = read_responses(tmp_path / "a.wav", 1, scene.fit)
    assert data.clipped == (("a.wav, channel 1",) if part < 1 else ())
    if part == 0.6:
        verdict = fit_responses(scene, data).verdict
        assert (verdict.describes, verdict.cause) == (False, "clipped")
        assert verdict.text.startswith("a.wav, channel 1: clipped by an overload, so that no interval holds")


@pytest.mark.slow
@pytest.mark.parametrize("move", [lambda x, y: (SIZE[0] - x, y), lambda x, y: (x, SIZE[1] - y)], ids=["x", "y"])
def test_mirrored_points_are_named(move, random, request):
    edges = {"left": "clamped", "bottom": "free", "right": "free", "top": "supported"}
    scene = wrong_panel().with_tables(edges=edges)
    exact = frf(scene.replace("plate.young_modulus", MODULUS), [HIT], POINTS, (3.0, 80.0), "accelerance")
    some = np.linspace(0, len(exact.frequencies) - 1, 100).astype(int)
    data = MeasuredResponses("a.csv", exact.frequencies[some], exact.responses[:, some])
    rows = [{"force_at": move(*HIT), "point": move(*point)} for point in POINTS]
    verdict = fit_responses(scene.with_tables(measurement=rows), data).verdict
    assert (verdict.describes, verdict.cause) == (False, f"mirrored in {request.node.callspec.id}")


@pytest.mark.slow
def test_intervals_hold_from_far_starts(random):
    """Intervals of 12 sets of noise; the sensors whose gains are known tell modulus and density apart."""
    free = {**FREE, "plate.density": (700.0, 1400.0), "measurement[0].gain": (0.5, 2.0)}
    scene, truth, held = wrong_panel(free=free, starts=8), (MODULUS, ETA, MATERIAL["density"], 1.3), []
    for _ in range(12):
        data = noisy(random)
        data.responses[0] *= 1.3
        found = fit_responses(scene, data)
        assert found.inseparable == ()
        assert found.values == pytest.approx(truth, rel=0.01)
        held += [low < value < high for low, value, high in zip(found.low, truth, found.high, strict=True)]
    assert sum(held) >= 41


@pytest.mark.slow
def test_coarse_plates_leave_no_error():
    """Springs without losses couple the modes; of coarse plates alone, the loss factor is wrong by 3e-5."""
    edge = {"translation": 1e5, "rotation": 0.05}
    free = {**FREE, "edges.left.rotation": (0.005, 0.5)}
    scene = wrong_panel(density=1.0).with_tables(edges=dict.fromkeys(("left", "bottom", "right", "top"), edge))
    truth = scene.replace("plate.young_modulus", MODULUS).replace("effects.loss_factor.eta", ETA)
    exact = frf(truth, [HIT], POINTS, (5.0, 80.0), "accelerance")
    kept = np.linspace(0, len(exact.frequencies) - 1, 60).astype(int)
    data = MeasuredResponses("data.csv", exact.frequencies[kept], exact.responses[:, kept])
    found = fit_responses(scene.with_tables(fit={"starts": 1, "free": free}), data)
    assert found.values[:2] == pytest.approx((MODULUS, ETA), rel=5e-6)
    assert found.values[2] == pytest.approx(0.05, rel=1e-4)


def test_tables_of_frf(tmp_path):
    """They are read to the digits written."""
    exact = frf(wrong_panel(), [HIT], POINTS[:2], (5.0, 40.0), "accelerance")
    write_csv(exact, tmp_path / "data.csv")
    found = read_responses(tmp_path / "data.csv", 2)
    np.testing.assert_allclose(found.frequencies, exact.frequencies, rtol=1e-8)
    np.testing.assert_allclose(found.responses, exact.responses, rtol=1e-8)


def test_universal_files_of_responses(tmp_path):
    """A response for each dataset 58 of function type 4, and a coherence for each of type 6."""
    pyuff = pytest.importorskip("pyuff")
    common = {"binary": 0, "rsp_node": 1, "rsp_dir": 3, "ref_node": 2, "ref_dir": 3, "abscissa_spacing": 0}
    common |= {"abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13}
    x, data = np.array([5.0, 6.0, 7.5]), np.array([1 + 2j, 3 - 1j, 0.5j])
    sets = [pyuff.prepare_58(func_type=4, x=x, data=data * factor, **common) for factor in (1, 2j)]
    sets += [pyuff.prepare_58(func_type=6, x=x, data=np.array([0.9, 1.0, shared]), **common) for shared in (0.5, 0.6)]
    pyuff.UFF(str(tmp_path / "data.uff")).write_sets(sets, mode="overwrite")
    found = read_responses(tmp_path / "data.uff", 2)
    np.testing.assert_array_equal(found.frequencies, x)
    np.testing.assert_array_equal(found.responses, [data, 2j * data])
    np.testing.assert_array_equal(found.coherence, [[0.9, 1.0, 0.5], [0.9, 1.0, 0.6]])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"point": (0.1, 0.1)}, "measurement[0].actuator: write an actuator's name, or force_at = [x, y]"),
        ({"actuator": "0", "point": (0.1, 0.3)}, "measurement[0].point: [0.1, 0.3] is off the plate"),
        ({"actuator": "x", "point": (0.1, 0.1)}, "measurement[0].actuator: 'x' is not one of 0, 1, 2"),
        ({"force_at": (1, 0), "point": (0, 0)}, "measurement[0].force_at: [1.0, 0.0] is off the plate"),
    ],
)
def test_bad_tables(row, message):
    assert message in refused(wrong_panel().with_tables, measurement=[row])


def test_a_panel_without_damping_is_refused(random):
    with pytest.raises(SceneError, match="effects: responses of a panel without damping"):
        fit_responses(wrong_panel(free={"plate.density": (700.0, 1400.0)}).with_tables(effects={}), noisy(random))


def test_a_sensor_on_a_held_edge_is_refused(random):
    rows = [{"force_at": HIT, "point": point} for point in (POINTS[0], (0.0, 0.1), POINTS[2])]
    with pytest.raises(SceneError, match=r"measurement\[1\]: an edge holds the panel"):
        fit_responses(wrong_panel(rows), noisy(random))


@pytest.mark.parametrize("read", [read_modes, partial(read_responses, count=1)])
@pytest.mark.parametrize("name", ["pipe.csv", "missing.csv", "."])
def test_what_is_no_file_is_refused(read, name, tmp_path):
    """A pipe would be waited for, a device read without end."""
    os.mkfifo(tmp_path / "pipe.csv")
    words = "no such file" if name == "missing.csv" else "is a folder, a pipe or a device; data are read from files"
    with pytest.raises(SceneError, match=words):
        read(tmp_path / name)


@pytest.mark.slow
def test_fits_of_stepped_panels():
    """Responses by time stepping, of random panels; ``benchmarks/fits`` has many more."""
    rows = [measured(number) for number in PANELS]
    found = summary(rows)
    assert found["said_inseparable"] == len(rows)
    assert found["rigidity_within"] == len(rows)
    for kind in ("modulus", "damping", "springs"):
        assert found[kind]["within"] == found[kind]["determined"] == found[kind]["numbers"]
    for row in rows:
        assert not row["inseparable"]
        assert max(abs(row["numbers"][key]["value"] / row["numbers"][key]["truth"] - 1) / limit
                   for key, limit in ALLOWED.items() if key in row["numbers"]) < 0.1  # fmt: skip
        assert set(INSEPARABLE) == {key for group in row["told_apart"] for key in group}
