"""The largest value of a field over a region, between the samples of the region, whichever of its maxima it is."""

import math

import numpy as np
import pytest
import shapely

from support.scenes import scene_of
from warp_plate import Scene
from warp_plate.modal.modes import solve_modes
from warp_plate.problem.worst_points import Care, make_region, shape_of
from warp_plate.scene.target import Target

SIZE = (0.3, 0.2)
WAVE = 0.05  # m; with 24 samples a wave


def draw_frame(random):
    """Return a point [m] and the rows of a rotation by a random angle."""
    angle, point = random.uniform(0, math.pi), random.uniform((0.08, 0.08), (0.22, 0.12))
    return point, np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])


@pytest.fixture(scope="module")
def region():
    plate = solve_modes(scene_of(size=SIZE, modal_density=0.5), 100.0)
    return make_region(plate, shapely.box(0.01, 0.01, 0.29, 0.19), WAVE / 24)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_highest_of_many_equal_maxima_is_found(region, random, sign):
    """Some 80 maxima that differ by less than a sample falls short of its maximum, one of them 1e-3 above the rest."""
    height, width = 1e-3, WAVE / 8
    for _ in range(10):
        shift = random.uniform(0, WAVE / 2, 2)
        counts = random.integers((1, 1), (10, 6))
        summit = (counts + 0.5) * WAVE / 2 + shift

        def values(points, shift=shift, summit=summit):
            waves = np.abs(np.prod(np.sin(2 * math.pi * (points - shift) / WAVE), axis=1))
            bump = height * np.exp(-((points - summit) ** 2).sum(axis=1) / width**2)
            return sign * (1 if sign > 0 else 2) - (1 - waves) + bump

        peaks = region.peaks(values(region.samples), values)
        assert values(peaks).max() == pytest.approx(sign * (1 if sign > 0 else 2) + height, abs=1e-7)


def test_the_summit_of_an_oblique_ridge_is_found(region, random):
    """Its height falls thirty times faster across than along."""
    for _ in range(20):
        summit, turn = draw_frame(random)

        def values(points, turn=turn, summit=summit):
            along, across = turn @ (points - summit).T / WAVE
            return np.cos(2 * math.pi * across) * np.cos(2 * math.pi * along / 30)

        assert values(region.peaks(values(region.samples), values)).max() == pytest.approx(1, abs=1e-9)


def test_a_field_without_maxima_has_few_peaks(region):
    flat = np.ones(len(region.samples))
    assert len(region.peaks(flat, lambda points: np.ones(len(points)), Care.SAMPLES)) <= 200


def test_regions_end_at_the_outline():
    """A disc with a round hole: no sample beyond the edges, and means over what is on the plate."""
    tables = Scene.load("watch").model_dump(include={"plate", "edges", "drive", "actuators", "effects"})
    tables["plate"]["holes"] = [{"disc": (0.019, 0.024, 0.004)}]
    scene = Scene.from_tables({**tables, "target": {"disc": (0.03, 0.01, 0.002)}, "grid": {"modal_density": 0.5}})
    plate = solve_modes(scene, 1e4)
    region = make_region(plate, shapely.box(0.019, 0.0, 0.038, 0.038), 5e-4)
    assert scene.outline.contains(region.samples).all()
    assert region.shape.area == pytest.approx(math.pi / 2 * (0.019**2 - 0.004**2), rel=1e-4)
    values = plate.space.at_points(region.samples)
    ones = np.linalg.lstsq(values, np.ones(len(values)))[0]
    assert ones @ (region.mean_matrix @ ones) == pytest.approx(1, rel=1e-4)


def test_the_zero_in_a_narrow_valley_is_found(region, random):
    """Across the valley the field rises a thousand times faster than along."""
    for _ in range(20):
        zero, turn = draw_frame(random)

        def field(points, turn=turn, zero=zero):
            along, across = turn @ (points - zero).T / WAVE
            return np.sin(across + along**2 / 2) + 1e-3j * np.sin(along)

        start = zero + 0.2 * WAVE * turn[0] + 0.01 * WAVE * turn[1]
        assert np.hypot(*(region.dips(start[None], field, np.ones(len(region.samples)))[0] - zero)) < 1e-6


def test_zeros_far_along_a_valley_are_found(region, random):
    """They are half a wave apart; samples, at other distances from the bottom of the valley, do not see them."""
    for _ in range(20):
        zero, turn = draw_frame(random)

        def field(points, turn=turn, zero=zero):
            along, across = 2 * math.pi * turn @ (points - zero).T / WAVE
            return np.sin(across) + 0.02j * np.sin(along)

        found = region.dips(np.empty((0, 2)), field, field(region.samples))
        places = zero + np.arange(-1, 2)[:, None] * WAVE / 2 * turn[0]
        places = places[shapely.contains_xy(shapely.box(0.013, 0.013, 0.287, 0.187), *places.T)]
        assert (np.linalg.norm(found[:, None] - places, axis=2).min(axis=0) < 1e-6).all()


@pytest.mark.parametrize("shape", [{"disc": (0.15, 0.1, 0.05)}, {"ellipse": (0.15, 0.1, 0.05, 0.02, 0.4)}])
def test_polygons_lie_inside_and_around_a_round_target(shape):
    target = Target(**shape)
    inside, around = (shape_of("target", target, side) for side in (-1, 1))
    circle = shapely.Polygon(target.flattened(20000))
    assert circle.buffer(1e-9).contains(inside)
    assert around.buffer(1e-9).contains(circle)
    assert inside.area == pytest.approx(around.area, rel=1e-4)


def test_the_higher_of_two_maxima_of_a_flat_ridge_is_found(region, random):
    """They are a spacing of samples and a half apart, and differ by 2e-5; the dip between them is as shallow."""
    for _ in range(20):
        summit, turn = draw_frame(random)
        apart = 1.5 * WAVE / 24

        def values(points, turn=turn, summit=summit, apart=apart):
            along, across = turn @ (points - summit).T
            level = along / apart  # maxima at 0 and about 1
            flat = -2e-4 * (level * (level - 1)) ** 2 + 2e-5 * level
            return np.cos(2 * math.pi * across / WAVE) + np.where(np.abs(level) < 3, flat, -7e-3)

        steps = np.linspace(0.9, 1.3, 4001)
        highest = 1 + (-2e-4 * (steps * (steps - 1)) ** 2 + 2e-5 * steps).max()
        assert values(region.peaks(values(region.samples), values)).max() == pytest.approx(highest, abs=1e-9)


def test_a_far_maximum_along_an_oblique_ridge_is_reached(region, random):
    """Samples see it two spacings beside the place where they are highest."""
    for _ in range(20):
        summit, turn = draw_frame(random)

        def values(points, turn=turn, summit=summit):
            along, across = turn @ (points - summit).T / WAVE
            return np.cos(2 * math.pi * across) - 1e-3 * along**2 + 1e-4 * along**3

        assert values(region.peaks(values(region.samples), values)).max() == pytest.approx(1, abs=1e-9)
