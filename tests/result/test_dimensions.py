"""Files name their dimensions as netCDF-4 does, so that xarray opens them with coordinates and without any setting."""

import warnings

import numpy as np
import pytest

import warp_plate as wpl
from support.scenes import scene_of
from warp_plate.result.focus import save_focus

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")
SEARCH = {"particles": 4, "iterations": 3}


def opened(path):
    """Return the groups of a file by path; every axis of every dataset must have a name."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return xarray.open_datatree(path, engine="h5netcdf").to_dict()


def small_result():
    record = {"points": [(0.05, 0.06), (0.1, 0.1)]}
    return wpl.localize(scene_of((9, 9), search=SEARCH, record=record), device="cpu", estimate=False)


def test_a_result_opens_by_names_of_actuators_regions_and_places(tmp_path):
    result = small_result()
    groups = opened(wpl.save_result(result, tmp_path / "a.h5"))
    case = groups["/cases/best"]
    best = result.cases["best"]
    assert float(case.energy.sel(region="target")) == best.energy["target"]
    name = result.scene.actuators[1].name
    assert float(case.magnitude.sel(actuator=name)) == pytest.approx(best.magnitude[1], rel=1e-15)
    assert case.displacement.dims == ("times", "y", "x")
    assert case.trace.dims == ("point", "trace_times")
    np.testing.assert_allclose(case.x, np.linspace(0, result.scene.plate.size[0], 9))
    assert groups["/history"].best.dims == ("iteration",)


def test_focusing_opens(tmp_path):
    found = wpl.focus("four-fingers")
    groups = opened(save_focus(found, tmp_path / "a.h5"))
    group = groups["/methods/optimum"]
    assert group.waveforms.dims == ("foci", "actuator", "samples")
    assert group.responses.dims == ("foci", "foci_2", "times")
    assert wpl.load_focus(tmp_path / "a.h5").modes == found.modes
