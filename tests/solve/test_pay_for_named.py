"""A scene pays only for the effects it names: the others are not in the code of its kernels."""

import pytest
import warp as wp

from warp_plate import Scene
from warp_plate.kernels import moment_form_cpu
from warp_plate.kernels.update import KernelEffects
from warp_plate.plate.scheme import discretize
from warp_plate.solve.compiled_scene import choose_path
from warp_plate.solve.devices import find_device
from warp_plate.solve.specialize import Specialized

# Lines of the kernel that belong to one effect alone; Warp repeats those that it compiles as comments.
LINES = {
    "retarded": "retardation * rate[i]",
    "in_plane": "- tension * u",
    "springs": "inverse_mass * (spring * u)",
    "membrane": "m.membrane * d.units",
    "attached": "mass_rate - patch_rate",
    "coils": "new = rate[i] + pressure_gain[i] * pressure[i]",
    "travelling": "along_y[row] * along_x",
    "outline": "own_x = centre_x[i]",
    "damping": "p.decay * rate",
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
    effects = KernelEffects(terms=4, moments=True, **dict.fromkeys(LINES, on))
    code = code_of(moment_form_cpu.make_run_steps(effects, wp.float32, 9, 16), tmp_path)
    assert {effect: line in code for effect, line in LINES.items()} == dict.fromkeys(LINES, on)


def test_a_plain_scene_takes_the_plain_kernels():
    specialized = Specialized(discretize(Scene.load("paper")), find_device("cpu"))
    assert specialized.effects == KernelEffects(damping=True)
    assert specialized.scheme.bending is None
    assert choose_path(specialized) == "resident"
