"""Targets of any shape: weights against exact areas and integrals, regions of runs, outlines, and refusals."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.scenes import PAPER, refusal, refused
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.files import digests
from warp_plate.plate.shapes import cells, clipped, lagrange, outlines, polygon_weights
from warp_plate.plate.weights import REGIONS, region_weights
from warp_plate.scene.target import Target, area_within

TARGET = REGIONS.index("target")
SIZE = (0.2, 0.15)
# A star of five points, not convex, and an L: corners [m].
ANGLES = 0.3 + np.arange(10) * math.pi / 5
RADII = np.tile([0.06, 0.028], 5)
STAR = np.column_stack([0.1 + RADII * np.cos(ANGLES), 0.07 + RADII * np.sin(ANGLES)])
L_SHAPE = np.array([(0.02, 0.01), (0.15, 0.01), (0.15, 0.05), (0.07, 0.05), (0.07, 0.13), (0.02, 0.13)])
LOADS = ("overlap", "moments")


def weights_of(scene, target, nodes=(27, 21), load="overlap"):
    return region_weights(scene(nodes, SIZE, load=load, target=target))[TARGET]


def integral_of(field, values=1.0):
    ny, nx = field.shape
    return (field * values).sum() * SIZE[0] / (nx - 1) * SIZE[1] / (ny - 1)


def middle_of(field):
    """Return x, y of the centre of area [m]."""
    x, y = (np.linspace(0, side, count) for side, count in zip(SIZE, field.shape[::-1], strict=True))
    return (field.sum(axis=0) @ x / field.sum(), field.sum(axis=1) @ y / field.sum())


@pytest.mark.parametrize(("load", "nodes"), [("overlap", (27, 21)), ("moments", (9, 9)), ("moments", (40, 64))])
def test_weights_sum_to_the_exact_area(load, nodes, scene):
    disc = weights_of(scene, {"disc": (0.08, 0.07, 0.05)}, nodes, load)
    assert integral_of(disc) == pytest.approx(math.pi * 0.05**2, rel=1e-12)
    star = weights_of(scene, {"polygon": STAR.tolist()}, nodes, load)
    # Ten triangles from the middle, of two radii and 36° between them.
    assert integral_of(star) == pytest.approx(10 * 0.06 * 0.028 * math.sin(math.pi / 5) / 2, rel=1e-12)
    bent = weights_of(scene, {"polygon": L_SHAPE.tolist()}, nodes, load)
    assert integral_of(bent) == pytest.approx(0.13 * 0.04 + 0.05 * 0.08, rel=1e-12)
    turned = weights_of(scene, {"polygon": L_SHAPE[::-1].tolist()}, nodes, load)
    np.testing.assert_allclose(turned, bent, rtol=0, atol=1e-13)
    # Rectangles have other code.
    parts = [(0.02, 0.15, 0.01, 0.05), (0.02, 0.07, 0.05, 0.13)]
    rectangles = sum(weights_of(scene, {"area": area}, nodes, load) for area in parts)
    np.testing.assert_allclose(bent, rectangles, rtol=0, atol=1e-12)
    if load == "moments":  # first moments are kept too
        assert middle_of(disc) == pytest.approx((0.08, 0.07), rel=1e-12)
        assert middle_of(star) == pytest.approx((0.1, 0.07), rel=1e-12)
    else:
        assert min(disc.min(), star.min(), bent.min()) == 0
        assert max(disc.max(), star.max(), bent.max()) <= 1 + 1e-12


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.sampled_from([cells, lambda nodes: lagrange(nodes, 4)]))
def test_parts_of_any_polygon_sum_to_it(seed, axis):
    random = np.random.default_rng(seed)
    nodes = random.integers(5, 40, 2)
    count = random.integers(4, 12)
    angles = 2 * math.pi * (np.arange(count) + random.uniform(0, 0.9, count)) / count
    reach = random.uniform(0.05, 0.5, angles.size)
    corners = (0.5 + reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])) * (nodes - 1)
    across, up = (axis(int(count)) for count in nodes)
    whole = polygon_weights(corners, across, up)
    assert whole.sum() == pytest.approx(area_within(corners), rel=1e-11)
    x, y = random.uniform(0, 1, 2) * (nodes - 1)
    quarters = [(0, x, 0, y), (x, nodes[0], 0, y), (0, x, y, nodes[1]), (x, nodes[0], y, nodes[1])]
    parts = sum(polygon_weights(clipped(corners, area), across, up) for area in quarters)
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("load", "order", "last"), [("overlap", 2, 2e-4), ("moments", 4, 1e-7)])
def test_integrals_of_a_smooth_function_fall_with_their_order(load, order, last, scene):
    """∫ exp(a x) cos(b y) over the disc is 2πR J₁(cR)/c · exp(a x₀) cos(b y₀) with c² = b² − a² (a mean value of
    Helmholtz's equation, whose solution this is)."""
    from scipy.special import j1

    x0, y0, radius, a, b = 0.09, 0.07, 0.055, 12.0, 31.0
    c = math.sqrt(b**2 - a**2)
    exact = 2 * math.pi * radius * j1(c * radius) / c * math.exp(a * x0) * math.cos(b * y0)
    errors = []
    for count in (13, 25, 49, 97):
        field = weights_of(scene, {"disc": (x0, y0, radius)}, (count, count), load)
        x, y = (np.linspace(0, side, count) for side in SIZE)
        values = np.exp(a * x) * np.cos(b * y)[:, None]
        errors.append(abs(integral_of(field, values) / exact - 1))
        # Twice the constant of the coarsest grid, for it differs from grid to grid.
        assert errors[-1] <= 2 * max(errors[0], 1e-9) * ((13 - 1) / (count - 1)) ** order
    assert errors[-1] < last


@pytest.mark.parametrize("load", LOADS)
def test_masks_of_ones_and_ramps(load, scene, tmp_path):
    np.savetxt(tmp_path / "ones.csv", np.ones((3, 4)), delimiter=",")
    np.savetxt(tmp_path / "row.csv", np.linspace(0, 1, 6)[None], delimiter=",")
    np.savetxt(tmp_path / "column.csv", np.linspace(0, 1, 2)[:, None], delimiter=",")
    made = {name: scene((14, 11), SIZE, load=load, target={"mask": f"{name}.csv"}).in_folder(tmp_path)
            for name in ("ones", "row", "column")}  # fmt: skip
    plate, ones = region_weights(made["ones"])
    np.testing.assert_allclose(ones, plate, rtol=0, atol=1e-13)
    for name, middle in (("row", (2 / 3 * 0.2, 0.075)), ("column", (0.1, 2 / 3 * 0.15))):
        field = region_weights(made[name])[TARGET]
        assert integral_of(field) == pytest.approx(0.015, rel=1e-12)
        if load == "moments":
            assert middle_of(field) == pytest.approx(middle, rel=1e-12)


def test_a_solver_takes_shapes_and_weights_as_regions(scene):
    made = scene(target={"disc": (0.1, 0.1, 0.05)})
    areas = {"same": Target(disc=(0.1, 0.1, 0.05)), "array": region_weights(made)[TARGET], "half": (0.0, 0.1, 0.0, 0.2)}
    run = PlateSolver(made, "cpu", areas=areas).run(np.ones((1, 3)))
    assert run.energy[0, 1] == run.energy[0, 2] == run.energy[0, 3]
    assert 0 < run.energy[0, 4] < run.energy[0, 0]


def test_other_shapes_are_refused_where_they_cannot_be(scene):
    with pytest.raises(SceneError, match="covers no node that can move on a grid of 13 x 13"):
        PlateSolver(scene(target={"disc": (0.1, 0.004, 0.002)}), "cpu")


NAMED_A = '[[targets]]\nname = "a"\ndisc = [0.1, 0.1, 0.05]'


def paper_with(lines):
    head, _, rest = PAPER.partition("[target]")
    return head + lines + "\n" + rest[rest.index("[record]") :]


@pytest.mark.parametrize(
    ("lines", "named", "right"),
    [
        ("[target]", "target.area: no shape is given", "area, disc, ellipse, rectangle, polygon and mask"),
        ("[target]\narea = [0.0, 0.1, 0.0, 0.1]\ndisc = [0.1, 0.1, 0.05]", "target.disc: area is given too", "one of"),
        ("[target]\ndisc = [0.1, 0.1, 0.11]", "target.disc: [0.1, 0.1, 0.11]", "radius in 0 ... 0.2"),
        ("[target]\ndisc = [0.1, 0.1, 1e-9]", "target.disc: a radius of 1e-09 m", "at least 1e-07"),
        ("[target]\npolygon = [[0, 0], [0.1, 0], [0.1, 0.3]]", "target.polygon[2]: [0.1, 0.3]", "0 ... 0.2"),
        ("[target]\npolygon = [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]", "target.polygon: the sides", "0 and 2"),
        ("[target]\npolygon = [[0, 0], [0.1, 0], [0.2, 0]]", "target.polygon: is less than 2e-07 m wide", "wider"),
        ('[target]\nmask = "../mask.csv"', "target.mask: '../mask.csv'", "without folders"),
        ("", "target: is missing", ""),
        ('[[targets]]\nname = "a"', "targets[0].area: no shape is given", "area, disc"),
        ('[[targets]]\nname = "a"\ndiscs = [0.1, 0.1, 0.05]', "targets[0].discs: unknown key", "'disc'"),
        (f"{NAMED_A}\n{NAMED_A}", "targets[1].name: 'a' is taken", "its own"),
        (f"{NAMED_A}\n[target]\narea = [0.0, 0.1, 0.0, 0.1]", "target: there are [[targets]] too", "one of the two"),
        ('[[targets]]\nname = "a/b"\ndisc = [0.1, 0.1, 0.05]', 'targets[0].name = "a/b"', "without '/'"),
    ],
)  # fmt: skip
def test_bad_shapes_are_refused(lines, named, right):
    line = refusal(paper_with(lines))
    assert line.startswith(named)
    assert right in line


@pytest.mark.parametrize(
    ("text", "right"),
    [
        (None, "no such file beside the scene file"),
        ("", "holds no numbers"),
        ("0,0\n0,0\n", "holds no number above 0"),
        ("0,1\n0,1.5\n", "row 2, column 2: 1.5 is no number from 0 to 1"),
    ],
)
def test_bad_masks_are_refused(text, right, tmp_path):
    if text is not None:
        (tmp_path / "mask.csv").write_text(text)
    (tmp_path / "panel.toml").write_text(paper_with('[target]\nmask = "mask.csv"'))
    line = refused(PlateSolver, Scene.load(tmp_path / "panel.toml"), "cpu")
    assert line.startswith("target.mask = 'mask.csv': ")
    assert right in line


def test_the_first_of_several_targets_is_the_target(tmp_path):
    shapes = {"disc": "disc = [0.1, 0.1, 0.05]", "star": f"polygon = {STAR.tolist()}", "left": 'mask = "left.csv"'}
    lines = [f'[[targets]]\nname = "{name}"\n{shape}' for name, shape in shapes.items()]
    np.savetxt(tmp_path / "left.csv", [[1, 0]], delimiter=",")
    (tmp_path / "panel.toml").write_text(paper_with("\n".join(lines)))
    made = Scene.load(tmp_path / "panel.toml")
    assert made.target == Target(disc=(0.1, 0.1, 0.05))
    assert [target.name for target in made.targets] == ["disc", "star", "left"]
    assert Scene.parse(made.to_toml(), "").in_folder(tmp_path) == made
    assert made.aimed_at(1).target.polygon == made.targets[1].polygon
    assert set(digests(made.named_files, made.folder)) == {"targets[2].mask"}
    run = PlateSolver(made, "cpu", areas={target.name: target for target in made.targets[1:]}).run(np.ones((1, 4)))
    assert (run.energy[0] > 0).all()


def test_outlines(scene, tmp_path):
    pytest.importorskip("contourpy", reason="contourpy is missing: pip install matplotlib")
    np.savetxt(tmp_path / "mask.csv", [[0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0], [1, 1, 1, 1]], delimiter=",")
    disc, bent = {"disc": (0.1, 0.07, 0.05)}, {"polygon": L_SHAPE.tolist()}
    for target, length in (({"area": (0.0, 0.1, 0.0, 0.05)}, 0.3), (disc, 0.1 * math.pi), (bent, 0.5)):
        (way,) = outlines(scene(size=SIZE, target=target))
        assert (way[0] == way[-1]).all()
        assert np.hypot(*np.diff(way, axis=0).T).sum() == pytest.approx(length, rel=1e-3)
    ways = outlines(scene(size=SIZE, target={"mask": "mask.csv"}).in_folder(tmp_path))
    assert len(ways) == 2
    assert all((way[0] == way[-1]).all() for way in ways)
    # Counterclockwise around the half of a bilinear patch: the strip along the upper side, half a spacing high.
    strip = max(ways, key=lambda way: way[:, 1].max())
    assert area_within(strip[:-1]) == pytest.approx(0.2 * 0.025, rel=1e-9)
    assert not outlines(scene(size=SIZE, target={"mask": "gone.csv"}).in_folder(tmp_path))
