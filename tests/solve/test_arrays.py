"""Drives and energies in arrays of the device: the bits of a run, the caller's memory, nothing copied, plain errors."""

import gc
import weakref

import numpy as np
import pytest
import warp as wp

from support.oracle import with_all_effects
from support.scenes import scene_of
from warp_plate import PlateSolver, SceneError
from warp_plate.plate.designs import Designs, PerPlate
from warp_plate.solve.batching import import_drives

WINDOW = (0.001, 0.003)
SCENES = {
    "plain": {"nodes": (16, 13), "damping": 60.0, "precision": "float32"},
    "fourth order": {"nodes": (16, 13), "damping": 60.0, "order": 4, "load": "moments"},
    "moment form": {"nodes": (16, 13)},
    "square of the voltage": {"drive": {"frequency": 290.0, "electrostatic": {"bias": 3.0, "gain": 0.7}}},
    "unstable": {"time_step": 6e-4, "window": (0.02, 0.04)},
}


class Exported:
    """An array with nothing but the methods of DLPack, as an unknown library has it."""

    def __init__(self, array):
        self._array = array

    def __dlpack__(self, stream=None):
        return self._array.__dlpack__(stream=stream)

    def __dlpack_device__(self):
        return self._array.__dlpack_device__()


def pairs_of(drives, dtype=np.float64):
    """Return Re Z and Im Z of drives (plates, actuators) as (plates, actuators, 2)."""
    return np.stack([drives.real, drives.imag], axis=-1).astype(dtype)


def solver_of(name, device, path, **options):
    made = scene_of(**{"window": WINDOW, **SCENES[name]})
    made = with_all_effects(made) if name == "moment form" else made
    return PlateSolver(made, device, path, allow_unstable=name == "unstable", **options)


@pytest.mark.parametrize(
    ("name", "dtype"), [("plain", np.float64), ("fourth order", np.float64), ("moment form", np.float32)]
)
def test_energies_are_those_of_a_run(name, dtype, device, path, phasors):
    """Energies agree bit for bit, in batches larger than a chunk, with bad plates, and with runs in between."""
    drives = phasors(37, 3).astype(np.result_type(dtype, np.complex64))
    drives[[1, 6, 20, 36], [0, 1, 2, 0]] = [np.nan, np.inf, complex(0, -np.inf), complex(1, np.nan)]
    drives[9] = 0
    solver = solver_of(name, device, path, chunk=10)
    expected = solver.run(drives)
    given = Exported(wp.array(pairs_of(drives, dtype), device=device))
    for _ in range(2):
        energy = solver.run_on_device(given)
        assert (energy.device, energy.dtype) == (solver.device, wp.float64)
        np.testing.assert_array_equal(energy.numpy(), expected.energy)
        np.testing.assert_array_equal(solver.run(drives[:3]).energy, expected.energy[:3])
    assert set(np.flatnonzero(np.isnan(energy.numpy()).any(axis=1))) == set(expected.faults) == {1, 6, 20, 36}
    assert solver.node_steps == (37 + 2 * (37 + 3)) * solver.node_steps_per_plate


def test_drives_of_any_size(device, path):
    """Those beyond what keeps full precision have no energy, as in a run."""
    solver = solver_of("plain", device, path)
    drives = 10.0 ** np.array([-300, -131, -129, 0, 129, 131, 300])[:, None] * np.array([1, -0.5j, 0.3 + 0.1j])
    energy = solver.run_on_device(wp.array(pairs_of(drives), device=device)).numpy()
    np.testing.assert_array_equal(energy, solver.run(drives).energy)
    assert np.isfinite(energy).all(axis=1).tolist() == [False, False, True, True, True, False, False]


def test_plates_that_grow_have_no_energy(device, path, phasors):
    """Among others, and where all do, so that they are stopped before the window."""
    solver, drives = solver_of("unstable", device, path), phasors(3, 3)
    drives[1] = 0
    for some in (drives, drives[::2]):
        energy = solver.run_on_device(wp.array(pairs_of(some), device=device)).numpy()
        np.testing.assert_array_equal(energy, solver.run(some).energy)
        np.testing.assert_array_equal(np.isnan(energy).all(axis=1), some.any(axis=1))


def test_squares_of_the_voltage(device, path, phasors):
    """NumPy and the device square complex numbers in another order."""
    solver, drives = solver_of("square of the voltage", device, path), phasors(4, 3)
    energy = solver.run_on_device(wp.array(pairs_of(drives), device=device)).numpy()
    np.testing.assert_allclose(energy, solver.run(drives).energy, rtol=1e-12)


def test_energies_of_displacements_areas_and_other_plates(device, path, phasors):
    """Waves of their own of plates before are not used again."""
    options = {"areas": {"corner": (0.0, 0.1, 0.0, 0.1)}, "quantity": "displacement"}
    solver, drives = solver_of("plain", device, path, per_plate=PerPlate(frequency=True), **options), phasors(4, 3)
    expected = solver.run(drives).energy
    solver.run(Designs(drives, np.full((4, 3), 200.0)))
    energy = solver.run_on_device(wp.array(pairs_of(drives), device=device)).numpy()
    assert solver.regions == ("plate", "target", "corner")
    np.testing.assert_array_equal(energy, expected)


def test_memory_is_shared_on_the_cpu(phasors):
    """Drives are read where they lie, in any strides, and energies handed on where they are written."""
    solver, drives = solver_of("plain", "cpu", "auto"), phasors(8, 3)
    given = pairs_of(drives)
    imported = import_drives(given[::2], 3, solver.device)
    assert imported.ptr == given.ctypes.data
    given[2, 1, 0] = 7.5
    assert imported.numpy()[1, 1, 0] == 7.5
    drives = given @ [1, 1j]
    for view, same in ((given[::-2], drives[::-2]), (np.asfortranarray(given), drives), (given[:0], drives[:0])):
        np.testing.assert_array_equal(solver.run_on_device(view).numpy(), solver.run(same).energy)
    energy = solver.run_on_device(given)
    assert np.from_dlpack(energy).ctypes.data == energy.ptr
    pairs = wp.array(drives.view(float).reshape(8, 3, 2), dtype=wp.vec2d, device="cpu")
    assert solver.run_on_device(pairs).shape == (8, 2)


def test_energies_keep_their_drives_alive(phasors):
    """On CUDA a library might use the memory again before they are read."""
    given = pairs_of(phasors(2, 3))
    kept, energy = weakref.ref(given), np.from_dlpack(solver_of("plain", "cpu", "auto").run_on_device(given))
    del given
    gc.collect()
    assert kept() is not None
    del energy
    gc.collect()
    assert kept() is None


@pytest.mark.parametrize("name", ["plain", "fourth order"])
def test_nothing_is_copied_to_the_host_or_waited_for(name, device, path, phasors, monkeypatch):
    solver, given = solver_of(name, device, path), wp.array(pairs_of(phasors(5, 3)), device=device)
    expected = solver.run_on_device(given).numpy()  # makes the arrays of the device and records launches

    def refuse(*arguments, **options):
        pytest.fail("the host waits")

    with monkeypatch.context() as patch:
        for waits in ("synchronize", "synchronize_device", "synchronize_stream", "synchronize_event", "copy"):
            patch.setattr(wp, waits, refuse)
        patch.setattr(wp.array, "numpy", refuse)
        energy = solver.run_on_device(given)
    np.testing.assert_array_equal(energy.numpy(), expected)


def test_arrays_that_are_no_drives_are_refused(phasors):
    solver, given = solver_of("plain", "cpu", "auto"), pairs_of(phasors(2, 3))
    frozen = given.copy()
    frozen.flags.writeable = False
    for drives, what in (
        (given @ [1, 1j], "complex"), (given.tolist(), "DLPack"), (None, "DLPack"), (frozen, "readonly"),
        (given.astype(int), "int64"), (given.astype(np.float16), "float16"), (given[..., 0], r"shape \(2, 3\)"),
        (given[:, :2], r"shape \(2, 2, 2\)"), (given[None], "shape"), (given[..., :1], "shape"),
    ):  # fmt: skip
        with pytest.raises(
            SceneError, match=rf"^drives: .*{what}.*; write Re Z and Im Z as \(plates, 3, 2\)"
        ) as caught:
            solver.run_on_device(drives)
        assert str(caught.value).isprintable()


def test_arrays_of_another_device_are_refused(pairs, phasors):
    devices = sorted({device for device, _ in pairs})
    if len(devices) == 1:
        pytest.skip("there is no CUDA device")
    given = pairs_of(phasors(2, 3))
    for device, other in (devices, devices[::-1]):
        with pytest.raises(SceneError, match=f"^drives: on {other}, but the solver is on {device}; "):
            solver_of("plain", device, "auto").run_on_device(wp.array(given, device=other))
