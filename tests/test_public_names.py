"""The names of ``import warp_plate``: all there, imported when first used, and known to type checkers."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import warp_plate

LIBRARIES = ("warp", "numpy", "scipy", "pydantic", "h5py", "pyvista", "matplotlib")


def imported_by(code):
    """Return which of the libraries and modules of the package a fresh interpreter has imported after ``code``."""
    code += "; import sys; print(*(name for name in sys.modules if name.split('.')[0] in sys.argv[1:]))"
    command = [sys.executable, "-c", code, *LIBRARIES, "warp_plate"]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.parametrize("name", warp_plate.__all__)
def test_every_public_name_exists(name):
    assert getattr(warp_plate, name) is not None


def test_import_loads_nothing_but_the_package():
    assert imported_by("import warp_plate") == {"warp_plate"}


def test_a_scene_needs_no_solver():
    loaded = {name.split(".")[0] for name in imported_by("import warp_plate; warp_plate.Scene.load('paper')")}
    assert not loaded & {"warp", "scipy", "h5py", "pyvista", "matplotlib"}


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(warp_plate.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    modules = {name.asname: f"warp_plate.{node.module}" for node in imports for name in node.names}
    assert set(modules) == set(dir(warp_plate)) == set(warp_plate.__all__)
    for name, module in modules.items():
        assert getattr(warp_plate, name) is getattr(sys.modules[module], name)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="attribute localise"):
        _ = warp_plate.localise


def test_modes_are_as_many_as_asked_for():
    few, many = warp_plate.modes("paper", count=6), warp_plate.modes("paper")
    assert len(few.frequencies) == 6 < len(many.frequencies)
    assert few.frequencies == pytest.approx(many.frequencies[:6], rel=1e-6)
    assert few.shapes(few.frequencies[:0], few.frequencies[:0]).shape == (6, 0, 0)
    with pytest.raises(warp_plate.SceneError, match="count = 0: must be a whole number from 1 on"):
        warp_plate.modes("paper", count=0)


def test_fit_reads_files_as_its_command(tmp_path):
    file = tmp_path / "bench.csv"
    frequencies = warp_plate.modes("paper", count=4).frequencies
    file.write_text("frequency\n" + "\n".join(str(1.1 * value) for value in frequencies))
    scene = warp_plate.Scene.load("paper", ["fit.free.plate.young_modulus=[5e8, 2e9]", "fit.starts=1"])
    found = warp_plate.fit(scene, str(file))
    assert found.scene.plate.young_modulus == pytest.approx(1.21 * scene.plate.young_modulus, rel=1e-4)
    with pytest.raises(warp_plate.SceneError, match="must be one file"):
        warp_plate.fit(scene, [file, file])
