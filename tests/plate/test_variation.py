"""Thickness, stiffness and density that vary over the plate: against Ritz's method, and damaged files.

    U = ½ ∫ D ((u_xx + u_yy)² − 2(1 − ν)(u_xx u_yy − u_xy²)) dA,   T = ½ ∫ m u̇² dA

with D = D₀ E H³ and m = m₀ ρ H, where E, H and ρ are the factors: in polynomials (``reference.ritz``) and by Gauss's
rule, without a grid.
"""

import math

import numpy as np
import pytest
import scipy.linalg
from numpy.polynomial import legendre

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.bending import make_bending
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.section import factors_at_nodes
from warp_plate.reference.ritz import make_line
from warp_plate.scene.dump import dump_scene

SIZE, NODES = (0.2, 0.18), (13, 11)
FUNCTIONS, POINTS = 18, 30
RIGIDITY, RATIO, DENSITY = 1e9 * 5e-4**3 / 12 / (1 - 0.33**2), 0.33, 0.5  # the tests' plate; density: per area
TAPERS = {
    "thickness along both": (("clamped", "free", "supported", "clamped"), {"thickness": [[0.7, 1.2], [1.0, 1.5]]}),
    "cantilever": (("clamped", "free", "free", "free"), {"thickness": [[1.5, 0.5]]}),
    "all": (
        ("supported", "clamped", "free", "supported"),
        {"thickness": [[1.2, 0.8]], "young_modulus": [[2.0, 1.0], [1.0, 1.0]], "density": [[1.0], [2.0]]},
    ),
}  # fmt: skip


def between_corners(corners, x, y):
    """Return bilinear values; x, y: from 0 to 1."""
    (a, b), (c, d) = np.broadcast_to(np.array(corners), (2, 2))
    return np.outer(1 - y, (1 - x) * a + x * b) + np.outer(y, (1 - x) * c + x * d)


def ritz_frequencies(edges, tables, count):
    """Return the lowest frequencies [Hz], by a basis of polynomials and Gauss's rule."""
    lines = [make_line(SIZE[axis], edges[axis], edges[axis + 2], FUNCTIONS) for axis in (0, 1)]
    s, weights = legendre.leggauss(POINTS)
    part = (1 + s) / 2
    stiff, mass = np.full((POINTS, POINTS), RIGIDITY), np.full((POINTS, POINTS), DENSITY)
    for key, corners in tables.items():
        factor = between_corners(corners, part, part)
        stiff *= {"thickness": factor**3, "young_modulus": factor, "density": 1.0}[key]
        mass *= {"thickness": factor, "young_modulus": 1.0, "density": factor}[key]

    def derivative(along_x, along_y):
        x, y = (line.values(part * line.length, order) for line, order in zip(lines, (along_x, along_y), strict=True))
        return np.einsum("ax,by->baxy", x, y).reshape(FUNCTIONS**2, POINTS, POINTS).swapaxes(1, 2)

    area = np.outer(weights, weights) * SIZE[0] * SIZE[1] / 4

    def integral(first, second, field):
        return np.einsum("myx,nyx,yx->mn", first, second, field * area, optimize=True)

    xx, yy, xy, u = derivative(2, 0), derivative(0, 2), derivative(1, 1), derivative(0, 0)
    cross = integral(xx, yy, stiff)
    energy = integral(xx + yy, xx + yy, stiff) + (1 - RATIO) * (2 * integral(xy, xy, stiff) - cross - cross.T)
    squares = scipy.linalg.eigh(energy, integral(u, u, mass), eigvals_only=True, subset_by_index=[0, count - 1])
    return np.sqrt(squares) / (2 * math.pi)


@pytest.mark.parametrize("name", TAPERS)
def test_frequencies_of_tapered_plates_by_ritz(scene, name):
    """Six frequencies, of second order in the spacing."""
    edges, tables = TAPERS[name]
    exact, errors = ritz_frequencies(edges, tables, 6), []
    for nodes in ((21, 19), (41, 37)):
        found = natural_modes(scene(nodes, SIZE, edges, effects={"variation": tables}), 6).frequencies
        errors.append(np.abs(found / exact - 1))
    assert errors[1].max() < 0.013
    assert (errors[1] < 0.27 * errors[0] + 2e-5).all()  # 2e-5: the corners' part in Ritz's sums


def test_factors_everywhere_are_another_plate(scene, device, path):
    """The same motion as a plate of that thickness, modulus and density."""
    plate = {"size": SIZE, "poisson_ratio": RATIO, "thickness": 7e-4, "young_modulus": 5e8, "density": 1300.0}
    tables = {"thickness": [[1.4]], "young_modulus": [[0.5], [0.5]], "density": [[1.3, 1.3, 1.3]]}
    edges = ("clamped", "free", "supported", {"translation": 1e4, "rotation": 0.05})
    other = scene(NODES, SIZE, edges, 40.0, plate=plate)
    step = make_scheme(other).time_step * 0.9
    damping = {"damping": {"viscous": 40.0}}
    varied = scene(NODES, SIZE, edges, effects={**damping, "variation": tables}, time_step=step)
    other = scene(NODES, SIZE, edges, effects=damping, plate=plate, time_step=step)
    drives = np.array([[1, 0.3j, -0.5]])
    found, right = (PlateSolver(made, device, path).run(drives, (0.004, 0.01)) for made in (varied, other))
    tolerance = 1e-10 * np.abs(right.displacement).max()
    np.testing.assert_allclose(found.displacement, right.displacement, atol=tolerance)
    np.testing.assert_allclose(found.energy, right.energy, rtol=1e-9)


def test_layers_lie_on_the_local_thickness(scene):
    """Thickness H under a layer everywhere is the laminate of H."""
    layers = [{"area": (0, SIZE[0], 0, SIZE[1]), "thickness": 3e-4, "young_modulus": 4e9, "density": 1800.0}]
    plate = {"size": SIZE, "poisson_ratio": RATIO, "thickness": 1e-3, "young_modulus": 1e9, "density": 1000.0}
    one = make_bending(scene(NODES, SIZE, effects={"layers": layers, "variation": {"thickness": [[2.0]]}}))
    other = make_bending(scene(NODES, SIZE, effects={"layers": layers}, plate=plate))
    for field in ("bend_xx", "bend_xy", "bend_yy", "twist", "mass"):
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=1e-12)


def test_backward_damping_of_a_light_place_stays_stable(scene):
    """c/ρH is largest where the plate is lightest, which sets the limit: a strongly damped plate stays small."""
    effects = {"damping": {"viscous": 3e4, "scheme": "backward"}, "variation": {"density": [[0.1, 1.0]]}}
    made = scene(NODES, SIZE, effects=effects, window=(0.0, 0.01), frequency=500.0)
    made = made.with_tables(grid={**made.grid.model_dump(), "time_step": make_scheme(made).limit * 0.999})
    run = PlateSolver(made, "cpu").run([[1.0, 1.0, 1.0]], (0.005, 0.01))
    first, last = np.abs(run.displacement[0]).max(axis=(1, 2))
    assert 0 < last < 10 * first < 1e-5


def in_folder(folder, scene, content, key="thickness"):
    """Return the scene from a file whose variation is in another file beside it."""
    (folder / "a.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    text = dump_scene(scene) + f'\n[effects.variation]\n{key} = "a.csv"\n'
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return Scene.load(folder / "scene.toml")


def test_rows_of_a_file_lie_along_y(scene, tmp_path):
    """First row at y = 0, first column at x = 0, edge to edge, as for an array in the scene; copies find it too."""
    rows = [[1.0, 1.1, 1.2], [1.3, 1.5, 1.9]]
    made = in_folder(tmp_path, scene((5, 9), SIZE), "# factors\n" + "\n".join(",".join(map(str, row)) for row in rows))
    found = factors_at_nodes(made)["thickness"]
    assert found.shape == (9, 5)
    np.testing.assert_allclose(found[[0, 0, 0, -1, -1], [0, 2, -1, 0, 3]], [1.0, 1.1, 1.2, 1.3, 1.7])
    assert found[4, 0] == pytest.approx(1.15)
    inline = scene((5, 9), SIZE, effects={"variation": {"thickness": rows}})
    np.testing.assert_array_equal(found, factors_at_nodes(inline)["thickness"])
    assert Scene.parse(dump_scene(inline), "").effects == inline.effects
    finer = made.with_tables(grid={"nodes": (9, 17)})
    assert factors_at_nodes(finer)["thickness"].shape == (17, 9)
    assert (factors_at_nodes(made)["density"] == 1).all()


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("", "holds no numbers"),
        ("x,y\n", "holds no numbers"),
        ("1,2\n3\n", "line 2 has 1 columns instead of 2 as above it"),
        ("1,2\n1,thick\n", "line 2 is not made of numbers"),
        ("1,2\n1,nan\n", "line 2, column 2: nan is no number from 0.001 to 1000"),
        ("1,0\n", "line 1, column 2: 0 is no number"),
        ("1,99\n", "0.0495 m is not thin for a side of 0.18 m"),
        (b"\xff\xfe1\x00", "not UTF-8"),
    ],
)
def test_bad_files_are_refused_on_one_line(scene, tmp_path, content, why):
    with pytest.raises(SceneError) as caught:
        make_scheme(in_folder(tmp_path, scene(NODES, SIZE), content))
    line = str(caught.value)
    assert line.startswith("effects.variation.thickness = 'a.csv': ")
    assert why in line
    assert len(line.splitlines()) == 1


def test_missing_file_and_folder(scene, tmp_path):
    made = in_folder(tmp_path, scene(NODES, SIZE), "1,2\n", "density")
    make_scheme(made)
    (tmp_path / "a.csv").unlink()
    with pytest.raises(SceneError, match=r"effects\.variation\.density = 'a\.csv': no such file"):
        make_scheme(made)
    with pytest.raises(SceneError, match="its folder is unknown"):
        make_scheme(scene(effects={"variation": {"density": "a.csv"}}))


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("", "no array is given"),
        ("thickness = '../a.csv'", "not the name of a .csv file"),
        ("density = '.csv'", "not the name of a .csv file"),
        ("thickness = [[1, 2], [1]]", "its rows differ in length"),
        ("thickness = [[1, -2.0]]", "effects.variation.thickness[0][1] = -2.0"),
    ],
)
def test_bad_tables_are_refused(scene, table, why):
    with pytest.raises(SceneError) as caught:
        Scene.parse(f"{dump_scene(scene())}\n[effects.variation]\n{table}\n", "scene.toml")
    assert why in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
