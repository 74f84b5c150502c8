"""A scene pays only for the effects it names: the source that Warp writes for a kernel holds nothing of the others."""

import re
from dataclasses import fields

import pytest
import warp as wp

from warp_plate import Scene
from warp_plate.kernels import moment_form_cpu as general_cpu
from warp_plate.kernels import moment_form_cuda as general_blocks
from warp_plate.kernels import moment_form_plan as general_plan
from warp_plate.kernels import moment_form_streaming as general_passes
from warp_plate.kernels import resident_cpu, streaming
from warp_plate.kernels.effects import Effects
from warp_plate.plate.discretization import discretize
from warp_plate.plate.scheme import make_scheme
from warp_plate.solve.cpu import compiler_flags
from warp_plate.solve.devices import find_device
from warp_plate.solve.paths import choose_path
from warp_plate.solve.specialize import specialize

# What the kernels read of an effect and of nothing else.
TRACES = {
    "material_damping": "retardation",
    "tension": "tension_x",
    "foundation": "spring",
    "stretching": "stretching",
    "oscillators": "holds",
    "moving_load": "strength",
    "damping": "decay",
}


def source_of(kernel, folder):
    """The functions and kernels that Warp wrote, without the declarations of structs."""
    find_device("cpu")
    wp.compile_aot_module(kernel.module, device="cpu", module_dir=folder)
    text = "\n".join(path.read_text(encoding="utf-8") for path in folder.glob("*.cpp"))
    assert "wp::" in text
    return text


def passes_of(effects, folder):
    """The source of all passes of the streaming path."""
    kernels = general_passes.make_passes(effects, wp.float32)
    return "".join(source_of(kernel, folder / str(index)) for index, kernel in enumerate(kernels))


def reads(source, name):
    """Whether a member of that name is read anywhere."""
    return re.search(rf"\(\(var_\w+\)\.{name}\)", source) is not None


@pytest.mark.parametrize("effect", TRACES)
def test_an_effect_that_is_off_is_not_in_the_source(effect, tmp_path):
    on = passes_of(Effects(moments=True, **{effect: True}), tmp_path / "on")
    off = passes_of(Effects(moments=True), tmp_path / "off")
    assert reads(on, TRACES[effect])
    assert not reads(off, TRACES[effect])
    assert len(on) > len(off)


@pytest.mark.parametrize("effect", TRACES)
def test_nor_is_it_in_that_of_blocks(effect, tmp_path):
    """What a plate's block holds and reads, and what it makes of it."""
    made = {}
    for name, effects in (("on", Effects(moments=True, **{effect: True})), ("off", Effects(moments=True))):
        blocks = general_plan.Blocks(1, 81, (), general_plan.planes_of(effects, ()), False, 64)
        hanging = 1 if effects.oscillators else 0
        run = general_blocks.make_run(effects, wp.float32, 9, 9, 16, hanging, blocks)
        made[name] = source_of(run, tmp_path / name)
    assert made["on"].count("wp::mul") > made["off"].count("wp::mul")


@pytest.mark.parametrize("effect", TRACES)
def test_nor_is_it_in_the_flat_form(effect, tmp_path):
    """Its numbers are handed over, but nothing is made of them: what is left is shorter."""
    made = {}
    for name, effects in (("on", Effects(moments=True, **{effect: True})), ("off", Effects(moments=True))):
        made[name] = source_of(general_cpu.make_run(effects, wp.float32, 9, 16, compiler_flags()), tmp_path / name)
    assert made["on"].count("wp::mul") > made["off"].count("wp::mul")


def test_a_plain_scene_takes_the_plain_kernels():
    """Nothing of the general paths: not even as the choice of a path."""
    specialized = specialize(discretize(Scene.load("paper")), find_device("cpu"))
    assert specialized.effects == Effects(damping=True)
    assert specialized.effects.plain
    assert specialized.scheme.bending is None
    assert choose_path(specialized) == "resident"


def test_undamped_source_has_no_decay(tmp_path):
    for make in (
        lambda effects: resident_cpu.make_run(effects, wp.float32, 13, 16, compiler_flags()),
        lambda effects: streaming.make_move(effects, wp.float32),
    ):
        damped = source_of(make(Effects(damping=True)), tmp_path / f"damped{id(make)}")
        free = source_of(make(Effects()), tmp_path / f"free{id(make)}")
        assert reads(damped, "decay")
        assert not reads(free, "decay")


def test_each_part_of_the_key_is_off_by_default():
    """A scene with nothing but a plate compiles the smallest kernel."""
    flags = [field.name for field in fields(Effects) if field.type in (bool, "bool")]
    scene = Scene.load("paper").model_dump(exclude_none=True)
    scene["effects"], scene["grid"] = {}, {"nodes": (27, 27)}
    bare = Scene.model_validate(scene)
    made = specialize(discretize(bare), find_device("cpu")).effects
    assert [name for name in flags if getattr(made, name)] == ["square_cells"]
    assert make_scheme(bare).decay == 1


def test_scenes_with_the_same_effects_share_kernels():
    """Other numbers, same kernel: nothing is compiled for a second scene."""
    effects = Effects(moments=True, tension=True)
    first = general_cpu.make_run(effects, wp.float32, 9, 16, compiler_flags())
    assert general_cpu.make_run(Effects(moments=True, tension=True), wp.float32, 9, 16, compiler_flags()) is first
