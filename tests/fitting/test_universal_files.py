"""Universal files as programs write them: directions, units, order and kinds of datasets; text written here."""

import struct

import numpy as np
import pytest

from support.scenes import refused
from warp_plate.fitting.measured_modes import read_modes
from warp_plate.fitting.measured_responses import read_responses
from warp_plate.scene.fit import Fit, Measurement

pytest.importorskip("pyuff")

HERTZ, VALUES = np.array([10.0, 20.0, 30.0]), np.array([1 + 2j, -3 + 0.5j, 0.25 - 4j])
OMEGA, GRAVITY = 2j * np.pi * HERTZ, 9.80665
FREE = {"plate.density": (1.0, 2.0)}
ROWS = [Measurement(force_at=(0.25, 0.18), point=point) for point in ((0.22, 0.05), (0.12, 0.15))]
NODES = {1: (0.22, 0.05), 2: (0.12, 0.15), 3: (0.25, 0.18)}
LINES = "         1         3         0\nNONE\n         1         2         3\n"
HEADER = "x\nNONE\nprogram\n" + "x\n" * 4


def dataset(number, body):
    return f"    -1\n{number:6d}\n{body}    -1\n"


def function(values=VALUES, ends=(1, 3, 3, 3), code=12, per=13, labels=("m/s2", "N"), kind=4, start=10.0, binary=False):
    """Return a dataset 58 of values that are 10 Hz apart, or one of binary numbers."""
    node, way, driven, force_way = ends
    real = not np.iscomplexobj(values)
    head = f"{kind:5d}{0:10d}{1:5d}{0:10d} {'NONE':<10s}{node:10d}{way:4d} {'NONE':<10s}{driven:10d}{force_way:4d}\n"
    head += f"{2 if real else 5:10d}{len(values):10d}{1:10d}{start:13.5e}{10.0:13.5e}{0:13.5e}\n"
    axes = ((18, "Hz"), (code, labels[0]), (per, labels[1]), (0, "NONE"))
    head += "".join(f"{axis:10d}{0:5d}{0:5d}{0:5d} {'x':<20s} {label:<20s}\n" for axis, label in axes)
    numbers = values if real else np.stack([values.real, values.imag], axis=1).ravel()
    if binary:
        data = struct.pack(f"<{len(numbers)}f", *numbers)
        first = f"    -1\n    58b     1     2          11{len(data):12d}     0     0           0           0\n"
        return (first + "NONE\n" * 5 + head).encode() + data + b"\n    -1\n"
    lines = ["".join(f"{number:13.5e}" for number in numbers[at : at + 6]) for at in range(0, len(numbers), 6)]
    return dataset(58, "NONE\n" * 5 + head + "\n".join(lines) + "\n")


def nodes(places=NODES, kind=15, system=0, moved=0):
    """Return nodes whose coordinates and displacements are in coordinate systems."""
    heads = {n: f"{n:10d}{system:10d}{moved:10d}{8:10d}" for n in places}
    three = {n: (*place, 0.0)[:3] for n, place in places.items()}
    if kind == 2411:
        lines = (f"{heads[n]}\n{x:25.16E}{y:25.16E}{z:25.16E}\n".replace("E", "D") for n, (x, y, z) in three.items())
    else:
        lines = (f"{heads[n]}{x:13.5e}{y:13.5e}{z:13.5e}\n" for n, (x, y, z) in three.items())
    return dataset(kind, "".join(lines))


def system_18(number, origin, axes, reference=0, kind=0):
    """Return a dataset 18 of a system whose axes are rows; the points on its axes are at any distance."""
    along, beside = np.add(origin, 2 * axes[0]), np.add(origin, 0.3 * axes[0] + 0.7 * axes[2])
    lines = "".join(f"{value:13.5e}" for value in (*origin, *along)) + "\n" + "".join(f"{v:13.5e}" for v in beside)
    return dataset(18, f"{number:10.0f}{kind:10d}{reference:10d}{8:10d}{1:10d}\nname\n{lines}\n")


def system_2420(number, origin, axes, kind=0):
    rows = "".join("".join(f"{value:25.16e}" for value in row).replace("e", "D") + "\n" for row in (*axes, origin))
    return dataset(2420, f"{1:10d}\npart\n{number:10d}{kind:10d}{8:10d}\nname\n{rows}")


def local(origin, axes, places=NODES):
    """Return the coordinates of places in a system."""
    return {n: np.array(axes) @ ((*place, 0.0) - np.array(origin)) for n, place in places.items()}


EYE = np.eye(3)
# Turned by 90° and 180° about z, and the back of the panel, where x and z are reversed.
QUARTER, HALF, BACK = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), np.diag([-1.0, -1, 1]), np.diag([-1.0, 1, -1])
CENTRE = (0.15, 0.1, 0.0)


def units(length, force=1.0):
    factors = f"{length:25.17e}{force:25.17e}{1:25.17e}\n{0:25.17e}\n".replace("e", "D")
    return dataset(164, f"{9:10d}{'USER':<20s}{2:10d}\n{factors}")


BOTH = function(2 * VALUES, (2, 3, 3, 3)) + function()
FILES = {
    "plain": function(),
    "minus at the force": function(-VALUES, (1, 3, 3, -3)),
    "minus at the sensor": function(-VALUES, (1, -3, 3, 3)),
    "minus at both ends": function(VALUES, (1, -3, 3, -3)),
    "in the plane first": function(7 * VALUES, (1, 1, 3, 3)) + function(),
    "minus Y beside": function(7 * VALUES, (1, -2, 3, 3)) + function() + function(7 * VALUES, (1, 4, 3, 3)),
    "driven in the plane": function(7 * VALUES, (1, 3, 3, 1)) + function(),
    "along Y at both ends": function(VALUES, (1, 2, 3, 2)),
    "along minus X": function(-VALUES, (1, 1, 3, -1)),
    "without directions": function(VALUES, (1, 0, 3, 0)),
    "velocity": function(VALUES / OMEGA, code=11, labels=("m/s", "N")),
    "displacement": function(VALUES / OMEGA**2, code=8, labels=("NONE", "NONE")),
    "velocity by its unit": function(1e6 * VALUES / OMEGA, code=0, labels=("mm/s", "kN")),
    "gravity": function(VALUES / GRAVITY, labels=("g", "N")),
    "gravity per force": function(VALUES / GRAVITY, code=1, per=0, labels=("(g)/N", "NONE")),
    "no units": function(VALUES, code=0, per=0, labels=("NONE", "NONE")),
    "millimetres": units(1e3) + function(1e3 * VALUES, labels=("NONE", "NONE")),
    "millimetres, millinewtons": units(1e3, 1e3) + function(VALUES, labels=("NONE", "NONE")),
    "label before units": units(1e3) + function(),
    "time record": function() + function(np.arange(9.0), kind=1, code=12, per=0, start=0.0),
    "spectra": "".join(function(np.arange(5.0), kind=kind) for kind in (2, 3, 12)) + function(),
    "other datasets": dataset(151, HEADER) + dataset(82, LINES) + dataset(2429, "odd\n") + function(),
    "binary": function(binary=True),
    "binary and text": function(np.arange(9.0), kind=1, binary=True) + function().encode(),
}  # fmt: skip


def written(tmp_path, content, name="a.uff"):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return tmp_path / name


@pytest.mark.parametrize("name", FILES)
def test_one_response(name, tmp_path):
    found = read_responses(written(tmp_path, FILES[name]), 1, rows=ROWS[:1])
    np.testing.assert_array_equal(found.frequencies, HERTZ)
    np.testing.assert_allclose(found.responses, [VALUES], rtol=1e-5)
    assert len(found.remarks) == (name.startswith(("velocity", "displacement")))


@pytest.mark.parametrize(
    ("content", "fit"),
    [
        (nodes() + BOTH, {}),
        (nodes(kind=2411) + BOTH, {}),
        (nodes() + function(5 * VALUES, (3, 3, 3, 3)) + BOTH, {}),
        (nodes() + function(2 * VALUES, (3, 3, 2, 3)) + function(VALUES, (3, 3, 1, 3)), {}),
        (nodes() + function(-2 * VALUES, (2, -3, 3, 3)) + function(7 * VALUES, (1, 1, 3, 3)) + function(), {}),
        (units(1e3) + nodes({n: (1e3 * x, 1e3 * y) for n, (x, y) in NODES.items()}) + BOTH, {}),
        (nodes({n: (1e3 * x, 1e3 * y) for n, (x, y) in NODES.items()}) + BOTH, {"unit": "mm"}),
        (nodes({n: (x - 0.15, y - 0.1) for n, (x, y) in NODES.items()}) + BOTH, {"origin": (0.15, 0.1)}),
        (function() + function(2 * VALUES, (2, 3, 3, 3)), {}),
    ],
    ids=["15", "2411", "driven point beside", "reciprocal", "minus", "164", "unit", "centred", "no places"],
)  # fmt: skip
@pytest.mark.parametrize("name", ["a.uff", "a.unv", "a.UFB"])
def test_responses_are_matched_to_sensors(content, fit, name, tmp_path):
    found = read_responses(written(tmp_path, content, name), 2, Fit(free=FREE, **fit), ROWS)
    np.testing.assert_allclose(found.responses, [VALUES, 2 * VALUES], rtol=1e-5)


@pytest.mark.parametrize("kind", [15, 2411])
@pytest.mark.parametrize(
    ("systems", "origin", "axes"),
    [
        (system_2420(5, CENTRE, EYE), CENTRE, EYE),
        (system_2420(5, CENTRE, QUARTER), CENTRE, QUARTER),
        (system_2420(5, CENTRE, BACK), CENTRE, BACK),
        (system_18(5, CENTRE, EYE), CENTRE, EYE),
        (system_18(5, CENTRE, QUARTER), CENTRE, QUARTER),
        (system_18(2, CENTRE, QUARTER) + system_18(5, (0.1, -0.05, 0.0), QUARTER, 2), (0.2, 0.2, 0.0), HALF),
    ],
    ids=["centred", "turned", "back", "centred 18", "turned 18", "18 in another"],
)  # fmt: skip
def test_coordinate_systems(systems, origin, axes, kind, tmp_path):
    """Nodes are placed by their systems; on the back of the panel +Z is −Z."""
    sign = axes[2][2]
    content = systems + nodes(local(origin, axes), kind, 5, 5)
    content += function(2 * VALUES, (2, 3, 3, 3)) + function(sign * VALUES, (1, int(3 * sign), 3, 3))
    found = read_responses(written(tmp_path, content), 2, Fit(free=FREE), ROWS)
    np.testing.assert_allclose(found.responses, [VALUES, 2 * VALUES], rtol=1e-5)
    modes = read_modes(written(tmp_path, systems + nodes(local(origin, axes), kind, 5, 5) + normal_mode(80.0, SHAPE)))
    np.testing.assert_allclose(modes.points, list(NODES.values()), rtol=1e-5)
    np.testing.assert_allclose(modes.shapes, [[sign * value for value in SHAPE.values()]], rtol=1e-5)


@pytest.mark.parametrize(
    ("systems", "moved", "message"),
    [
        (system_2420(5, CENTRE, EYE, 1), 0, "node 1 is in coordinate system 5, which is not Cartesian"),
        (system_18(5, CENTRE, EYE, 0, 2), 0, "node 1 is in coordinate system 5, which is not Cartesian"),
        (system_2420(5, CENTRE, [[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]]), 5, "a direction that is oblique"),
    ],
)  # fmt: skip
def test_other_coordinate_systems_are_refused(systems, moved, message, tmp_path):
    content = systems + nodes(NODES, 15, 5, moved) + BOTH
    assert message in refused(read_responses, written(tmp_path, content), 2, None, ROWS)


def test_files_with_their_own_origin_and_unit(tmp_path):
    """Each of two files has its coordinates; those of [fit] are for tables that state none."""
    millimetres = {n: (1e3 * (x - 0.15), 1e3 * (y - 0.1)) for n, (x, y) in NODES.items()}
    one = written(tmp_path, nodes(millimetres) + BOTH, "one.uff")
    other = written(tmp_path, nodes({n: (x - 0.02, y) for n, (x, y) in NODES.items()}) + BOTH, "two.uff")
    rows = [ROWS[1].model_copy(update={"origin": (0.15, 0.1), "unit": "mm"}), ROWS[0]]
    found = read_responses([one, other], 2, Fit(free=FREE, origin=(0.02, 0.0)), rows)
    np.testing.assert_allclose(found.responses, [2 * VALUES, VALUES], rtol=1e-5)


def test_coherences_follow_their_responses(tmp_path):
    ends = ((2, 3, 3, 3), (1, 3, 3, 3))
    each = [function(np.full(3, 0.5 + 0.1 * index), ends[index], kind=6) for index in (0, 1)]
    for content in (BOTH + each[0] + each[1], function(VALUES, (1, 1, 3, 3)) + each[1] + BOTH + each[0]):
        found = read_responses(written(tmp_path, nodes() + content), 2, rows=ROWS)
        np.testing.assert_allclose(found.coherence, [[0.6] * 3, [0.5] * 3])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (function(VALUES, code=12, labels=("m/s", "N")), "states acceleration (type 12), but its unit m/s is"),
        (function(VALUES, code=13), "1+Z/3+Z has ordinates of type 13; 8, 11 and 12 are motions"),
        (function(VALUES, per=12), "is per ordinate of type 12; 13 is a force"),
        (function(np.ones(3)), "is real; a response has real and imaginary parts"),
        (function(VALUES, (1, 1, 3, 2)), "has no response across the plate, along Z at both ends; it has 1+X/3+Y"),
        (BOTH, "has 2 responses across the plate (2+Z/3+Z, 1+Z/3+Z); the scene has 1 tables [[measurement]]"),
        (nodes({1: (9.0, 9.0), 2: (8.0, 9.0)}) + BOTH, "no responses are at measurement[0] (point = [0.22, 0.05]"),
        (nodes() + function() + function(), "2 responses are at measurement[0]"),
        (function(np.arange(9.0), kind=1), "has no frequency response"),
        (units(-1.0) + function(), "dataset 164: factors of length and force must be above 0"),
        (nodes().replace(f"{1:10d}", "       inf", 1) + BOTH, "dataset 15: the row of node inf has a number"),
        (system_18(np.inf, (0, 0, 0), np.eye(3)) + nodes() + BOTH, "dataset 18 has a number that is not finite"),
    ],
)  # fmt: skip
def test_contradictions_are_refused(content, message, tmp_path):
    assert message in refused(read_responses, written(tmp_path, content), 1, None, ROWS[:1])


def test_datasets_without_end(tmp_path, monkeypatch):
    """Empty ones take 0.8 s for a megabyte."""
    monkeypatch.setattr("warp_plate.fitting.measured_universal.MOST_SETS", 3)
    path = written(tmp_path, dataset(15, "") * 4 + nodes() + BOTH)
    assert "has 7 datasets; at most 3 are read" in refused(read_responses, path, 2, None, ROWS)


def normal_mode(frequency, shape, damping=0.0, loss=0.0):
    head = f"{1:10d}{2:10d}{2:10d}{8:10d}{2:10d}{3:10d}\n{2:10d}{4:10d}{0:10d}{1:10d}\n"
    head += f"{frequency:13.5e}{1:13.5e}{damping:13.5e}{loss:13.5e}\n"
    rows = (f"{n:10d}\n{0:13.5e}{0:13.5e}{r:13.5e}\n" for n, r in shape.items())
    return dataset(55, "NONE\n" * 5 + head + "".join(rows))


def complex_mode(pole, shape):
    head = f"{1:10d}{3:10d}{2:10d}{8:10d}{5:10d}{3:10d}\n{2:10d}{6:10d}{0:10d}{1:10d}\n"
    head += f"{pole.real:13.5e}{pole.imag:13.5e}" + f"{0:13.5e}" * 4 + "\n"
    rows = (f"{n:10d}\n" + f"{0:13.5e}" * 4 + f"{r.real:13.5e}{r.imag:13.5e}\n" for n, r in shape.items())
    return dataset(55, "NONE\n" * 5 + head + "".join(rows))


def mode_2414(frequency, shape, damping):
    head = f"{1:10d}\nNONE\n{1:10d}\n" + "NONE\n" * 5 + f"{1:10d}{2:10d}{2:10d}{8:10d}{2:10d}{3:10d}\n"
    head += f"{0:10d}" * 8 + "\n" + f"{0:10d}" * 8 + "\n"
    head += "".join(f"{value:13.5e}" for value in (0, frequency, 0, 1, damping, 0)) + "\n" + f"{0:13.5e}" * 6 + "\n"
    return dataset(2414, head + "".join(f"{n:10d}\n{0:13.5e}{0:13.5e}{r:13.5e}\n" for n, r in shape.items()))


POLE = 2 * np.pi * 80 * (-0.02 + 1j * np.sqrt(1 - 0.02**2))
SHAPE = {1: 0.5, 2: -1.0, 3: 2.0}


@pytest.mark.parametrize(
    ("content", "damping"),
    [
        (normal_mode(80.0, SHAPE, 0.02), 0.02),
        (normal_mode(80.0, SHAPE, loss=0.04), 0.02),
        (normal_mode(80.0, SHAPE), np.nan),
        (normal_mode(0.0, SHAPE) + normal_mode(80.0, SHAPE, 0.02), 0.02),
        (complex_mode(POLE, SHAPE), 0.02),
        (complex_mode(1j * abs(POLE), SHAPE), np.nan),
        (mode_2414(80.0, SHAPE, 0.02), 0.02),
    ],
    ids=["viscous", "hysteretic", "undamped", "rigid", "complex", "real part 0", "2414"],
)
@pytest.mark.parametrize("kind", [15, 2411])
def test_modes(content, damping, kind, tmp_path):
    found = read_modes(written(tmp_path, nodes(kind=kind) + content, "a.unv"))
    np.testing.assert_allclose(found.frequencies, [80.0], rtol=1e-5)
    np.testing.assert_allclose(found.damping, [damping], rtol=1e-4)
    np.testing.assert_allclose(found.shapes, [list(SHAPE.values())], rtol=1e-5)
    np.testing.assert_allclose(found.points, list(NODES.values()), rtol=1e-5)


def test_shapes_that_are_not_finite_are_refused_without_warnings(tmp_path):
    mode = normal_mode(80.0, SHAPE).replace(f"{0:13.5e}" * 2 + f"{0.5:13.5e}", f"{np.inf:13.5e}{0:13.5e}{0.5:13.5e}")
    path = written(tmp_path, nodes() + mode, "a.unv")
    assert "shape in a mode (dataset 55): must be a number of at most" in refused(read_modes, path)
