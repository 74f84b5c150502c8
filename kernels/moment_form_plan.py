"""How ``general_blocks`` shares a plate among the threads of a block, and what it keeps where."""

from dataclasses import dataclass, replace

import warp as wp

from warp_plate.kernels.cuda import LANES, SHARED_BYTES, most_registers
from warp_plate.kernels.moment_form_edges import WORD

# What a node alone reads of what all plates share, in this order; press: mobility / weight.
SHARED = ("mobility", "bend_xx", "bend_xy", "bend_yy", "twist", "decay", "spring", "weight", "press")
# What pays most in registers first: numbers that change, then what both passes read. ``middle`` is a node's own share
# in the force on it.
FIRST = ("rate", "squares", "middle", "u")
# Registers for addresses, neighbours and the like; and the most nodes a thread that are written out one by one.
OVERHEAD, MOST_NODES = 30, 16


@dataclass(frozen=True)
class Blocks:
    """How a plate is shared: threads a block, nodes a thread, names of the planes held in registers, and of those in
    the block's own room; on_chip: whether that is shared memory; registers: at most so many a thread."""

    threads: int
    nodes: int
    held: tuple[str, ...]
    planes: tuple[str, ...]
    on_chip: bool
    registers: int


def layout(nx, hanging, blocks):
    """Where in a block's room things begin, by name: each plane, with a margin before and after it, then the sums of
    each warp, what they make, and the kinds of the nodes; ``end``: numbers in the room."""
    margin, sums, words = nx + 1, 2 * hanging + 1, -(-blocks.nodes // WORD)
    padded, warps = blocks.threads * blocks.nodes, -(-blocks.threads // LANES)
    place = {name: margin + index * (padded + margin) for index, name in enumerate(blocks.planes)}
    place["slots"] = margin + len(blocks.planes) * (padded + margin)
    place["results"] = place["slots"] + sums * warps
    place["kinds"] = place["results"] + sums
    place["end"] = place["kinds"] + words * blocks.threads
    return place


def used(effects):
    """Names of the shared planes that the effects read at every step."""
    asked = {
        "decay": effects.damping,
        "spring": effects.foundation,
        "weight": effects.stretching,
        "press": effects.oscillators or effects.moving_load,
    }
    return tuple(name for name in SHARED if asked.get(name, True))


def planes_of(effects, held):
    """Names of the planes in a block's room, where ``held`` are in registers."""
    strained = ("strained",) if effects.material_damping else ()
    pull = ("pull",) if effects.stretching and "pull" not in held else ()
    return ("u", "mx", "my", "mxy", *strained, *pull)


def share(nx, ny, real, effects, hanging, threads, blocks):
    """How ``threads`` threads share a plate, of which so many ``blocks`` shall run on a multiprocessor."""
    words = 1 if real is wp.float32 else 2
    nodes = -(-nx * ny // threads)
    registers = most_registers(-(-threads // LANES) * blocks)
    wanted = [*FIRST, *(["pull"] if effects.stretching else []), *used(effects)]
    most = max(0, registers - OVERHEAD) // (words * nodes) if nodes <= MOST_NODES else 0
    held = tuple(wanted[:most])
    made = Blocks(threads, nodes, held, planes_of(effects, held), True, registers)
    on_chip = 4 * words * layout(nx, hanging, made)["end"] <= SHARED_BYTES
    return replace(made, on_chip=on_chip)


def plan(nx, ny, real, effects, hanging, few):
    """How to share a plate among threads; few: there are fewer plates than multiprocessors.

    Few plates: what counts is how soon a plate has made a step, so that all threads which a block can have take part.
    Many: what counts is that while one block waits at a barrier another works, and that much is held in registers.
    Where sums run over the plate, their order follows the threads: there the plan is that of many for any number, lest
    a plate's bits depend on how many others there are.
    """
    warps = -(-nx * ny // LANES)
    if few and not (effects.stretching or effects.oscillators):
        threads, blocks = LANES * min(32, warps), 1
    else:
        nodes = 3 if warps <= 3 * 12 else 6
        threads = LANES * min(32, -(-warps // nodes))
        words = 1 if real is wp.float32 else 2
        blocks = max(1, 1024 // (words * threads))
    return share(nx, ny, real, effects, hanging, threads, blocks)
