"""Searches that end early, and whether two of them agree."""

import hashlib
from dataclasses import asdict

import numpy as np

from warp_plate import localize
from warp_plate.result.checkpoint import load_checkpoint
from warp_plate.studies.unfinished import CheckpointFile


def assert_same_results(one, other):
    """Check that two results are bit-identical, apart from timings and error estimates."""
    left, right = asdict(one), asdict(other)
    for name in left.keys() - {"seconds", "accuracy"}:
        np.testing.assert_equal(left[name], right[name], name)


def digest(result):
    """Return a hash of all numbers that a search found."""
    numbers = [result.bound, result.evaluations, result.node_steps, *map(np.ndarray.tobytes, result.history.values())]
    for name, case in sorted(result.cases.items()):
        fields = (case.phasors, case.displacement, case.trace)
        numbers += [name, sorted(case.energy.items()), *map(np.ndarray.tobytes, fields)]
    return hashlib.sha256(repr(numbers).encode()).hexdigest()


def stop_after(iterations):
    def on_progress(done, total, best):
        if done == iterations:
            raise KeyboardInterrupt

    return on_progress


def interrupted_search(folder, scene, after=None, **options):
    """Search until so many iterations are done or the solver raises KeyboardInterrupt; return result and checkpoint."""
    file = CheckpointFile(folder / "one.checkpoint.h5", np.inf)
    on_progress = None if after is None else stop_after(after)
    result = localize(scene, source="mine", on_progress=on_progress, estimate=False, checkpoints=file, **options)
    assert result.interrupted
    return result, load_checkpoint(file.path)
