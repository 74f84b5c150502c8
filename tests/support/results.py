"""Results that no command has computed."""

import math

import numpy as np

from warp_plate.result.model import Result
from warp_plate.result.motion import Motion


def result_of(scene, cases, **changes):
    """Return a result of ``localize`` without a history."""
    plain = {"command": "localize", "source": "panel.toml", "device": "cpu", "seed": 0, "effects": (), "seconds": {}}
    motionless = {"node_steps": 1, "times": np.zeros(0), "trace_times": np.zeros(0)}
    return Result(scene=scene, cases=cases, **{**plain, **motionless, **changes})


def motion_of(name, amplitude, lag=0.0, frames=8, start=0.0, factor=0.25):
    """Return a motion at 200 Hz with these (ny, nx) amplitudes [m] and phase lags [rad]."""
    turn = 2 * math.pi * np.arange(frames)[:, None, None] / frames - lag
    times, mass = start + np.arange(frames) / frames / 200, np.full(amplitude.shape, 0.5)
    field, velocity = np.cos(turn) * amplitude, -400 * math.pi * np.sin(turn) * amplitude
    return Motion(name, 200.0, (start, start + 0.005), times, field, velocity, mass, factor)
