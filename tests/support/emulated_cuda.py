"""CUDA kernels run in Python, so that a machine without a GPU can compare their numbers with those of the CPU.

Each thread of a block is a Python thread. Shuffles, votes and barriers, which Warp's CPU backend lacks, wait for each
other by ``threading.Barrier``. Kernels and their functions are read again from their source, with NumPy in place of
Warp's types; launches by ``solve.cuda`` are taken over, so that its host code runs too.
"""

import ast
import inspect
import re
import textwrap
import threading
import types
from functools import cache, partial

import numpy as np
import warp as wp

LANES = 32
EMULATED = ("run_steps", "advance_tiles")  # names of kernels that need a GPU
SHARED_NUMBERS = 2**16
here = threading.local()  # block, warp, lane and tid of a thread


class Values(np.ndarray):
    """Vectors, matrices and arrays, whose rows are copies, as in Warp; those of a ``field`` are views."""

    field = False

    def __getitem__(self, index):
        part = super().__getitem__(index)
        return part.copy() if isinstance(part, Values) and not self.field else part

    def __setitem__(self, index, value):
        self.view(np.ndarray)[index] = value

    @property
    def ptr(self):
        """The address of a field."""
        return Address(self.view(np.ndarray).reshape(-1), 0)


class Address:
    """A place in a field, in bytes; with indices, the numbers from there on."""

    def __init__(self, numbers, at):
        self.numbers, self.at = numbers, at

    def __add__(self, offset):
        return Address(self.numbers, self.at + int(offset))

    def _index(self, index):
        place = self.at // self.numbers.itemsize + index
        assert 0 <= place < self.numbers.size, "outside the field"
        return place

    def __getitem__(self, index):
        return self.numbers[self._index(index)]

    def __setitem__(self, index, value):
        self.numbers[self._index(index)] = value


def exchange(value):
    """Return what each lane of the warp passes in."""
    here.warp.slots[here.lane] = value
    here.warp.barrier.wait()
    values = list(here.warp.slots)
    here.warp.barrier.wait()
    return values


def write_pair(address, pair):
    """Write two numbers to an address."""
    address[0], address[1] = pair


def copy_pair(place, address, offset, zeros):
    """Start to copy a pair from an address to a place in shared memory."""
    here.copies[-1].append((place, address + offset, zeros))


def commit_copies():
    """Make a group of the copies since the last one."""
    here.copies.append([])


def waits(pending):
    """Return ``wait_for_copies``, which lets copies arrive as late as it can: all groups but the last ``pending``."""

    def wait_for_copies():
        while len(here.copies) - 1 > pending:
            for place, address, zeros in here.copies.pop(0):
                at = Address(here.block.shared, place)
                at[0], at[1] = (0, 0) if zeros else (address[0], address[1])

    return wait_for_copies


def read_pair_if(wanted, place):
    """Return a pair in shared memory, or zeros."""
    at = Address(here.block.shared, place)
    pair = [at[0], at[1]] if wanted else [0, 0]
    return np.array(pair, here.block.shared.dtype).view(Values)


NATIVE = {
    "copy_pair": copy_pair,
    "commit_copies": commit_copies,
    "read_pair_if": read_pair_if,
    "shared_place": lambda address: address.at,
    "from_lane": lambda value, lane: exchange(value)[lane % LANES],
    "any_lane": lambda condition: any(exchange(bool(condition))),
    "barrier": lambda: here.block.barrier.wait(),
    "shared_memory": lambda: Address(here.block.shared, 0),
    "fused": lambda a, b, c: type(c)(np.float64(a) * np.float64(b) + np.float64(c)),
    "opaque": lambda value: value,
    "read_pair": lambda address: np.array([address[0], address[1]]).view(Values),
    "write_pair": write_pair,
}
WARP = types.SimpleNamespace(
    static=lambda value: value,
    tid=lambda: here.tid,
    where=lambda condition, yes, no: yes if condition else no,
    min=min,
    max=max,
    int64=int,
    uint64=lambda value: value if isinstance(value, Address) else int(value),
    tile_empty=lambda **options: None,
    array=lambda ptr, shape, dtype: ptr,
)
NUMPY = {wp.float32: np.float32, wp.float64: np.float64, wp.int32: np.int32}


class _CopyNames(ast.NodeTransformer):
    """Warp's assignments copy: ``a = b`` becomes ``a = copy_of(b)``."""

    def visit_Assign(self, node):
        if isinstance(node.value, ast.Name):
            node.value = ast.Call(ast.Name("copy_of", ast.Load()), [node.value], [])
        return node


def copy_of(value):
    """Return a copy of a vector or a matrix, and other values as they are."""
    return value.copy() if isinstance(value, Values) and not value.field else value


@cache
def in_python(function):
    """Return a kernel, or a function of Warp's, as one of Python."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = _CopyNames().visit(tree.body[0])
    definition.decorator_list = []
    for argument in definition.args.args:
        argument.annotation = None
    names = {**function.__globals__, **inspect.getclosurevars(function).nonlocals}
    space = {"copy_of": copy_of}
    exec(compile(ast.fix_missing_locations(tree), inspect.getfile(function), "exec"), space)
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    space.update({name: _converted(value) for name, value in names.items() if name in used})
    return space[definition.name]


def _converted(value):
    if value is wp:
        return WARP
    if isinstance(value, wp.Function):
        name = value.func.__name__
        if name == "wait_for_copies":
            return waits(int(re.search(r"wait_group (\d+)", value.native_snippet)[1]))
        return NATIVE[name] if name in NATIVE else in_python(value.func)
    if isinstance(value, type) and hasattr(value, "_shape_"):
        return lambda: np.zeros(value._shape_, NUMPY[value._wp_scalar_type_]).view(Values)
    return NUMPY.get(value, value) if isinstance(value, type) else value


def _argument(value):
    """Return an argument of a launch in NumPy; arrays share their memory."""
    if isinstance(value, wp.array):
        numbers = value.numpy().view(Values)
        numbers.field = True
        return numbers
    if hasattr(value, "_cls"):  # a struct
        kinds = {name: variable.type for name, variable in value._cls.vars.items()}
        fields = {name: NUMPY.get(kind, _argument)(getattr(value, name)) for name, kind in kinds.items()}
        return types.SimpleNamespace(**fields)
    if hasattr(type(value), "_shape_"):
        numbers = [value[index] if len(index) > 1 else value[index[0]] for index in np.ndindex(*value._shape_)]
        return np.array(numbers, NUMPY[value._wp_scalar_type_]).reshape(value._shape_).view(Values)
    return value.view(Values) if isinstance(value, np.ndarray) else value


def run(kernel, threads, arguments, block_dim):
    """Run a kernel's blocks one after the other."""
    function, errors = in_python(kernel.func), []
    arguments = [_argument(value) for value in arguments]
    real = type(arguments[0].stiffness)

    def work(block, warp, lane, tid):
        here.block, here.warp, here.lane, here.tid, here.copies = block, warp, lane, tid, [[]]
        try:
            with np.errstate(all="ignore"):
                function(*arguments)
        except Exception as error:
            errors.append(error)
            for barrier in (block.barrier, warp.barrier):
                barrier.abort()

    for first in range(0, threads, block_dim):
        count = min(block_dim, threads - first)
        block = types.SimpleNamespace(barrier=threading.Barrier(count), shared=np.full(SHARED_NUMBERS, np.nan, real))
        warps = [
            types.SimpleNamespace(slots=[None] * LANES, barrier=threading.Barrier(LANES)) for _ in range(count // LANES)
        ]
        places = [(block, warps[i // LANES], i % LANES, first + i) for i in range(count)]
        workers = [threading.Thread(target=work, args=place) for place in places]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        if errors:
            raise next((error for error in errors if not isinstance(error, threading.BrokenBarrierError)), errors[0])


def launch(kernel, dim, inputs=(), outputs=(), block_dim=256, record_cmd=False, **options):
    """Stand in for ``wp.launch``."""
    arguments = [*inputs, *outputs]
    if kernel.func.__name__ not in EMULATED:
        return wp.launch(kernel, dim, arguments, record_cmd=record_cmd, **options)
    start = partial(run, kernel, dim, arguments, block_dim)
    return types.SimpleNamespace(launch=start, set_param_at_index=arguments.__setitem__) if record_cmd else start()
