"""
Play the drive
==============

A drive as a WAV file with a channel for each actuator, over a whole number of periods, so that it can be played in a
loop.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
from scipy.io import wavfile

import warp_plate as wpl
from warp_plate.result.export import make_drive_signal, write_wav

result = wpl.localize("paper", spectrum=False, estimate=False)
signal = make_drive_signal(result.scene, result.main_case, rate=48000, duration=1.0)
with tempfile.TemporaryDirectory() as folder:
    (path,) = write_wav(signal, Path(folder) / "drive.wav")
    rate, samples = wavfile.read(path)

shown = 480  # samples: 10 ms
figure, axis = plt.subplots(figsize=(8, 3.6), layout="constrained")
axis.plot([1e3 * sample / rate for sample in range(shown)], samples[:shown], label=signal.names)
axis.set(xlabel="time (ms)", ylabel=f"full scale: {signal.full_scale_text}")
axis.legend()
