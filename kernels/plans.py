"""Distribution of plates over a GPU: over tiles, over a block's strips of rows, or over its threads.

Each tile takes several steps as if it were a plate. It overlaps its neighbours: interior tile edges are clamped, the
error travels by the reach of the differences in each step, so only deeper nodes, and those at the plate's edges, are
written.
"""

from dataclasses import dataclass, replace
from itertools import product

import warp as wp

from warp_plate.kernels.cuda import LANES, QUARTERS, most_registers

# Warps of a block: first those that the quarters of a multiprocessor share evenly.
EVEN, UNEVEN = (1, 4, 8, 12, 16), (2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15)
# Fourth order: rows of u that a strip needs from each neighbour.
BORDER = 4
# Nodes whose flags, see ``moment_form_cuda``, are in a word of 32 bits.
NODES_PER_WORD = 6
# Planes shared by all plates, of which a node reads its own number alone; pressure_gain: inverse mass / weight.
MATERIAL_PLANES = (
    "inverse_mass", "bend_xx", "bend_xy", "bend_yy", "twist", "decay", "spring", "weight", "pressure_gain", "centre_x",
    "centre_y",
)  # fmt: skip
# Planes that save most when held in registers, best first; membrane_curvature has no other place on the chip where
# plates are large. Of threads with many nodes only these: more is spilled to memory.
REGISTERS_FIRST = ("rate", "squares", "membrane_curvature")
MANY_NODES = 8
# Planes that shared memory holds as well. centre_force: the share of the force on a node by its own moments and the
# cell to its upper right.
REGISTERS_NEXT = ("centre_force", "u")
# Registers for addresses, neighbours and the like.
OVERHEAD_REGISTERS = 30
# Most nodes of a thread that are unrolled.
MOST_UNROLLED = 16


@dataclass(frozen=True)
class Cut:
    """Tiles along one axis of a plate, all equally long; the last ones overlap more where it does not divide."""

    nodes: int  # of the plate, edges included
    count: int = 1  # tiles
    length: int = 0  # nodes of a tile, its edges included
    margin: int = 0  # nodes inside a tile's edges that are wrong when it has taken its steps

    @property
    def pitch(self):
        """Nodes from one tile to the next."""
        return self.length - 2 - 2 * self.margin


def whole(nodes):
    """Return the axis of a plate that is not cut."""
    return Cut(nodes, 1, nodes, 0)


def cut(nodes, count, margin):
    """Return so many tiles, as short as possible, or one if these would be as long as the plate."""
    length = 2 + -(-(nodes - 2 + 2 * margin * (count - 1)) // count)
    return Cut(nodes, count, length, margin) if length < nodes else whole(nodes)


def make_place(axis):
    """Make ``place``: of tile i its first node, and in its own numbers the first node that it writes and the end."""

    @wp.func
    def place(i: int):
        last = wp.static(axis.nodes - axis.length)
        start = wp.min(i * wp.static(axis.pitch), last)
        next_start = wp.min((i + 1) * wp.static(axis.pitch), last)
        first = int(0)
        end = next_start - start + wp.static(1 + axis.margin)
        if i > 0:
            first = wp.static(1 + axis.margin)
        if i == wp.static(axis.count - 1):
            end = wp.static(axis.length)
        return start, first, end

    return place


@dataclass(frozen=True)
class StripPlan:
    """Distribution of a plate over a block: a strip of its rows for each warp, some columns for each lane."""

    columns: int  # Columns per lane
    rows: int  # Rows per warp
    warps: int  # Warps of the block
    registers: int  # Most registers per thread
    loads_in_registers: bool  # Else they are read from the cache
    shared_rows: int = 0  # Rows of a strip that are in shared memory: first of its sums of rate², then of its rates

    @property
    def shared_squares(self):
        """Rows of sums of rate² in shared memory: the last ones of a strip."""
        return min(self.shared_rows, self.rows)

    @property
    def shared_rates(self):
        """Rows of rates in shared memory: the last ones of a strip."""
        return self.shared_rows - self.shared_squares

    @property
    def latency(self):
        """Time of a step of a block that has a multiprocessor to itself, in about 15 clocks.

        Each row takes what a quarter's warps do in turn, and no less than four nodes' time for its chain of exchanges.
        """
        return self.rows * max(4, self.columns * -(-self.warps // QUARTERS))

    @property
    def rows_in_registers(self):
        """Rows of displacement, rate and sums, and of both loads, in registers."""
        return (3 + 2 * self.loads_in_registers) * self.rows - self.shared_rows


def plan_strips(rows, columns, warps, loads_in_registers=True, squares_shared=False):
    """Return the plan of a block of at most so many warps, whether or not it fits."""
    strip = -(-rows // warps)
    used = -(-rows // strip)
    return StripPlan(columns, strip, used, most_registers(used), loads_in_registers, strip * squares_shared)


def plan_few(nx, ny):
    """Return the plan of the fewest plates, of a size that a warp can have: so many warps that a step is short."""
    return plan_strips(ny - 2, 1, max(1, min(8, (ny - 2) // 2)))


def strip_plans(order, nx, ny, real, shared_bytes):
    """Yield the plans for a plate of this size that fit on a multiprocessor.

    The first is the fastest on an H200 where plates are many; in fourth order one of few warps, whose margins are few,
    with registers to spare.
    """
    words = 1 if real is wp.float32 else 2
    if order == 2:  # the rows and columns that move
        rows, columns, border, temporaries, overhead = ny - 2, -(-(nx - 2) // LANES), 2, 6, 24
        # Three rows of curvature are temporaries.
        choices = [
            (plan_strips(rows, columns, warps, in_registers, squares_shared), 0)
            for choice, squares_shared, in_registers in product((EVEN, UNEVEN), (False, True), (True, False))
            for warps in choice
        ]
        # Where all this is too much, as many rows of rates as needed are in shared memory as well.
        for warps in (*EVEN, *UNEVEN):
            plan = plan_strips(rows, columns, warps, False)
            room = (plan.registers - overhead) // (words * columns) - temporaries
            shared_rows = max(plan.rows, plan.rows_in_registers - room)
            if shared_rows <= 2 * plan.rows:
                choices.append((replace(plan, shared_rows=shared_rows), 0))
    else:  # taps of both passes are temporaries too
        rows, columns, border, temporaries, overhead = ny, -(-nx // LANES), BORDER, 17, 30
        choices = [
            (plan_strips(rows, columns, warps, in_registers, squares_shared), spare)
            for choice, spare, squares_shared in product(((1, 2, 4, 8, 12, 16), UNEVEN), (40, 0), (False, True))
            for warps, in_registers in product(choice, (True, False))
        ]
    for plan, spare in choices:
        # Of fourth order, the first and the last strip must hold all rows with special taps.
        few = plan.rows <= 1
        if order == 4:
            few = plan.warps > 1 and (plan.rows <= BORDER or (plan.warps - 1) * plan.rows > ny - BORDER)
        needed = words * columns * (plan.rows_in_registers + temporaries) + overhead
        shared = 4 * words * columns * LANES * (2 * 2 * border * (plan.warps + 2) + plan.shared_rows * plan.warps)
        # The bits of a word say which rows are loaded.
        if not few and plan.rows < LANES and needed + spare <= plan.registers and shared <= shared_bytes:
            yield plan


@dataclass(frozen=True)
class BlockPlan:
    """Distribution of a plate over a block."""

    threads: int  # Threads of the block
    nodes: int  # Nodes per thread
    in_registers: tuple[str, ...]  # Planes held in registers
    planes: tuple[str, ...]  # Planes in the block's workspace
    on_chip: bool  # The workspace is shared memory, else device memory
    registers: int  # Most registers per thread


def workspace_layout(nx, attached, block):
    """Return the offsets of a block's workspace by name, in numbers; ``attached`` counts masses and coils.

    Each plane, with a margin before and after it; then ``partial_sums`` of each warp, the ``totals`` computed from
    them, and the ``flags`` of the nodes. ``end`` is the size of the workspace.
    """
    margin, sums, words = nx + 1, 2 * attached + 1, -(-block.nodes // NODES_PER_WORD)
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
        "spring": effects.springs,
        "weight": effects.membrane,
        "pressure_gain": effects.attached or effects.coils or effects.travelling,
        "centre_x": effects.outline,
        "centre_y": effects.outline,
    }
    return tuple(name for name in MATERIAL_PLANES if needed.get(name, True))


def workspace_planes(effects, in_registers):
    """Return the names of the planes in a block's workspace."""
    retarded = ("retarded_u",) if effects.retarded else ()
    in_workspace = effects.membrane and "membrane_curvature" not in in_registers
    return ("u", "mx", "my", "mxy", *retarded, *(("membrane_curvature",) if in_workspace else ()))


def plan_block(nx, ny, real, effects, attached, few, shared_bytes):
    """Plan the block of a plate.

    With fewer plates than multiprocessors the time of a single plate counts, so all threads that a block can have take
    part. With many, one block should work while another waits at a barrier, and registers should hold much. Where sums
    run over the plate, their order depends on the threads: there the plan of many serves any number, so that a plate's
    bits do not depend on the number of plates.
    """
    warps = -(-nx * ny // LANES)
    words = 1 if real is wp.float32 else 2
    if few and not (effects.membrane or effects.attached or effects.coils):
        threads, blocks = LANES * min(32, warps), 1
    else:
        threads = LANES * min(32, -(-warps // 6))
        blocks = max(1, 1024 // (words * threads))
    nodes = -(-nx * ny // threads)
    registers = most_registers(-(-threads // LANES) * blocks)
    wanted = [name for name in REGISTERS_FIRST if name != "membrane_curvature" or effects.membrane]
    if nodes <= MANY_NODES:
        wanted += [*REGISTERS_NEXT, *material_planes(effects)]
    most = max(0, registers - OVERHEAD_REGISTERS) // (words * nodes) if nodes <= MOST_UNROLLED else 0
    in_registers = tuple(wanted[:most])
    block = BlockPlan(threads, nodes, in_registers, workspace_planes(effects, in_registers), True, registers)
    return replace(block, on_chip=4 * words * workspace_layout(nx, attached, block)["end"] <= shared_bytes)
