"""Plates that are not the same sheet everywhere: thickness, stiffness and density that vary, and layers.

    U = ½ ∫ D ((u_xx + u_yy)² − 2(1 − ν)(u_xx u_yy − u_xy²)) dA,   T = ½ ∫ m u̇² dA

with D = D₀ E H³ and m = m₀ ρ H, where E, H and ρ are the factors: by splines, without a grid. Of the in-plane energy,
Berger keeps ½∫ C e² dA, e = U_x + V_y + ½|∇u|². Among all U and V that vanish at the edges it is least where C e = N is
the same everywhere, and then N ∫ dA/C = ½∫ |∇u|² dA.
"""

import math

import numpy as np
import pytest

from support.grid_modes import natural_modes
from support.scenes import refusal, refused
from warp_plate import Scene, SceneError
from warp_plate.effects.effect import IN_PLANE, SLOPE, Edge, Term
from warp_plate.effects.foundation import Foundation
from warp_plate.modal.assemble import make_space
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.bending import make_bending
from warp_plate.plate.files import read_numbers, read_table
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.section import laminate_of
from warp_plate.plate.weights import node_positions

SIZE, NODES = (0.2, 0.18), (13, 11)
# The tests' plate; density: per area.
YOUNG, RATIO, THICKNESS, DENSITY = 1e9, 0.33, 5e-4, 0.5
PLANE = 1 - RATIO**2
RIGIDITY, SHEET = YOUNG * THICKNESS**3 / 12 / PLANE, YOUNG * THICKNESS / PLANE
LAYER = {"thickness": 3e-4, "young_modulus": 4e9, "density": 1800.0}
FACES = 2 * LAYER["young_modulus"] * LAYER["thickness"] / PLANE
TAPERS = {
    "thickness along both": (("clamped", "free", "supported", "clamped"), {"thickness": [[0.7, 1.2], [1.0, 1.5]]}),
    "cantilever": (("clamped", "free", "free", "free"), {"thickness": [[1.5, 0.5]]}),
    "all": (
        ("supported", "clamped", "free", "supported"),
        {"thickness": [[1.2, 0.8]], "young_modulus": [[2.0, 1.0], [1.0, 1.0]], "density": [[1.0], [2.0]]},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TAPERS)
def test_frequencies_of_tapered_plates(scene, name):
    edges, tables = TAPERS[name]
    exact = solve_modes(scene(NODES, SIZE, edges, effects={"variation": tables}), count=6).frequencies[:6]
    errors = []
    for nodes in ((21, 19), (41, 37)):
        found = natural_modes(scene(nodes, SIZE, edges, effects={"variation": tables}), 6).frequencies
        errors.append(np.abs(found / exact - 1))
    assert errors[1].max() < 0.013
    assert (errors[1] < 0.27 * errors[0] + 2e-5).all()  # 2e-5: of lower order, near corners of clamped and free edges


@pytest.mark.parametrize("area", [(0.0, 0.1, 0.0, 0.18), (0.031, 0.115, 0.05, 0.13)])
def test_compliance_of_a_patch(scene, area):
    """Mass is weighted by area, wherever the layer's edges cut cells."""
    made = make_bending(scene(NODES, SIZE, effects={"layers": [{"area": area, "both": True, **LAYER}]}))
    part = (area[1] - area[0]) * (area[3] - area[2]) / (SIZE[0] * SIZE[1])
    mean = 1 / (part / (SHEET + FACES) + (1 - part) / SHEET)
    np.testing.assert_allclose(made.stretch, mean, rtol=1e-12)
    assert made.stretch_ratio == 1
    assert made.berger == pytest.approx(mean / (2 * SIZE[0] * SIZE[1]), rel=1e-12)


def test_thickness_and_modulus_that_vary(scene):
    """C = C₀ E H: the mean of 1/(1 + x) from 0 to 1 is ln 2, of second order in the spacing."""
    mean_of_ramp = 1 / math.log(2)
    ramps = (({"thickness": [[1.0, 2.0]]}, mean_of_ramp), ({"young_modulus": [[2.0], [4.0]]}, 2 * mean_of_ramp))
    for tables, mean in ramps:
        made = [make_bending(scene((cells + 1, cells + 1), SIZE, effects={"variation": tables})) for cells in (12, 24)]
        errors = [plate.stretch[1] / (SHEET * mean) - 1 for plate in made]
        assert abs(errors[0]) < 1e-3
        assert abs(errors[1]) < 0.26 * abs(errors[0])
    density = make_bending(scene(NODES, SIZE, effects={"variation": {"density": [[0.5, 2.0]]}}))
    np.testing.assert_allclose(density.stretch, SHEET, rtol=1e-12)


def test_an_orthotropic_sheet_with_layers_and_variation(scene):
    """12 D/H² along each axis, with its thickness and modulus, plus the layers."""
    rigidities = {"Dx": 0.02, "Dy": 0.005, "D1": 0.002, "Dxy": 0.004}
    bare = make_bending(scene(NODES, SIZE, effects={"orthotropic": rigidities}))
    np.testing.assert_allclose(bare.stretch, [12 * 0.02 / THICKNESS**2, 12 * 0.005 / THICKNESS**2], rtol=1e-12)
    assert bare.stretch_ratio == pytest.approx(0.5)
    layer = {"area": (0, SIZE[0], 0, SIZE[1]), "both": True, **LAYER}
    variation = {"thickness": [[2.0]], "young_modulus": [[3.0]]}
    tables = {"orthotropic": rigidities, "layers": [layer], "variation": variation}
    whole = make_bending(scene(NODES, SIZE, effects=tables))
    np.testing.assert_allclose(whole.stretch, 6 * np.array(bare.stretch) + FACES, rtol=1e-12)


def test_a_plate_with_layers_on_both_faces(scene):
    """D = ∫ E z² dz/(1 − ν²) over plate and layers, on thickness 2 H of a scene or of its variation."""
    layer = {"area": (0, SIZE[0], 0, SIZE[1]), "both": True, **LAYER}
    plate = {"size": SIZE, "poisson_ratio": RATIO, "thickness": 2 * THICKNESS, "young_modulus": YOUNG, "density": 1e3}
    middle = THICKNESS + LAYER["thickness"] / 2
    rigidity = 8 * RIGIDITY + FACES * (LAYER["thickness"] ** 2 / 12 + middle**2)
    inside = (slice(1, -1), slice(1, -1))
    thicker = scene(NODES, SIZE, effects={"layers": [layer]}, plate=plate)
    varied = scene(NODES, SIZE, effects={"layers": [layer], "variation": {"thickness": [[2.0]]}})
    for made in map(make_bending, (thicker, varied)):
        np.testing.assert_allclose(made.bend_xx[inside], rigidity, rtol=1e-12)
        np.testing.assert_allclose(made.bend_xy[inside], RATIO * rigidity, rtol=1e-12)
        np.testing.assert_allclose(made.twist, 2 * (1 - RATIO) * rigidity, rtol=1e-12)
        np.testing.assert_allclose(made.mass, 2 * DENSITY + 2 * LAYER["density"] * LAYER["thickness"], rtol=1e-12)


def in_folder(folder, scene, content):
    """Return the scene from a file whose variation of thickness is in another file beside it."""
    (folder / "a.csv").write_text(content, encoding="utf-8")
    text = f'{scene.to_toml()}\n[effects.variation]\nthickness = "a.csv"\n'
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return Scene.load(folder / "scene.toml")


def thickness_at_nodes(scene):
    return laminate_of(scene).factors_at(*node_positions(scene))["thickness"]


def test_rows_of_a_file_lie_along_y(scene, tmp_path):
    """First row at y = 0, first column at x = 0, edge to edge, as for an array in the scene; copies find it too."""
    rows = [[1.0, 1.1, 1.2], [1.3, 1.5, 1.9]]
    made = in_folder(tmp_path, scene((5, 9), SIZE), "# factors\n" + "\n".join(",".join(map(str, row)) for row in rows))
    found = thickness_at_nodes(made)
    assert found.shape == (9, 5)
    np.testing.assert_allclose(found[[0, 0, 0, -1, -1, 4], [0, 2, -1, 0, 3, 0]], [1.0, 1.1, 1.2, 1.3, 1.7, 1.15])
    inline = scene((5, 9), SIZE, effects={"variation": {"thickness": rows}})
    np.testing.assert_array_equal(found, thickness_at_nodes(inline))
    assert thickness_at_nodes(made.with_tables(grid={"nodes": (9, 17)})).shape == (17, 9)
    with pytest.raises(SceneError, match="its folder is unknown"):
        make_scheme(scene(effects={"variation": {"density": "a.csv"}}))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("x,y\n", "holds no numbers"),
        ("1,2\n3\n", "decimal points: the number of columns changed from 2 to 1 at row 2"),
        ("x,y\n\n1,2\n# b\n3\n", "the number of columns changed from 2 to 1 at row 5"),
        ("# a\nx,y\n\n1,2\n1,b\n1,2\n", "could not convert string 'b' to float64 at row 5, column 2"),
        ("x,y\r\n1,2\r\n1,nan\r\n", "row 3, column 2: nan is no number from 0.001 to 1000"),
        ("1,2\n1,nan\n", "row 2, column 2: nan is no number from 0.001 to 1000"),
        ("1,99\n", "0.0495 m is not thin for a side of 0.18 m"),
    ],
)
def test_bad_files_are_refused_on_one_line(scene, tmp_path, content, why):
    line = refused(make_scheme, in_folder(tmp_path, scene(NODES, SIZE), content))
    assert line.startswith("effects.variation.thickness = 'a.csv': ")
    assert why in line


def test_tables_are_bounded_and_kept_unchanged(tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n")
    assert not read_table("key", "a.csv", tmp_path, 0, 9).flags.writeable
    with pytest.raises(ValueError, match=r"^4194305 rows; at most 4194304 are read$"):
        read_numbers(b"1\n" * (2**22 + 1))
    for cell in (b"", b"a", b"1"):
        with pytest.raises(ValueError, match=r"^65537 columns; at most 65536 are read$"):
            read_numbers(b";".join([cell] * (2**16 + 1)))


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("", "no array is given"),
        ("thickness = '../a.csv'", "not the name of a .csv file"),
        ("thickness = [[1, 2], [1]]", "its rows differ in length"),
        ("thickness = [[1, -2.0]]", "effects.variation.thickness[0][1] = -2.0"),
    ],
)
def test_bad_tables_are_refused(scene, table, why):
    assert why in refusal(f"{scene().to_toml()}\n[effects.variation]\n{table}\n")


def with_term(plate, *term, **options):
    """Return a scene with an effect of one term."""
    effect = type("OneTerm", (Foundation,), {"terms": lambda self, plate: [Term(*term, **options)]})(stiffness=1.0)
    return plate.model_copy(update={"effects": plate.effects.model_copy(update={"foundation": effect})})


@pytest.mark.parametrize(
    ("role", "options"),
    [
        ("damping", {"place": Edge("left")}),
        ("mass", {"factors": ("x", "x")}),
        ("stiffness", {"factors": ("xx", "yy")}),
        ("stiffness", {"multiple_of": "bending"}),
        ("stiffness", {"factors": IN_PLANE[0], "place": Edge("left")}),
    ],
)
def test_terms_that_the_grid_does_not_have_are_refused(scene, role, options):
    assert "foundation has no term on a grid" in refused(make_scheme, with_term(scene(), role, 1.0, **options))


@pytest.mark.parametrize(("term", "why"), [(("stiffness", 1.0, SLOPE), "Edge"), (("hysteretic", 0.1), "multiple_of")])
def test_terms_that_no_engine_has_are_refused(term, why):
    with pytest.raises(ValueError, match=f"Term of {term[0]}: .*{why}"):
        Term(*term)


def test_mass_of_a_term_counts_in_both_engines(scene):
    bare, heavy = scene(), with_term(scene(), "mass", 3.0)
    on_grid = make_bending(heavy).mass - make_bending(bare).mass
    np.testing.assert_allclose(on_grid, 3.0)
    width, height = bare.plate.size
    by_modes = make_space(heavy, (2, 2)).plate_mass - make_space(bare, (2, 2)).plate_mass
    assert by_modes == pytest.approx(3.0 * width * height)
