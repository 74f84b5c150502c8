"""Searches on workers: their blocks of plates, and whether two runs agree."""

PLATES = 150  # blocks of 64, 64 and 22


def random_phasors(random, plates=PLATES):
    return random.normal(size=(plates, 3)) + 1j * random.normal(size=(plates, 3))


def small_search(scene, **search):
    """A scene whose search has several blocks in each generation."""
    keys = {"particles": PLATES, "iterations": 4, **search}
    return scene((9, 9), window=(0.002, 0.004), damping=20.0, precision="float32", search=keys)


def assert_same_run(found, run):
    assert found.energy.tobytes() == run.energy.tobytes()
    assert repr(sorted(found.faults.items())) == repr(sorted(run.faults.items()))
    assert found.node_steps == run.node_steps


def assert_same_history(result, expected):
    for name, values in expected.history.items():
        assert result.history[name].tobytes() == values.tobytes(), name
    assert result.cases["best"].phasors.tobytes() == expected.cases["best"].phasors.tobytes()
    assert (result.node_steps, result.evaluations) == (expected.node_steps, expected.evaluations)
