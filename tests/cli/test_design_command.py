"""``warp-plate design``: its JSON, the scene with its map, the picture and the solid, and what it refuses."""

import json

import numpy as np
import pytest

from support.commands import error_of, output_of
from warp_plate import Scene
from warp_plate.modal.solver import ModalSolver

CHANGES = [
    f"--set={change}"
    for change in (
        "design.thickness={range=[3.5e-4,7.5e-4],length_scale=0.1,mass=1.0}",
        "design.starts=1",
        "design.iterations=3",
        "grid.modal_density=0.5",
    )
]


@pytest.mark.slow
def test_the_designed_scene_is_written_with_its_map(command, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    out = tmp_path / "panel.designed.toml"
    record = json.loads(output_of(command("design", "paper", *CHANGES, "--solid", "--json", "--out", str(out))))
    assert record["after"]["bound"] > record["before"]["bound"] > 0.6
    assert record["history"][0][-1] == pytest.approx(record["after"]["value"], abs=0.02)
    assert out.with_suffix(".png").stat().st_size > 30_000
    scene = Scene.load(out)
    assert ModalSolver(scene, "cpu").response.bound() == pytest.approx(record["after"]["bound"], abs=1e-6)
    factors = np.loadtxt(out.with_suffix(".thickness.csv"), delimiter=",")
    assert factors * 5e-4 == pytest.approx(np.array(record["thickness"]))
    solid = pyvista.read(out.with_suffix(".stl"))
    assert solid.is_manifold
    assert solid.volume == pytest.approx(200 * 200 * 0.5, rel=3e-3)  # mm³, of the same mass, in flat triangles

    printed = output_of(command("design", "paper", *CHANGES, "--no-pictures", "--out", str(out)))
    assert f"any drive {record['before']['bound']:.4f} {record['after']['bound']:.4f}" in " ".join(printed.split())


def test_scenes_without_a_design_and_files_of_others_are_refused(command, tmp_path):
    assert "design: is missing" in error_of(command("design", "paper"))
    other = tmp_path / "paper.designed.toml"
    other.write_text("title = 'mine'")
    assert "would be overwritten" in error_of(command("design", "paper", *CHANGES, "--out", str(other)))
