"""``warp-plate modes``: its table, JSON and picture, and shapes beside those of a grid."""

import json
import os
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from support.commands import output_of
from support.grid_modes import natural_modes
from warp_plate.modal.continuous_modes import continuous_modes, modes
from warp_plate.modal.modes import solve_modes
from warp_plate.viz.plots.modes import draw_modes, frequency_text, nodal_field, refined

EDGES = ("clamped", {"translation": 100.0, "rotation": 0.1}, "free", "supported")
EFFECTS = {
    "foundation": {"stiffness": 100.0, "damping": 3.0},
    "layers": [{"area": (0.05, 0.12, 0.05, 0.12), "thickness": 5e-4, "young_modulus": 5e9, "density": 2000.0}],
    "oscillators": [
        {"area": (0.2, 0.23, 0.02, 0.05), "stiffness": 100.0},
        {"area": (0.2, 0.23, 0.12, 0.15), "mass": 0.003, "stiffness": 30.0},
    ],
    "stretching": {},
}


def test_errors_of_frequencies_hold_where_the_stiffness_jumps(command, write_scene):
    """A stiff frame around a soft middle: frequencies fall as the first power of the spacing of knots."""
    factors = np.full((41, 41), 1000.0)
    factors[11:30, 11:30] = 1.0
    np.savetxt("stiff.csv", factors, delimiter=",")
    made = write_scene(size=(0.2, 0.2), effects={"variation": {"young_modulus": "stiff.csv"}}).in_folder(Path.cwd())
    record = json.loads(output_of(command("modes", "panel.toml", "--count", 3, "--json", "--no-pictures")))
    coarse, fine, finer = (solve_modes(made, highest=0.0, count=7, density=d).frequencies[:3] for d in (1, 2, 4))
    limit = 2 * finer - fine
    assert np.all(np.abs(coarse / limit - 1) > 0.01)
    assert np.all(np.abs(coarse / limit - 1) <= record["errors"])
    assert max(record["errors"]) < 0.3
    assert modes(made, count=3).errors.tolist() == pytest.approx(record["errors"], rel=1e-6)
    assert "error (%)" in output_of(command("modes", "panel.toml", "--no-pictures"))


def test_json_table_and_picture(command, write_scene):
    pytest.importorskip("matplotlib")
    made = write_scene(nodes=(19, 15), size=(0.3, 0.2), edges=EDGES, effects=EFFECTS)
    expected = continuous_modes(made, 4)
    record = json.loads(output_of(command("modes", "panel.toml", "--count", 4, "--json", "--out", "m.svg")))
    assert record["frequencies"] == pytest.approx(expected.frequencies.tolist())
    assert record["loss_factors"] == pytest.approx(expected.loss_factors.tolist())
    assert record["damping_ratios"] == pytest.approx((expected.loss_factors / 2).tolist())
    assert 0 < max(record["errors"]) < 1e-3
    assert record["half_waves"] == [None if pair is None else list(pair) for pair in expected.half_waves()]
    assert [row[0] for row in record["oscillators"]] == [None] * 4
    assert [row[1] for row in record["oscillators"]] == pytest.approx(expected.oscillators[:, 1].tolist())
    assert (record["scene"], record["left_out"]) == ("panel.toml", ["stretching"])
    assert record["files"] == ["m.svg"]
    drawn = Path("m.svg").read_text(encoding="utf-8")
    for number, frequency in enumerate(expected.frequencies, 1):
        assert f"{number}: {frequency_text(frequency)}" in drawn
    for words in ("clamped", "supported", "on springs", "free", "nodal line", "layer", "oscillator"):
        assert f"<!-- {words} -->" in drawn
    out = output_of(command("modes", "panel.toml", "--no-pictures", "--count", 4))
    left_out = "Not included in natural modes: stretching."
    for part in ("mass 1", left_out, *(f"{frequency:.6g}"[:6] for frequency in expected.frequencies)):
        assert part in out
    assert "mass 0" not in out
    write_scene(edges=("free",) * 4)
    out = output_of(command("modes", "panel.toml", "--no-pictures", "--count", 4))
    assert out.count("0 (rigid)") == 3
    # A free plate moves as a whole, tilts twice and twists: lobes are counted where there are no half-waves.
    assert [line.split()[-3:] for line in out.splitlines() if " × " in line][1:] == [
        ["1", "×", "1"], ["1", "×", "2"], ["2", "×", "1"], ["2", "×", "2"]
    ]  # fmt: skip
    assert "lobes x × y" in out
    assert "The plate is driven at up to 290 Hz, above these; --count 8 shows more." in out
    assert sorted(path.name for path in Path().iterdir()) == ["m.svg", "panel.toml"]


@pytest.mark.parametrize("line", ["modes panel.toml", "frf panel.toml --range 20:200"])
def test_a_picture_that_out_names_and_no_disk_has_room_for(line, command, write_scene, monkeypatch):
    pytest.importorskip("matplotlib")
    write_scene(nodes=(9, 9))
    monkeypatch.setattr(os, "replace", Mock(side_effect=OSError(28, "No space left on device")))
    status, answer, written = command(*line.split(), "--out", "m.png")
    assert (status, written) == (2, "warp-plate: --out m.png: cannot be written: No space left on device\n")
    assert answer
    assert not Path("m.png").exists()


def test_shapes_and_motions_are_those_of_a_fine_grid(scene):
    """Also of modes of one frequency, of a mass that only a damper holds, and of a plate that force softens."""
    oscillators = [*EFFECTS["oscillators"], {"area": (0.05, 0.1, 0.05, 0.1), "mass": 0.01, "damping": 0.1}]
    made = scene((61, 61), (0.3, 0.3), effects={"oscillators": oscillators, "stretching": {}})
    grid, found = natural_modes(made, 6), continuous_modes(made, 6, (61, 61))
    np.testing.assert_allclose(found.frequencies, grid.frequencies, rtol=0.01)
    np.testing.assert_allclose(found.shapes, grid.shapes, atol=0.02)
    np.testing.assert_allclose(found.oscillators, grid.oscillators, rtol=0.03, atol=1e-3)
    assert found.half_waves() == grid.half_waves()
    plain = scene((21, 21), (0.3, 0.3))
    grid, found = natural_modes(plain, 3), continuous_modes(plain, 3, (21, 21))
    np.testing.assert_allclose(found.shapes, grid.shapes, atol=0.02)


def test_nodal_lines(scene, tmp_path):
    """The second mode of a clamped square has its zeros on the middle line; the first has none, not even in the
    corners, where its sign changes by a part in thousands."""
    clamped = scene((21, 21), (0.2, 0.2))
    modes = natural_modes(clamped, 2)
    (x, y, _), *_ = fine = [refined(clamped, shape) for shape in modes.shapes]
    first, field = (nodal_field(clamped, values, (21, 21)) for _, _, values in fine)
    assert (first[np.isfinite(first)] > 0).all()
    assert field.shape == (y.size, x.size)
    below, above = (np.sign(part[np.isfinite(part)]) for part in (field[y < 0.0999], field[y > 0.1001]))
    assert (below == below[0]).all()
    assert (above == -below[0]).all()
    assert np.nanmax(np.abs(field[np.isclose(y, 0.1)])) == 0
    assert np.isnan(field[:, [0, -1]]).all()
    pytest.importorskip("matplotlib")
    draw_modes(clamped, modes.frequencies[:1], modes.shapes[:1], tmp_path / "one.pdf")
    assert (tmp_path / "one.pdf").stat().st_size > 1000
