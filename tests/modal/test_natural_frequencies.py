"""Natural frequencies of the modal plate within 1e-5 of independent values.

Those are exact equations of Lévy and Navier, secular equations of attached masses, and another discretisation.
"""

import itertools
import math
from functools import partial

import numpy as np
import pytest
import scipy

from support.levy import isotropic, levy_frequencies
from support.ritz_polynomials import extrapolated_frequencies, ritz_frequencies
from support.scenes import MATERIAL, SIDES, edges_id, scene_of
from warp_plate import SceneError
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.other_solutions import modes_below
from warp_plate.plate.bending import make_bending

SIZE = (0.23, 0.17)
dense_scene = partial(scene_of, modal_density=1.0)
RIGIDITY, COUPLING, _, TWIST, MASS = isotropic(**MATERIAL)
COUNT = 20
# ν = 0.33 does not tell D1 from the rigidities of twist; these have (D1 + 2Dxy)² above and below Dx Dy.
ORTHOTROPIC = [
    {"Dx": 0.02, "Dy": 0.009, "D1": 0.004, "Dxy": 0.007},
    {"Dx": 0.008, "Dy": 0.03, "D1": -0.002, "Dxy": 0.003},
]
SPRINGS = {"translation": 3e3, "rotation": 0.4}, {"translation": 200.0, "rotation": 0.03}


def lowest(scene, count=COUNT):
    return solve_modes(scene, highest=0.0, count=count).frequencies[:count]


def mixes():
    """Return the 21 combinations of edges that no turn or reflection of the plate makes equal."""
    found = {}
    for left, bottom, right, top in itertools.product(("clamped", "supported", "free"), repeat=4):
        across, along = sorted((left, right)), sorted((bottom, top))
        found.setdefault(tuple(sorted((tuple(across), tuple(along)))), (left, bottom, right, top))
    return list(found.values())


def transposed(scene):
    """Return a scene with x and y exchanged."""
    data = scene.model_dump(exclude_none=True)
    data["plate"]["size"] = data["plate"]["size"][::-1]
    edges, effects = data["edges"], data["effects"]
    data["edges"] = {side: edges[other] for side, other in zip(SIDES, ("bottom", "left", "top", "right"), strict=True)}
    for table, pairs in (("tension", [("x", "y")]), ("orthotropic", [("Dx", "Dy")])):
        for first, second in pairs if table in effects else ():
            values = dict(effects[table])
            effects[table] = {**values, first: values[second], second: values[first]}
    for key, rows in effects.get("variation", {}).items():
        effects["variation"][key] = [list(column) for column in zip(*rows, strict=True)]
    for item in [*data["actuators"], data["target"], *effects["layers"], *effects["oscillators"]]:
        item["area"] = (*item["area"][2:], *item["area"][:2])
    return type(scene).model_validate(data)


def agrees_with_levy(scene, section, ends, **options):
    """Check a scene and its transpose, whose bottom and top edges are supported."""
    frequencies = lowest(scene)
    exact = levy_frequencies(section, scene.plate.size, ends, 1.001 * frequencies[-1], **options)
    assert frequencies == pytest.approx(exact[:COUNT], rel=1e-5)
    assert lowest(transposed(scene)) == pytest.approx(exact[:COUNT], rel=1e-5)


def navier(numbers, size=SIZE, tension=(0.0, 0.0), bed=0.0, orthotropic=None):
    """Return natural frequencies [Hz] (numbers,) × (numbers,) of a supported plate, half-waves along x in columns."""
    alpha, beta = (np.arange(1, numbers + 1) * math.pi / side for side in size)
    squares = alpha**2, beta[:, None] ** 2
    values = orthotropic or {"Dx": RIGIDITY, "Dy": RIGIDITY, "D1": COUPLING, "Dxy": TWIST}
    stiffness = values["Dx"] * squares[0] ** 2 + values["Dy"] * squares[1] ** 2 + bed
    stiffness += 2 * (values["D1"] + 2 * values["Dxy"]) * squares[0] * squares[1]
    stiffness += tension[0] * squares[0] + tension[1] * squares[1]
    return np.sqrt(stiffness / MASS) / (2 * math.pi)


@pytest.mark.parametrize(
    "mix",
    [pytest.param(mix, marks=pytest.mark.slow if index % 3 else ()) for index, mix in enumerate(mixes())],
    ids=edges_id,
)
def test_edges(mix):
    """Ritz's method in polynomials; the errors of both lie above the true values."""
    plate = SIZE, mix, RIGIDITY, MATERIAL["poisson_ratio"], MASS
    singular = any({"clamped", "free"} == {mix[i], mix[i - 1]} for i in range(4))
    method = extrapolated_frequencies if singular else ritz_frequencies
    expected = method(*plate, functions=28 if singular else 20, count=COUNT)
    rigid = {(): 3, ("supported",): 1}.get(tuple(edge for edge in mix if edge != "free"), 0)
    frequencies = lowest(dense_scene(size=SIZE, edges=mix))
    assert np.all(frequencies[:rigid] == 0)
    assert frequencies[rigid:] == pytest.approx(expected[rigid:], rel=1e-5)


@pytest.mark.parametrize("first", ["clamped", "supported", "free"])
@pytest.mark.parametrize("second", ["clamped", "supported", "free"])
def test_opposite_supported_edges(first, second):
    """Lévy's equation, far below the tolerance."""
    frequencies = lowest(dense_scene(size=SIZE, edges=(first, "supported", second, "supported")))
    exact = levy_frequencies(lambda x: isotropic(**MATERIAL), SIZE, (first, second), 1.001 * frequencies[-1])
    assert frequencies == pytest.approx(exact[:COUNT], rel=1e-8)


@pytest.mark.parametrize("values", ORTHOTROPIC)
def test_orthotropic_plate_under_tension_on_a_bed(values):
    tension, bed = (40.0, -3.0), 2e4
    effects = {
        "orthotropic": values,
        "tension": dict(zip("xy", tension, strict=True)),
        "foundation": {"stiffness": bed},
    }
    supported = dense_scene(size=SIZE, edges=("supported",) * 4, effects=effects)
    expected = np.sort(navier(30, SIZE, tension, bed, values).ravel())[:COUNT]
    assert lowest(supported) == pytest.approx(expected, rel=1e-8)
    mixed = dense_scene(size=SIZE, edges=("free", "supported", SPRINGS[0], "supported"), effects=effects)
    section = (values["Dx"], values["D1"], values["Dy"], values["Dxy"], MASS)
    ends = "free", tuple(SPRINGS[0].values())
    agrees_with_levy(mixed, lambda x: section, ends, tension=tension, bed=bed)


def test_a_shear_layer_acts_as_tension_of_its_stiffness():
    tables = {"shear_layer": {"stiffness": 40.0}}, {"tension": {"x": 40.0, "y": 40.0}}
    sheared, pulled = (dense_scene(size=SIZE, effects=table) for table in tables)
    assert lowest(sheared) == pytest.approx(lowest(pulled), rel=1e-12)
    assert make_bending(sheared).membrane == make_bending(pulled).membrane == (40.0, 40.0)


def test_elastic_edges():
    """Springs of two stiffnesses; hard ones approach a clamped edge, and soft ones a free one."""
    edges = (SPRINGS[0], "supported", SPRINGS[1], "supported")
    section = isotropic(**MATERIAL)
    agrees_with_levy(dense_scene(size=SIZE, edges=edges), lambda x: section, [tuple(s.values()) for s in SPRINGS])
    for size, kind in ((1e10, "clamped"), (1e-9, "free")):
        spring = {"translation": size * 100, "rotation": size}
        sprung, limit = (lowest(dense_scene(size=SIZE, edges=(edge,) * 4)) for edge in (spring, kind))
        moving = limit > 0
        assert sprung[moving] == pytest.approx(limit[moving], rel=1e-5)


@pytest.mark.parametrize("both", [False, True])
def test_layers(both):
    """Stiff and heavy strips from edge to edge, which overlap; the jumps of rigidity lie off any regular knots."""
    layers = [
        {"area": (0.031, 0.113, 0.0, SIZE[1]), "thickness": 4e-4, "young_modulus": 2e9, "density": 1500.0},
        {"area": (0.09, 0.171, 0.0, SIZE[1]), "thickness": 2e-4, "young_modulus": 5e9, "density": 900.0, "both": both},
    ]
    scene = dense_scene(size=SIZE, edges=("clamped", "supported", "free", "supported"), effects={"layers": layers})

    def section(x):
        """Bend the stack of sheets about its neutral plane; sheets as (E, ρ, z of the lower face, z of the upper)."""
        half, top = MATERIAL["thickness"] / 2, MATERIAL["thickness"] / 2
        sheets = [(MATERIAL["young_modulus"], MATERIAL["density"], -half, half)]
        for layer in layers:
            if layer["area"][0] < x < layer["area"][1]:
                modulus, density, height = layer["young_modulus"], layer["density"], layer["thickness"]
                sheets.append((modulus, density, top, top + height))
                top += height
                if layer.get("both"):
                    sheets.append((modulus, density, -half - height, -half))
        moments = [sum(e * (high**n - low**n) / n for e, _, low, high in sheets) for n in (1, 2, 3)]
        ratio = MATERIAL["poisson_ratio"]
        rigidity = (moments[2] - moments[1] ** 2 / moments[0]) / (1 - ratio**2)
        mass = sum(density * (high - low) for _, density, low, high in sheets)
        return rigidity, ratio * rigidity, rigidity, (1 - ratio) / 2 * rigidity, mass

    agrees_with_levy(scene, section, ("clamped", "free"), cuts=(0.031, 0.09, 0.113, 0.171))


def test_layer_that_ends_inside_the_plate():
    """Moments are singular at its corners. Finite elements of degree 7 with continuous slopes, finer at its edges."""
    layer = {"area": (0.06, 0.13, 0.05, 0.14), "thickness": 4e-4, "young_modulus": 2e9, "density": 1500.0}
    scene = dense_scene(size=SIZE, edges=("clamped", "supported", "free", "clamped"), effects={"layers": [layer]})
    expected = [14.50530, 56.75801, 114.65933, 199.33861]
    assert lowest(scene)[[0, 4, 9, 19]] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    "columns",
    [
        pytest.param((1.0, 1.6), marks=pytest.mark.slow),
        (0.8, 1.3, 0.9),
        pytest.param((1.1, 0.9, 1.3, 1.0, 0.8, 1.2, 1.1, 0.9), marks=pytest.mark.slow),
    ],
)
def test_variation(columns):
    lines, densities = np.linspace(0, SIZE[0], len(columns)), np.linspace(0.7, 1.4, len(columns))
    variation = {"thickness": [columns], "density": [tuple(densities)]}
    scene = dense_scene(
        size=SIZE, edges=("clamped", "supported", "free", "supported"), effects={"variation": variation}
    )

    def section(x):
        thickness = MATERIAL["thickness"] * np.interp(x, lines, columns)
        density = MATERIAL["density"] * np.interp(x, lines, densities)
        return isotropic(MATERIAL["young_modulus"], thickness, MATERIAL["poisson_ratio"], density)

    agrees_with_levy(scene, section, ("clamped", "free"), cuts=lines, steps=max(8, 48 // (len(columns) - 1)))


@pytest.mark.parametrize("mass", [0.0, 2e-3])
def test_oscillator(mass):
    """A spring s pulls the mean of its patch, w̄ = Σ p_r q_r, towards the ground or a mass.

    The roots λ = ω² of Σ p_r²/(λ_r − λ) + 1/s − 1/(mλ) = 0 lie one between each two of 0, λ_1, λ_2, ...
    """
    area, stiffness, numbers = (0.051, 0.083, 0.043, 0.062), 300.0, 400
    oscillator = {"area": area, "mass": mass, "stiffness": stiffness}
    frequencies = lowest(dense_scene(size=SIZE, edges=("supported",) * 4, effects={"oscillators": [oscillator]}))
    waves = [np.arange(1, numbers + 1) * math.pi / side for side in SIZE]
    along = [
        (np.cos(k * low) - np.cos(k * high)) / (k * (high - low))
        for k, low, high in zip(waves, area[::2], area[1::2], strict=True)
    ]
    means = 4 / (MASS * SIZE[0] * SIZE[1]) * np.outer(along[1], along[0]).ravel() ** 2
    poles = (2 * math.pi * navier(numbers).ravel()) ** 2
    moving = 1 / mass if mass else 0.0

    def secular(square):
        return (means / (poles - square)).sum() + 1 / stiffness - moving / square

    lines = np.sort(poles)[: COUNT + 1]
    brackets = itertools.pairwise([1e-9 * lines[0], *lines] if mass else lines)
    roots = [scipy.optimize.brentq(secular, a * (1 + 1e-12), b * (1 - 1e-12), rtol=1e-12) for a, b in brackets]
    assert frequencies == pytest.approx(np.sqrt(roots[:COUNT]) / (2 * math.pi), rel=1e-5)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.3, 1.0)])
def test_buckling(direction):
    """A supported plate buckles where Σ T k² = −D (α² + β²)² for some pair of half-waves."""
    squares = (np.arange(1, 20) * math.pi / SIZE[0]) ** 2, (np.arange(1, 20) * math.pi / SIZE[1])[:, None] ** 2
    critical = (
        RIGIDITY * (squares[0] + squares[1]) ** 2 / (direction[0] * squares[0] + direction[1] * squares[1])
    ).min()

    def scene(part):
        tension = {axis: -part * critical * share for axis, share in zip("xy", direction, strict=True)}
        return dense_scene(size=SIZE, edges=("supported",) * 4, effects={"tension": tension})

    tension = [-0.999 * critical * share for share in direction]
    assert lowest(scene(0.999), 3) == pytest.approx(np.sort(navier(20, tension=tension).ravel())[:3], rel=1e-5)
    loads = [f"{axis} = {0.0 - critical * share:.4g}" for axis, share in zip("xy", direction, strict=True)]
    with pytest.raises(SceneError, match=rf"^effects\.tension.* {', '.join(loads)} N/m, 0\.999 "):
        solve_modes(scene(1.001))
    with pytest.raises(SceneError, match=r"^effects\.tension.*: the plate buckles"):
        solve_modes(scene(1e9))


def test_buckling_beside_a_shear_layer():
    """Forces of both add up; the layer alone buckles no plate."""
    effects = {"tension": {"x": -1e6, "y": 5.0}, "shear_layer": {"stiffness": 10.0}}
    with pytest.raises(SceneError, match=r"^effects\.tension and shear layer = {x = -999990, y = 15}: the plate"):
        solve_modes(dense_scene(effects=effects))


@pytest.mark.parametrize("mass", [0.0, 1.0])
def test_springs_that_hide_the_plate(mass):
    """Stiff springs of oscillators hold their patch as if they were rigid, or are refused by name."""

    def scene(stiffness):
        oscillator = {"area": (0.05, 0.1, 0.05, 0.1), "mass": mass, "stiffness": stiffness}
        return dense_scene(effects={"oscillators": [oscillator]})

    rigid = lowest(scene(1e8), 6)
    for stiffness in (1e10, 1e12):
        assert lowest(scene(stiffness), 6) == pytest.approx(rigid, rel=1e-5)
    for stiffness in (1e18, 1e29):
        with pytest.raises(SceneError, match=r"^effects\.oscillators\[0\]\.stiffness = 1e\+.*: hides the plate"):
            solve_modes(scene(stiffness))


def layers_between(gap):
    """Return two layers, the second beginning ``gap`` [m] behind the end of the first."""
    layer = {"thickness": 1e-4, "young_modulus": 7e10, "density": 2700.0}
    return [{**layer, "area": (0.05, 0.1, 0.05, 0.1)}, {**layer, "area": (0.1 + gap, 0.15, 0.05, 0.1)}]


def test_layers_whose_edges_nearly_coincide():
    with pytest.raises(SceneError, match=r"effects\.layers.*0\.100005"):
        solve_modes(dense_scene(effects={"layers": layers_between(5e-6)}))
    touching, apart = (lowest(dense_scene(effects={"layers": layers_between(gap)}), 6) for gap in (0.0, 1e-8))
    assert apart == pytest.approx(touching, rel=1e-5)


def test_rigid_motions_of_a_plate_with_layers_have_no_frequency():
    scene = dense_scene(size=SIZE, edges=("free",) * 4, effects={"layers": layers_between(0.03)})
    assert (lowest(scene, 4) > 0).tolist() == [False] * 3 + [True]


@pytest.mark.parametrize("slenderness", [3, 30])
def test_a_cantilever_strip_without_poisson_s_effect_is_a_beam(slenderness):
    size, rigidity = (0.6, 0.6 / slenderness), 2.0
    orthotropic = {"Dx": rigidity, "Dy": rigidity, "D1": 0.0, "Dxy": rigidity / 2}
    scene = dense_scene(size=size, edges=("clamped", "free", "free", "free"), effects={"orthotropic": orthotropic})
    first = 1.8751040687119611**2 / (2 * math.pi * size[0] ** 2) * math.sqrt(rigidity / MASS)
    for density in (1, 2):
        frequency = solve_modes(scene, highest=0.0, count=4, density=density).frequencies[0]
        assert frequency == pytest.approx(first, rel=1e-7)


@pytest.mark.parametrize(("size", "edge", "highest"), [(SIZE, "supported", 250.0), ((0.3, 0.02), "free", 700.0)])
def test_modes_below_a_frequency_are_all_there(size, edge, highest):
    """Against twice as many modes, which reach beyond; a slender free plate has many more than Weyl's law counts."""
    scene = dense_scene(size=size, edges=(edge,) * 4)
    found = modes_below(scene, highest).frequencies
    expected = solve_modes(scene, 0.0, 2 * found.size + 50).frequencies
    assert expected[-1] > highest
    np.testing.assert_allclose(found, expected[expected <= highest], rtol=1e-5, atol=1e-3)
