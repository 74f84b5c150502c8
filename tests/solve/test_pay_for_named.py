"""A scene pays only for the effects it names: the others are not in the code of its kernels."""

import pytest
import warp as wp

from warp_plate import Scene
from warp_plate.kernels import moment_form
from warp_plate.kernels.update import KernelEffects
from warp_plate.plate.discretization import discretize
from warp_plate.solve.devices import find_device
from warp_plate.solve.engine import choose_path
from warp_plate.solve.specialize import Specialized

# Members of the kernels' structs that belong to one effect alone.
MEMBERS = {
    "retarded": "retardation",
    "in_plane": "in_plane_x",
    "springs": "spring",
    "membrane": "membrane",
    "attached": "attached_shares",
    "travelling": "strength",
    "damping": "decay",
}


def code_of(kernel, folder):
    """Return the C++ functions that Warp writes for a kernel, without the declarations of structs."""
    find_device("cpu")
    wp.compile_aot_module(kernel.module, device="cpu", module_dir=folder)
    text = "\n".join(path.read_text(encoding="utf-8") for path in folder.glob("*.cpp"))
    assert "wp::" in text
    return text


@pytest.mark.filterwarnings("ignore:compile_aot_module.*-march=native")
@pytest.mark.parametrize("on", [True, False])
def test_only_effects_that_are_on_are_in_the_code(on, tmp_path):
    effects = KernelEffects(terms=4, moments=True, **dict.fromkeys(MEMBERS, on))
    passes = moment_form.make_passes(effects, wp.float32)
    code = "".join(code_of(kernel, tmp_path / str(index)) for index, kernel in enumerate(passes))
    assert {effect: f").{member})" in code for effect, member in MEMBERS.items()} == dict.fromkeys(MEMBERS, on)


def test_a_plain_scene_takes_the_plain_kernels():
    specialized = Specialized(discretize(Scene.load("paper")), find_device("cpu"))
    assert specialized.effects == KernelEffects(damping=True)
    assert specialized.scheme.bending is None
    assert choose_path(specialized) == "resident"
