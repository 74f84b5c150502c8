"""Focused waveforms of a scene: what they reach, against time stepping, and what is refused."""

import math

import numpy as np
import pytest
import scipy

from support.coils import LOSSLESS_COILS, first_order_system, panel
from support.scenes import scene_of
from warp_plate import PlateSolver, SceneError, export, focus
from warp_plate.focusing.figures import focus_motions, measure_focus
from warp_plate.focusing.responses import HeldResponses
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.other_solutions import modes_below
from warp_plate.result.focus import load_focus, save_focus
from warp_plate.scene.target import Target

TABLE = {"points": [(0.07, 0.06), (0.13, 0.12)], "highest": 600.0, "time": 0.02, "rate": 16000}
OVERSAMPLED = 8


@pytest.fixture(scope="module")
def focused():
    return focus(scene_of(damping=20.0, focus={**TABLE, "energy": 0.02, "peak": 0.8}))


def test_the_optimum_is_best_and_says_what_limits_it(focused):
    optimum = focused.methods["optimum"]
    assert optimum.limits == ("energy, peak",) * 2
    assert np.abs(optimum.gap).max() < 1e-6
    np.testing.assert_allclose(optimum.peak, focused.bound, rtol=1e-6)
    for name in ("time_reversal", "one_bit", "inverse_filter"):
        method = focused.methods[name]
        assert (method.peak < optimum.peak).all()
        np.testing.assert_allclose(method.gap, 1 - method.peak / focused.bound, atol=1e-9)
    for name, method in focused.methods.items():
        assert (method.energy <= 0.02 * (1 + 1e-9)).all()
        assert np.abs(method.waveforms).max() <= 0.8 * (1 + 1e-9)
        at_moment = method.responses[..., round(0.02 * TABLE["rate"]) - 1]
        np.testing.assert_allclose(np.diag(at_moment), method.peak, rtol=1e-9)
        if name != "inverse_filter":  # where waveforms focus, little moves more at other times
            assert (np.diag(method.crosstalk_db) < 0.1).all()


def test_motion_passes_through_the_field_at_the_moment(focused):
    """Frames come by recursion from sample to sample; their velocity is the slope of the displacement."""
    shown = focus_motions(focused, ["optimum", "one_bit"], (0.015, 0.022), 200)
    for motion, name in zip(shown, ("optimum", "one_bit"), strict=True):
        method, at = focused.methods[name], int(np.abs(motion.times - 0.02).argmin())
        assert motion.times[at] == pytest.approx(0.02)
        ny, nx = motion.displacement.shape[1:]
        *_, number, unit = motion.name.split()
        largest = float(number) * {"nm": 1e-9, "µm": 1e-6}[unit]
        for point, index in zip(TABLE["points"], (0, 1), strict=True):
            row, column = (round(share / 0.2 * (count - 1)) for share, count in zip(point[::-1], (ny, nx), strict=True))
            expected = method.responses[0, index, round(0.02 * TABLE["rate"]) - 1]
            assert motion.displacement[at, row, column] * largest == pytest.approx(
                expected, rel=0.05, abs=0.03 * largest
            )
        slope = np.gradient(motion.displacement, motion.times, axis=0)[1:-1]
        assert np.abs(slope - motion.velocity[1:-1]).max() < 0.15 * np.abs(motion.velocity).max()
    with pytest.raises(SceneError, match="must lie within the motion"):
        focus_motions(focused, span=(0.0, 1.0))


def test_reprs_are_short(focused):
    foci, actuators = len(focused.bound), len(focused.scene.actuators)
    assert repr(focused) == f"<FocusResult {foci} foci: {', '.join(focused.methods)}>"
    assert repr(focused.methods["optimum"]) == f"<FocusedWaveforms {foci} foci, {actuators} actuators>"


def test_waveforms_of_another_panel_are_played(focused):
    """Waveforms reach the same on their own panel, less with more damping; the gap is to the optimum of that panel."""
    again = focus(focused.scene, focused)
    harder = focus(focused.scene.replace("effects.damping.viscous", 40.0), focused)
    for name, method in focused.methods.items():
        np.testing.assert_allclose(again.methods[name].peak, method.peak, rtol=1e-12)
        np.testing.assert_array_equal(harder.methods[name].waveforms, method.waveforms)
        assert (harder.methods[name].peak < method.peak).all()
    assert (harder.methods["optimum"].gap > 1e-4).all()
    np.testing.assert_allclose(harder.bound, focus(harder.scene).bound)
    with pytest.raises(SceneError, match=r"focus.rate: the waveforms were made with another one, 16000"):
        focus(focused.scene.replace("focus.rate", 32000), focused)
    with pytest.raises(SceneError, match=r"actuators: the waveforms were made for others, 0 \(N/m²\), 1"):
        focus(focused.scene.with_tables(actuators=focused.scene.actuators[:2]), focused)


def test_volts_are_written_as_volts_and_not_played_as_pressures(tmp_path):
    piezo = {"kind": "piezo", "d31": -1.8e-10, "young_modulus": 6e10, "thickness": 2e-4}
    places = [{"name": "a", "area": (0.02, 0.05, 0.02, 0.05)}, {"name": "b", "area": (0.12, 0.15, 0.1, 0.13)}]
    table = {"points": [(0.05, 0.04)], "highest": 300.0, "rate": 2000, "time": 0.02}
    found = focus(scene_of(damping=88.5, focus=table).with_tables(actuators=[{**place, **piezo} for place in places]))
    assert export(found, tmp_path / "a.csv", to="drive-csv").contents["unit"] == "V"
    assert " V]" in (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[0]
    with pytest.raises(SceneError, match=r"made for others, a \(V\), b \(V\)"):
        focus(found.scene.with_tables(actuators=places), load_focus(save_focus(found, tmp_path / "volts.h5")))
    with pytest.raises(SceneError, match="encoding = 'pcm8': must be one of float32"):
        export(found, tmp_path / "a.wav", to="drive-wav", encoding="pcm8")


def test_four_fingers_feel_bursts_of_their_own():
    """Resolution is in half bending waves at 2000 Hz: π/k with k² = ω √(ρH/D)."""
    found = focus("four-fingers")
    inverse = found.methods["inverse_filter"]
    assert inverse.crosstalk_db[~np.eye(4, dtype=bool)].max() < -20
    assert inverse.misfit.max() < 0.05
    rigidity = 7e10 * 5e-4**3 / 12 / (1 - 0.22**2)
    half_wave = np.pi / np.sqrt(2 * np.pi * 2000 * np.sqrt(2500 * 5e-4 / rigidity))
    assert found.half_wave == pytest.approx(half_wave)
    area = found.methods["optimum"].focus_area
    np.testing.assert_allclose(found.resolution("optimum"), np.sqrt(4 * area / np.pi) / half_wave)


def test_quiet_waveforms_keep_the_rest_within_its_bound():
    """Against random waveforms near them: none within the bound and the energy moves the point further."""
    point, rest, rate = TABLE["points"][0], {"contrast": 15.0, "radius": 0.03}, 4000
    table = {**TABLE, "points": [point], "rate": rate, "energy": 0.02, "rest": rest}
    scene = scene_of(damping=20.0, focus=table)
    found = focus(scene)
    quiet, plain = found.methods["quiet"], found.methods["time_reversal"]
    assert quiet.limits == ("energy, rest",)
    assert quiet.peak[0] < plain.peak[0]
    plate = modes_below(scene, 600.0)
    responses = HeldResponses(plate, rate, scene.focus.recorded, velocity=False)
    outside = plate.kinetic_matrix() - plate.kinetic_matrix(Target(disc=(*point, 0.03)))
    mass = plate.space.plate_mass * (1 - math.pi * 0.03**2 / 0.04)

    def figures(waveforms):
        amplitudes = responses.amplitudes(responses.states(waveforms))
        squares = (amplitudes @ outside * amplitudes).sum(axis=1) / mass
        moved = (amplitudes @ plate.at_points([point]))[:, 0]
        return moved, moved / np.sqrt(squares)

    random, least, best = np.random.default_rng(3), 10 ** (15 / 20), quiet.waveforms[0]
    moved, contrast = figures(best[None])
    assert contrast[0] == pytest.approx(least)
    tilted = best + random.normal(size=(60, 1, 1)) * (plain.waveforms[0] - best)
    noisy = tilted + 0.01 * best.std() * random.normal(size=(60, *best.shape))
    noisy *= np.linalg.norm(best) / np.linalg.norm(noisy, axis=(1, 2), keepdims=True)
    others, contrasts = figures(noisy)
    assert (contrasts > least).any()
    assert others[contrasts > least].max() < moved[0]


@pytest.mark.parametrize("density", [1e3, 1e5])
def test_the_rest_is_what_the_disc_leaves_of_the_plate_and_its_layers(density):
    """A disc that reaches off the plate over its lower edge and covers half of a layer, against the field at the moment
    on a raster."""
    point, radius, layer = (0.09, 0.02), 0.06, {"area": (0.05, 0.15, 0.0, 0.05), "young_modulus": 0.0}
    rest = {"contrast": 10.0, "radius": radius}
    table = {**TABLE, "points": [point], "rate": 4000, "energy": 0.02, "rest": rest}
    effects = {"damping": {"viscous": 20.0}, "layers": [{**layer, "thickness": 1e-4, "density": density}]}
    found = focus(scene_of(effects=effects, focus=table, modal_density=1.0)).methods["quiet"]
    assert found.limits == ("energy, rest",)
    (field,) = found.fields
    rows, columns = field.shape
    x, y = 0.2 * (np.arange(columns) + 0.5) / columns, 0.2 * (np.arange(rows)[:, None] + 0.5) / rows
    mass = 0.5 + 1e-4 * density * ((x > 0.05) & (x < 0.15) & (y < 0.05))
    mass *= np.hypot(x - point[0], y - point[1]) > radius
    contrast = 20 * math.log10(abs(found.peak[0]) / math.sqrt((mass * field**2).sum() / mass.sum()))
    assert contrast == pytest.approx(10.0, abs=0.1)


@pytest.mark.slow
def test_focusing_glass_has_the_published_area():
    """20 mm², within 20 %; the optimum moves the points further, and the inverse filter's focus is smaller."""
    methods = focus("focusing-glass").methods
    assert methods["time_reversal"].focus_area == pytest.approx(20e-6, rel=0.2)
    assert (methods["optimum"].peak > 2 * methods["time_reversal"].peak).all()
    assert (methods["inverse_filter"].focus_area < methods["time_reversal"].focus_area).all()
    assert np.abs(methods["optimum"].gap).max() < 1e-6


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
@pytest.mark.slow
def test_time_stepping_agrees_and_converges(tmp_path, quantity):
    """Waveforms under a limit of energy, held, on grids of fourth order: the error falls, below 1 % at 61 nodes a side.

    With modes up to 2000 Hz, what higher ones would add to frequencies up to 600 Hz is less than that.
    """
    table = {**TABLE, "highest": 2000.0, "quantity": quantity, "energy": 0.02}
    scene = scene_of(damping=20.0, window=(0.0, 0.024), focus=table, modal_density=1.0)
    found = focus(scene)
    method, errors = found.methods["optimum"], []
    rate = TABLE["rate"] * OVERSAMPLED
    for nodes in (31, 61):
        motion = 0.0
        for index, waveform in enumerate(method.waveforms[0]):  # grids of fourth order take one signal
            np.savetxt(tmp_path / "held.csv", np.repeat(waveform, OVERSAMPLED))
            signal = {"file": "held.csv", "rate": float(rate), "start": 0.5 / rate}
            grid = {"nodes": (nodes, nodes), "order": 4, "load": "moments", "precision": "float64"}
            stepped = scene.with_tables(drive={"frequency": 600.0, "signal": signal}, grid=grid).in_folder(tmp_path)
            run = PlateSolver(stepped, "cpu").run(np.eye(3)[[index]], points=TABLE["points"])
            motion = motion + run.trace[0]
        times = run.trace_times
        if quantity == "velocity":
            times, motion = (times[1:] + times[:-1]) / 2, np.diff(motion, axis=1) / np.diff(times)
        moved = np.array([np.interp(found.times, times, each) for each in motion])
        inside = found.times < 0.0235
        errors.append(np.abs(moved - method.responses[0])[:, inside].max() / np.abs(method.responses[0]).max())
    assert errors[1] < min(0.01, errors[0] / 2), errors


def coil_panel(rows, **table):
    """A panel with coils for volts, one of them with inductance, and a focus."""
    voltages = [{key: value for key, value in row.items() if key != "phase"} for row in rows]
    return panel(voltages).with_tables(focus={**TABLE, "highest": 400.0, "energy": 0.02, **table})


def test_a_current_in_a_coil_without_mass_is_a_force():
    places = [
        {"name": str(index), "area": area}
        for index, area in enumerate([(0.05, 0.07, 0.06, 0.08), (0.12, 0.15, 0.03, 0.07)])
    ]
    numbers = {"kind": "coil", "current": 1.0, "force_factor": 2.0, "resistance": 4.0}
    table = {**TABLE, "energy": 0.02}
    pressed, driven = (
        panel([{**place, **more} for place in places]).with_tables(focus=table) for more in ({}, numbers)
    )
    by_pressure, by_current = (HeldResponses.of_scene(one, 300).at_foci() for one in (pressed, driven))
    areas = np.array([actuator.patch_area for actuator in pressed.actuators])[:, None, None]
    np.testing.assert_allclose(by_current, 2.0 * by_pressure / areas, atol=1e-6 * np.abs(by_current).max())


def test_waveforms_of_coils_move_the_foci_as_one_system_of_first_order_does():
    """The matrix exponential of modes, magnets and currents steps from sample to sample; motions above the highest
    frequency, which focused responses leave out, are small."""
    scene = coil_panel(LOSSLESS_COILS[:2], highest=1000.0)
    found = focus(scene).methods["optimum"]
    plate = solve_modes(scene, 1000.0)
    plate = plate.part(np.arange(90))
    matrix, drives = first_order_system(plate)
    count, samples = len(matrix), found.waveforms.shape[2]
    whole = np.zeros((count + 2, count + 2))
    whole[:count, :count], whole[:count, count:] = matrix, drives
    step, state = scipy.linalg.expm(whole / TABLE["rate"]), np.zeros(count + 2)
    shapes, moved = plate.at_points(TABLE["points"]).T, np.zeros((2, samples))
    for sample in range(samples):
        state[count:] = found.waveforms[0, :, sample]
        state = step @ state
        moved[:, sample] = shapes @ state[: len(plate.frequencies)]
    np.testing.assert_allclose(moved, found.responses[0][:, :samples], atol=0.01 * np.abs(moved).max())


def test_area_and_contrast_of_a_known_field():
    """A cone of radius 0.05 m falls to half at 0.025 m; a distant spot of the same height is not part of the focus."""
    x, y = np.meshgrid((np.arange(400) + 0.5) / 2000, (np.arange(200) + 0.5) / 2000)
    cone = np.clip(1 - np.hypot(x - 0.06, y - 0.05) / 0.05, 0, None)
    spot = 0.9 * ((x > 0.15) & (y > 0.05))
    area, contrast = measure_focus(-2 * (cone + spot), (0.2, 0.1), (0.06, 0.05), -2.0)
    assert area == pytest.approx(math.pi * 0.025**2, rel=0.01)
    rest = 4 * np.where(cone < 0.5, (cone + spot) ** 2, np.nan)
    assert contrast == pytest.approx(20 * math.log10(2 / math.sqrt(np.nanmean(rest))), abs=0.01)


def test_only_motion_above_the_lowest_frequency_is_focused():
    """The waveforms of time reversal have no lower frequencies, and the focus is smaller."""
    wide, high = (
        focus(scene_of(damping=20.0, focus={**TABLE, "lowest": lowest, "energy": 1.0})).methods["time_reversal"]
        for lowest in (0.0, 300.0)
    )
    below = np.fft.rfftfreq(high.waveforms.shape[-1], 1 / TABLE["rate"]) < 250
    share, of_all = (
        spectrum[..., below].sum() / spectrum.sum()
        for spectrum in (np.abs(np.fft.rfft(each.waveforms)) ** 2 for each in (high, wide))
    )
    assert share < 0.2 * of_all
    assert (high.focus_area < wide.focus_area).all()


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({}, r"focus: there is no such table; write \[focus\]"),
        ({"focus": TABLE, "effects": {"loss_factor": {"eta": 0.1}}}, "effects.loss_factor"),
        ({"focus": TABLE, "effects": {"stretching": {}}}, "effects.stretching"),
        ({"focus": {**TABLE, "highest": 1.0, "time": 1.0}}, "focus.highest 1: the plate has no mode up to it"),
        ({"focus": {**TABLE, "highest": 1e6, "rate": 10**7}}, "focus.highest 1e.06: about 6.54e.04 modes are needed"),
        (
            {"focus": {**TABLE, "highest": 2e3}, "search": {"robust": {"thickness": 0.99, "scenarios": 100}}},
            "^search.robust: focus.highest 2000: about .* modes are needed",
        ),
        ({"focus": {**TABLE, "lowest": 560.0}}, "time: 0.02 s is shorter than a pulse from lowest to highest, 0.025 s"),
        ({"focus": {**TABLE, "points": [(0.07, 0.3)]}}, r"focus.points\[0\]: \[0.07, 0.3\] is off the plate"),
        ({"focus": {**TABLE, "points": [(0.07, 0.05), (0.0, 0.1)]}}, r"focus.points\[1\]: nothing moves at 0, 0.1"),
        ({"focus": {**TABLE, "rate": 1000}}, "rate: 1000 samples a second; highest = 600 Hz takes at least twice"),
        ({"focus": {**TABLE, "lowest": 600.0}}, "lowest: 600 Hz must be below highest"),
        ({"focus": {**TABLE, "time": 1e-5}}, "time: 1e-05 s is shorter than a pulse"),
        ({"focus": {**TABLE, "time": 200.0}}, "focus.time: 3200000 samples for 3 actuators and 2 points"),
        ({"focus": {**TABLE, "quantity": "acceleration"}}, "focus.quantity"),
        ({"focus": {**TABLE, "condition": 0.5}}, "focus.condition"),
        ({"focus": {**TABLE, "burst": {"frequency": 900.0}}}, "burst: 5 cycles of 900 Hz: must be at most highest"),
        ({"focus": {**TABLE, "burst": {"frequency": 50.0}}}, "half of the burst within time = 0.02 s"),
    ],
)
def test_what_cannot_be_focused_is_refused(tables, words):
    with pytest.raises(SceneError, match=words) as caught:
        focus(scene_of(damping=20.0).with_tables(**tables))
    assert "\n" not in str(caught.value)
