"""Pictures of sweeps of all shapes: labels have room, and coinciding curves can all be seen."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from warp_plate.result.sweep import REFUSED
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.studies.quantities_of_interest import QUANTITIES
from warp_plate.studies.sweep import start_sweep
from warp_plate.viz.plots.sweep import COLOURS, cell_edges, draw_sweep

pytest.importorskip("matplotlib", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread


@pytest.fixture
def panel(scene):
    return scene(damping=88.5, time_step=2e-4)


def random_sweep(panel, vary, what="localize", samples=None):
    """A sweep with random values, some points refused and one value infinite."""
    plan = make_plan([parse_vary(panel, one) for one in vary], samples)
    begun = start_sweep(panel, plan, what, "cpu", count=3)
    values = {name: np.random.default_rng(1).random(one.shape) for name, one in begun.values.items()}
    status = np.ones(len(plan), dtype="i1")
    status[::5] = REFUSED
    for one in values.values():
        one[::5] = np.nan
    next(iter(values.values())).flat[-1] = np.inf
    return replace(begun, values=values, status=status, reasons=dict.fromkeys(range(0, len(plan), 5), "no"))


LINE, PAIR = ["drive.frequency=log:200:300:12"], ["drive.frequency=300:200:4", "effects.damping.viscous=log:1:100:3"]
FOUR = [f"{key}=1:2:3" for key in ("drive.frequency", "plate.thickness", "window.end", "plate.density")]


@pytest.mark.parametrize(
    ("what", "vary", "samples"),
    [
        *((what, LINE, None) for what in QUANTITIES),
        ("localize", ["drive.frequency=290"], None),
        ("modes", ["plate.thickness=4e-4:6e-4", "target.area[1]=0.05:0.15", "plate.density=log:900:1500"], 20),
        ("modes", PAIR, None),
        ("check", ["drive.frequency=290", "effects.damping.viscous=0,1,5"], None),
        ("modes", ["drive.frequency=1,2", "effects.damping.viscous=1,2", "plate.thickness=log:1e-4:2e-4:3"], None),
        ("localize", FOUR, None),
    ],
)
def test_pictures_of_all_shapes(panel, tmp_path, monkeypatch, what, vary, samples):
    """Labels of ticks do not touch each other, and refused points are grey."""
    figures, save = [], Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *args, **how: (figures.append(self), save(self, *args, **how)))
    draw_sweep(random_sweep(panel, vary, what, samples), tmp_path / "a.png")
    drawn = imread(tmp_path / "a.png")
    assert min(drawn.shape[:2]) > 300
    assert drawn[..., :3].std() > 0.02
    for axis in (axis for axes in figures[0].axes if axes.get_visible() for axis in (axes.xaxis, axes.yaxis)):
        ends = sorted(axis.get_view_interval())
        shown = [tick.label1 for tick in axis.get_major_ticks() if ends[0] <= tick.get_loc() <= ends[1]]
        boxes = [label.get_window_extent() for label in shown if label.get_visible() and label.get_text()]
        boxes.sort(key=lambda box: box.x0 if axis.axis_name == "x" else box.y0)
        assert all(one.x1 + 5 < two.x0 or one.y1 < two.y0 for one, two in itertools.pairwise(boxes))
    if (what, vary) == ("check", LINE):
        assert [axes.get_ylabel() for axes in figures[0].axes] == ["time step [s]", "resolution"]
        assert figures[0].axes[-1].get_xlabel() == "drive frequency [Hz]"


@pytest.mark.parametrize("samples", [None, 5])
def test_coinciding_curves_can_all_be_seen(panel, tmp_path, samples):
    """Every colour of the legend is in the panels, though best and bound coincide."""
    sweep = random_sweep(panel, ["plate.thickness=4e-4:6e-4:6"], "localize", samples)
    sweep.values.update({name: np.linspace(0.2, 0.7, len(sweep.plan)) for name in sweep.values})
    sweep.values["single"], sweep.values["equal"] = (1 - sweep.values[name] for name in ("best", "bound"))
    draw_sweep(replace(sweep, status=np.ones_like(sweep.status)), tmp_path / "a.png")
    drawn = imread(tmp_path / "a.png")[..., :3]
    legend = drawn[:150] if samples is None else drawn[:, -350:]
    for colour in COLOURS[:4]:
        seen = [np.isclose(part, to_rgb(colour), atol=0.01).all(axis=2).sum() for part in (drawn, legend)]
        assert seen[0] > seen[1] + 40


def test_cell_edges_lie_halfway_between_values():
    np.testing.assert_allclose(cell_edges(np.array([1.0, 2.0, 4.0]), False), [0.5, 1.5, 3.0, 5.0])
    np.testing.assert_allclose(cell_edges(np.array([1.0, 100.0]), True), [0.1, 10.0, 1000.0])
    low, high = cell_edges(np.array([0.0]), False)
    assert low < 0 < high
