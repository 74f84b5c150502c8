"""Contrast against fidelity: what a general optimiser finds, and the two methods at its ends."""

import numpy as np
import pytest
import scipy

from warp_plate.problem.trade_off import TradeOffCurve


@pytest.fixture(params=range(3))
def zones(request):
    """Return the responses of target and rest, and the wanted motion of the target."""
    random = np.random.default_rng(request.param)

    def drawn(*shape):
        return random.normal(size=shape) + 1j * random.normal(size=shape)

    return drawn(30, 4), drawn(60, 4), drawn(30)


def curve_of(target, rest, wanted):
    product, size = target.conj().T @ wanted / len(target), float(np.mean(np.abs(wanted) ** 2))
    forms = (rows.conj().T @ rows / len(rows) for rows in (target, rest))
    return TradeOffCurve(*forms, product, size)


def figures(zones, drive):
    """Return contrast [dB] and misfit of a drive, from the motion itself."""
    target, rest, wanted = zones
    squares = [np.mean(np.abs(rows @ drive) ** 2) for rows in (target, rest)]
    return 10 * np.log10(squares[0] / squares[1]), np.linalg.norm(target @ drive - wanted) / np.linalg.norm(wanted)


def test_curve_is_attained_and_its_bound_is_that_of_an_optimiser(zones):
    target, rest, wanted = zones
    curve = curve_of(*zones).curve(8)
    for one in curve:
        assert (one.contrast_db, one.misfit) == pytest.approx(figures(zones, one.drive), rel=1e-6)
        assert one.bound <= one.misfit <= one.bound + 1e-6
    assert (np.diff([one.misfit for one in curve]) >= -1e-9).all()
    middle = curve[4]
    form = target.conj().T @ target / 30 - 10 ** (middle.contrast_db / 10) * rest.conj().T @ rest / 60

    def phasors(x):
        return x[:4] + 1j * x[4:]

    def excess(x):
        return (phasors(x).conj() @ form @ phasors(x)).real

    def misfit(x):
        return np.mean(np.abs(target @ phasors(x) - wanted) ** 2)

    start = np.concatenate([middle.drive.real, middle.drive.imag])
    random = np.random.default_rng(0)
    found = [
        scipy.optimize.minimize(misfit, start + random.normal(size=8) / 10, method="SLSQP", tol=1e-12,
                                constraints={"type": "ineq", "fun": excess})
        for _ in range(4)
    ]  # fmt: skip
    least = min(np.sqrt(end.fun / np.mean(np.abs(wanted) ** 2)) for end in found if excess(end.x) > -1e-7)
    assert least == pytest.approx(middle.bound, rel=1e-4)


def test_bounds_hold_for_actuators_of_any_strength(zones):
    """They and their drives are those of equal actuators; one alone has nothing to trade."""
    target, rest, wanted = zones
    strength = np.array([1e-3, 1.0, 1e3, 1e5])
    for few in (rest, rest[:2]):
        for one, weaker in zip(
            curve_of(target, few, wanted).curve(8),
            curve_of(target * strength, few * strength, wanted).curve(8),
            strict=True,
        ):
            assert (weaker.contrast_db, weaker.misfit, weaker.bound) == pytest.approx(
                (one.contrast_db, one.misfit, one.bound), abs=1e-5
            )
    (alone,) = curve_of(target[:, :1], rest[:, :1], wanted).curve()
    assert alone.bound == alone.misfit


def test_spans_are_contrast_control_and_pressure_matching(zones):
    target, rest, wanted = zones
    spans = curve_of(*zones).spans(0.5)
    bright, dark = (rows.conj().T @ rows / len(rows) for rows in (target, rest))
    largest = scipy.linalg.eigh(bright, dark, eigvals_only=True)[-1]
    assert spans[0].contrast_db == pytest.approx(10 * np.log10(largest), abs=1e-6)
    matched = np.linalg.solve(bright + 0.5 * dark, target.conj().T @ wanted / 30)
    np.testing.assert_allclose(spans[-1].drive, matched, rtol=1e-6)
    assert (np.diff([one.misfit for one in spans]) < 0).all()
