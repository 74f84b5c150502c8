"""Processor seconds of the sound power of 200 modes at 200 frequencies: python benchmarks/sound_cost.py [PRESET]."""

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before NumPy is loaded

import sys
import time

import numpy as np

from warp_plate import Scene
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Radiation

HIGHEST, COUNT = 1200.0, 200


def main() -> None:
    plate = solve_modes(Scene.load(sys.argv[1] if len(sys.argv) > 1 else "touch-panel"), HIGHEST).part(np.arange(COUNT))
    frequencies = np.linspace(20.0, HIGHEST, COUNT)
    amplitudes = np.random.default_rng(0).normal(size=(COUNT, COUNT, 1)) + 0j
    for _ in range(3):
        started = time.process_time()
        Radiation(plate, HIGHEST).powers(frequencies, amplitudes)
        print(
            f"{COUNT} modes, {COUNT} frequencies up to {HIGHEST:g} Hz: {time.process_time() - started:.2f} s of a core"
        )


if __name__ == "__main__":
    main()
