"""Parts of a run, and runs begun before others end, share states in turns: no bit changes, whatever is cut short."""


import numpy as np
import pytest
import warp as wp

from warp_plate import PlateSolver, SceneError
from warp_plate.plate.designs import Designs
from warp_plate.solve.batching import LARGEST_PART, TURNS, part_sizes


@pytest.mark.parametrize("effects", [{}, {"tension": {"x": 3.0, "y": 1.0}}], ids=["plain", "general"])
def test_parts_that_overlap_change_no_bit(effects, device, path, scene, phasors, monkeypatch):
    """A large batch, cut into parts whose states take turns, with a bad plate in each; twice, and with pictures."""
    made = scene(nodes=(9, 9), window=(0.002, 0.004), effects=effects)
    drives = phasors(37, 3)
    drives[[1, 6, 20, 36], 0] = np.nan
    whole = PlateSolver(made, device, path).run(drives, (0.003,))
    monkeypatch.setattr("warp_plate.solve.batching.FIRST_NODE_STEPS", 1)
    monkeypatch.setattr(PlateSolver, "_overlaps", True)
    solver, told = PlateSolver(made, device, path), []
    for _ in range(2):
        cut = solver.run(drives, (0.003,), progress=lambda *done: told.append(done))
        np.testing.assert_array_equal(cut.energy, whole.energy)
        np.testing.assert_array_equal(cut.displacement, whole.displacement)
        np.testing.assert_array_equal(cut.status, whole.status)
    assert len(solver._states) == TURNS
    assert solver._states[0].capacity < 20
    assert told[-1] == (37 * solver.node_steps_per_plate,) * 2
    found = np.full((37, 2), -1.0)

    def each(some, energy):
        assert (found[some] == -1).all()
        found[some] = energy

    several = solver.run(Parts(drives), each=each)
    np.testing.assert_array_equal(several.energy, whole.energy)
    np.testing.assert_array_equal(found, whole.energy)


@pytest.mark.parametrize("overlaps", [False, True])
def test_runs_begun_before_others_end_change_no_bit(overlaps, device, path, scene, phasors, monkeypatch):
    """As a worker does, which begins the next block before it waits for the last; sizes that need more room, too."""
    made = scene(nodes=(9, 9), window=(0.002, 0.004))
    blocks = [phasors(count, 3) for count in (5, 5, 12, 3, 12)]
    whole = [PlateSolver(made, device, path).run(drives) for drives in blocks]
    monkeypatch.setattr(PlateSolver, "_overlaps", overlaps)
    solver, found, begun = PlateSolver(made, device, path), [], None
    for drives in [*blocks, None]:
        following = None if drives is None else solver.begin(drives)
        if begun is not None:
            found.append(begun())
        begun = following
    for run, right in zip(found, whole, strict=True):
        np.testing.assert_array_equal(run.energy, right.energy)
    assert solver.node_steps == sum(run.node_steps for run in whole)
    assert not solver._ends


def test_a_run_reads_nothing_from_the_device_but_its_sums(device, path, scene, phasors, monkeypatch):
    """Whatever else it read would wait until the device is idle, and nothing could be made ready meanwhile."""
    solver, read, numpy = PlateSolver(scene(nodes=(9, 9), window=(0.002, 0.004)), device, path), [], wp.array.numpy
    solver.run(phasors(5, 3))

    def reading(array):
        read.append(array)
        return numpy(array)

    monkeypatch.setattr(wp.array, "numpy", reading)
    solver.run(phasors(5, 3))
    host = [getattr(state.host, name) for state in solver._states for name in ("coefficients", "units", "energy")]
    assert read
    assert all(any(array is one for one in host) for array in read)


def test_a_run_that_is_cut_short_leaves_nothing_to_the_next(device, path, scene, phasors, monkeypatch):
    made = scene(nodes=(9, 9), window=(0.002, 0.004))
    drives = phasors(37, 3)
    right = PlateSolver(made, device, path).run(drives)
    monkeypatch.setattr("warp_plate.solve.batching.FIRST_NODE_STEPS", 1)
    monkeypatch.setattr(PlateSolver, "_overlaps", True)
    solver = PlateSolver(made, device, path)

    def cut_short(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solver.run(drives, progress=cut_short)
    np.testing.assert_array_equal(solver.run(drives[::-1]).energy, right.energy[::-1])


def test_runs_begun_live_through_others_that_are_cut_short(device, path, scene, phasors, monkeypatch):
    """A run that is refused, one that ends in the middle of its start, and one whose end is waited for twice."""
    made = scene(nodes=(9, 9), window=(0.002, 0.004))
    blocks = [phasors(5, 3) for _ in range(3)]
    whole = [PlateSolver(made, device, path).run(drives).energy for drives in blocks]
    monkeypatch.setattr(PlateSolver, "_overlaps", True)
    solver = PlateSolver(made, device, path)
    first = solver.begin(blocks[0])
    with pytest.raises(SceneError):
        solver.run(blocks[1], times=[99.0])

    def cut_short(*args):
        raise KeyboardInterrupt

    for name in ("_start", "_march"):
        with monkeypatch.context() as only:
            only.setattr(PlateSolver, name, cut_short)
            with pytest.raises(KeyboardInterrupt):
                solver.begin(blocks[1])
    last = solver.begin(blocks[2])
    with monkeypatch.context() as only:
        only.setattr("warp_plate.solve.solver.judge_plates", cut_short)
        with pytest.raises(KeyboardInterrupt):
            first()
    np.testing.assert_array_equal(first().energy, whole[0])
    np.testing.assert_array_equal(last().energy, whole[2])
    np.testing.assert_array_equal(solver.run(blocks[1]).energy, whole[1])


def test_plates_for_which_memory_is_short_run_one_after_the_other(device, path, scene, phasors, monkeypatch):
    made, drives = scene(nodes=(9, 9), window=(0.002, 0.004)), phasors(5, 3)
    right = PlateSolver(made, device, path).run(drives).energy
    monkeypatch.setattr(PlateSolver, "_overlaps", True)
    for room in range(1, TURNS + 1):
        monkeypatch.setattr(PlateSolver, "_plates_at_once", lambda self, plates, nodes, room=room: min(room, plates))
        solver = PlateSolver(made, device, path)
        np.testing.assert_array_equal(solver.begin(drives)().energy, right)
        assert [state.capacity for state in solver._states] == ([1] * TURNS if room == TURNS else [room])


def test_what_a_run_that_is_cut_short_leaves_harms_no_other(device, path, scene, phasors, monkeypatch):
    """One of several parts ends in its second while another is begun: it and two more keep their states."""
    made = scene(nodes=(9, 9), window=(0.002, 0.004))
    blocks = [phasors(3, 3) for _ in range(4)]
    whole = [PlateSolver(made, device, path).run(drives).energy for drives in blocks]
    monkeypatch.setattr(PlateSolver, "_overlaps", True)
    monkeypatch.setattr(PlateSolver, "_plates_at_once", lambda self, plates, nodes: min(TURNS, plates))
    solver = PlateSolver(made, device, path)
    begun = [solver.begin(blocks[0][:1])]
    with monkeypatch.context() as only:
        real, starts = PlateSolver._start, []

        def cut_short(self, *args):
            starts.append(args)
            if len(starts) == 2:
                raise KeyboardInterrupt
            return real(self, *args)

        only.setattr(PlateSolver, "_start", cut_short)
        with pytest.raises(KeyboardInterrupt):
            solver.begin(blocks[1])
    begun += [solver.begin(blocks[2][:1]), solver.begin(blocks[3][:1])]
    for run, block in zip(begun, (0, 2, 3), strict=True):
        np.testing.assert_array_equal(run().energy, whole[block][:1])


@pytest.mark.parametrize(("plates", "first"), [(4, 1), (5, 1), (37, 3), (1000, 10), (131072, 2048)])
def test_parts_are_all_plates(plates, first):
    sizes = part_sizes(plates, first)
    assert sum(sizes) == plates
    assert min(sizes) >= 1
    assert sizes[0] == first
    assert max(sizes) <= LARGEST_PART * first


class Parts:
    """Designs that are made part by part."""

    only_drives = True

    def __init__(self, drives):
        self.drives_of = drives

    def __len__(self):
        return len(self.drives_of)

    def __getitem__(self, some):
        return Designs(self.drives_of[some])
