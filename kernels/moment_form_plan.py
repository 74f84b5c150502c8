"""Distribution of a plate over the threads of a block, and memory layout, for ``moment_form_cuda``."""

from dataclasses import dataclass, replace

import warp as wp

from warp_plate.kernels.cuda import LANES, most_registers

# Nodes whose flags, see ``moment_form_cuda``, are in a word of 32 bits.
NODES_PER_WORD = 6
# Planes shared by all plates, of which a node reads its own number alone; pressure_gain: inverse mass / weight.
MATERIAL_PLANES = (
    "inverse_mass", "bend_xx", "bend_xy", "bend_yy", "twist", "decay", "spring", "weight", "pressure_gain",
)  # fmt: skip
# Planes that save most when held in registers, best first. own_force: the share of the force on a node by its own
# moments and the cell to its upper right.
REGISTERS_FIRST = ("rate", "squares", "own_force", "u")
# Registers for addresses, neighbours and the like.
OVERHEAD_REGISTERS = 30
# Most nodes of a thread that are unrolled.
MOST_UNROLLED = 16


@dataclass(frozen=True)
class BlockPlan:
    """Distribution of a plate over a block."""

    threads: int  # Threads of the block
    nodes: int  # Nodes per thread
    in_registers: tuple[str, ...]  # Planes held in registers
    planes: tuple[str, ...]  # Planes in the block's workspace
    on_chip: bool  # The workspace is shared memory, else device memory
    registers: int  # Most registers per thread


def workspace_layout(nx, oscillators, block):
    """Return the offsets of a block's workspace by name, in numbers.

    Each plane, with a margin before and after it; then ``partial_sums`` of each warp, the ``totals`` computed from
    them, and the ``flags`` of the nodes. ``end`` is the size of the workspace.
    """
    margin, sums, words = nx + 1, 2 * oscillators + 1, -(-block.nodes // NODES_PER_WORD)
    padded, warps = block.threads * block.nodes, -(-block.threads // LANES)
    offsets = {name: margin + index * (padded + margin) for index, name in enumerate(block.planes)}
    offsets["partial_sums"] = margin + len(block.planes) * (padded + margin)
    offsets["totals"] = offsets["partial_sums"] + sums * warps
    offsets["flags"] = offsets["totals"] + sums
    offsets["end"] = offsets["flags"] + words * block.threads
    return offsets


def material_planes(effects):
    """Return the names of the material planes that the effects read at every step."""
    needed = {
        "decay": effects.damping,
        "spring": effects.foundation,
        "weight": effects.stretching,
        "pressure_gain": effects.oscillators or effects.moving_load,
    }
    return tuple(name for name in MATERIAL_PLANES if needed.get(name, True))


def workspace_planes(effects, in_registers):
    """Return the names of the planes in a block's workspace."""
    retarded = ("retarded_u",) if effects.material_damping else ()
    in_workspace = effects.stretching and "membrane_curvature" not in in_registers
    return ("u", "mx", "my", "mxy", *retarded, *(("membrane_curvature",) if in_workspace else ()))


def plan_block(nx, ny, real, effects, oscillators, few, shared_bytes):
    """Plan the block of a plate.

    With few plates the time of a single plate counts, so all threads that a block can have take part. With many, one
    block should work while another waits at a barrier, and registers should hold much. Where sums run over the plate,
    their order depends on the threads: there the plan of many serves any number, so that a plate's bits do not depend
    on the number of plates.

    Args:
        few: There are fewer plates than multiprocessors.
        shared_bytes: Most shared memory of a block on the device.
    """
    warps = -(-nx * ny // LANES)
    words = 1 if real is wp.float32 else 2
    if few and not (effects.stretching or effects.oscillators):
        threads, blocks = LANES * min(32, warps), 1
    else:
        threads = LANES * min(32, -(-warps // (3 if warps <= 3 * 12 else 6)))
        blocks = max(1, 1024 // (words * threads))
    nodes = -(-nx * ny // threads)
    registers = most_registers(-(-threads // LANES) * blocks)
    wanted = [*REGISTERS_FIRST, *(["membrane_curvature"] if effects.stretching else []), *material_planes(effects)]
    most = max(0, registers - OVERHEAD_REGISTERS) // (words * nodes) if nodes <= MOST_UNROLLED else 0
    in_registers = tuple(wanted[:most])
    block = BlockPlan(threads, nodes, in_registers, workspace_planes(effects, in_registers), True, registers)
    return replace(block, on_chip=4 * words * workspace_layout(nx, oscillators, block)["end"] <= shared_bytes)
