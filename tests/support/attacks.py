"""Attacks by random inputs."""

import hypothesis


def examples(count):
    """Return the settings of an attack of ``count`` examples, or of sixty times as many with ``-m hour``."""
    return hypothesis.settings(
        max_examples=count * hypothesis.settings().max_examples // 100,
        suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture],
    )
