"""Wished waveforms from files and arrays, and panels within tolerances."""

import numpy as np
import pytest
from scipy.io import wavfile

from support.scenes import scene_of
from warp_plate import SceneError, focus
from warp_plate.focusing.figures import focus_motions
from warp_plate.result.focus import load_focus, save_focus

TABLE = {"points": [(0.07, 0.06), (0.13, 0.12)], "highest": 600.0, "rate": 4000, "condition": 1e3}
PATCHES = [(x, x + 0.02, y, y + 0.02) for x in (0.02, 0.16) for y in (0.03, 0.14)]


def wishes(rate=2000, duration=0.06):
    """Return a hump and a sweep (2, samples), band-limited, silent at both ends."""
    times = np.arange(1, round(duration * rate) + 1) / rate
    hump = np.sin(np.pi * times / duration) ** 2
    return times, np.stack([hump, hump * np.sin(2 * np.pi * (80 + 1500 * times) * times)])


def focus_panel(**tables):
    return scene_of(
        damping=20.0, edges=("supported",) * 4, actuators=PATCHES, focus=TABLE, modal_density=1.0
    ).with_tables(**tables)


def test_foci_follow_wished_waveforms_of_their_own(tmp_path):
    """From an array at the rate of the waveforms; a hump, which is quasi-static, and a sweep."""
    times, wished = wishes(TABLE["rate"])
    found = focus(focus_panel(), wished=wished)
    inverse = found.methods["inverse_filter"]
    assert inverse.waveforms.shape == (2, 4, times.size)
    assert inverse.misfit.max() < 0.02
    assert found.methods["time_reversal"].misfit.min() > 0.1
    moments = np.abs(wished).argmax(axis=1)
    for index, motion in enumerate(inverse.responses[[0, 1], [0, 1], : times.size]):
        assert inverse.peak[index] == motion[moments[index]]
        np.testing.assert_allclose(
            motion / (motion @ wished[index]) * (wished[index] @ wished[index]), wished[index], atol=0.03
        )
        ny, nx = inverse.fields[index].shape
        x, y = TABLE["points"][index]
        field = inverse.fields[index][int(y / 0.2 * ny), int(x / 0.2 * nx)]
        assert field == pytest.approx(inverse.peak[index], rel=0.08)
    read = load_focus(save_focus(found, tmp_path / "found.h5"))
    np.testing.assert_array_equal(read.wished, wished)
    again = focus(read.scene, read)
    np.testing.assert_allclose(again.methods["inverse_filter"].misfit, inverse.misfit)
    assert focus_motions(read, ["inverse_filter"], frames=5)[0].times[-1] == pytest.approx(found.times[-1])


@pytest.mark.parametrize("kind", ["csv", "wav"])
def test_wishes_are_read_from_files_of_another_rate(tmp_path, kind):
    times, wished = wishes(1500)
    if kind == "csv":
        np.savetxt(tmp_path / "wish.csv", np.c_[times, wished.T], delimiter=",")
        table = {"file": "wish.csv", "per_point": True}
    else:
        wavfile.write(tmp_path / "wish.wav", 1500, wished.T.astype(np.float32))
        table = {"file": "wish.wav", "per_point": True, "start": float(times[0])}
    found = focus(focus_panel(focus={**TABLE, "wish": table}).in_folder(tmp_path))
    expected = wishes(TABLE["rate"])[1]
    assert found.wished.shape[1] == pytest.approx(expected.shape[1], abs=4)
    np.testing.assert_allclose(found.wished[:, :-20], expected[:, : found.wished.shape[1] - 20], atol=0.02)
    assert found.methods["inverse_filter"].misfit.max() < 0.02


def test_a_wish_of_all_points_is_one_channel(tmp_path):
    np.savetxt(tmp_path / "wish.csv", wishes(4000)[1][1])
    found = focus(focus_panel(focus={**TABLE, "wish": {"file": "wish.csv", "rate": 4000.0}}).in_folder(tmp_path))
    np.testing.assert_array_equal(found.wished[0], found.wished[1])


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"file": "none.csv"}, r"focus.wish.file = 'none.csv': no such file beside the scene file"),
        ({"file": "three.csv"}, "3 columns instead of 1, or time first; per_point = true"),
        ({"file": "two.csv", "per_point": True}, "no column of times; write focus.wish.rate"),
        ({"file": "one.csv", "rate": 4000.0, "per_point": True}, "1 columns instead of 2, or time first"),
        ({"file": "two.csv", "rate": 0.01, "per_point": True}, "focus.wish: 3200000 samples for 4 actuators"),
        ({"file": "two.txt"}, "focus.wish.file"),
    ],
)
def test_files_that_are_no_wish_are_refused(tmp_path, wish, words):
    np.savetxt(tmp_path / "two.csv", wishes(4000)[1].T[:9], delimiter=",")
    np.savetxt(tmp_path / "three.csv", np.ones((9, 3)), delimiter=",")
    np.savetxt(tmp_path / "one.csv", wishes(4000)[1][1])
    with pytest.raises(SceneError, match=words) as caught:
        focus(focus_panel(focus={**TABLE, "wish": wish}).in_folder(tmp_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wished", "words"),
    [
        (np.ones((3, 50)), r"focus.wish: the shape \(3, 50\); must be \(samples,\) or \(2, samples\)"),
        (np.zeros(50), "zero throughout"),
        (np.full(50, 1e300), "the largest is from 1e-30"),
        (np.full(50, np.nan), "is no number"),
        (np.ones(9) * 1j, "must be real numbers"),
        (np.ones(2**20), "focus.wish: 1048576 samples for 4 actuators and 2 points"),
    ],
)
def test_arrays_that_are_no_wish_are_refused(wished, words):
    with pytest.raises(SceneError, match=words):
        focus(focus_panel(), wished=wished)


def test_a_wish_excludes_a_burst_and_a_bound_of_the_rest():
    rest = {"rest": {"contrast": 9.0, "radius": 0.02}}
    for tables, words in (({"burst": {"frequency": 300.0}}, "wish: replaces the burst"), (rest, "of a wish")):
        with pytest.raises(SceneError, match=words):
            focus_panel(focus={**TABLE, "wish": {"file": "wish.csv"}, **tables})


def test_waveforms_without_a_wish_are_not_played_under_one(tmp_path):
    np.savetxt(tmp_path / "wish.csv", wishes(4000)[1][1])
    made = focus(focus_panel())
    wishing = focus_panel(focus={**TABLE, "wish": {"file": "wish.csv", "rate": 4000.0}}).in_folder(tmp_path)
    with pytest.raises(SceneError, match=r"focus.wish: the waveforms were made with another one, None"):
        focus(wishing, made)


def test_a_filter_for_panels_alike_is_that_of_one(tmp_path):
    """Which reaches on other ones what it does on the nominal panel."""
    table = {**TABLE, "time": 0.02, "burst": {"frequency": 300.0, "cycles": 4.0}}
    found = focus(focus_panel(focus=table, search={"robust": {"gain": 1e-9, "scenarios": 2, "fresh": 1}}))
    found = load_focus(save_focus(found, tmp_path / "found.h5"))
    one, many = (found.methods[name] for name in ("inverse_filter", "robust_filter"))
    np.testing.assert_allclose(many.waveforms, one.waveforms, atol=2e-3 * np.abs(one.waveforms).max())
    for name in ("peak", "misfit"):
        np.testing.assert_allclose(getattr(many.panels, name)[0], getattr(many, name), rtol=1e-6)
    others = ~np.eye(2, dtype=bool)
    np.testing.assert_allclose(many.panels.crosstalk_db[0], many.crosstalk_db[others], rtol=1e-6)


@pytest.mark.slow
def test_a_filter_for_many_panels_loses_less_on_others():
    """With a modulus within 2 %: worst misfit and crosstalk of panels that neither filter has seen."""
    table = {**TABLE, "time": 0.03, "burst": {"frequency": 300.0, "cycles": 4.0}}
    robust = {"young_modulus": 0.01, "scenarios": 8, "fresh": 12}
    found = focus(focus_panel(focus=table, search={"robust": robust}))
    nominal, many = (found.methods[name] for name in ("inverse_filter", "robust_filter"))
    assert many.panels.peak.shape == (12, 2)
    assert nominal.misfit.max() < many.misfit.max()  # on the panel that it was made for
    assert many.panels.misfit.max() < 0.8 * nominal.panels.misfit.max()
    assert many.panels.crosstalk_db.max() < nominal.panels.crosstalk_db.max()
    assert (nominal.panels.misfit.max(axis=1) > nominal.misfit.max()).all()
