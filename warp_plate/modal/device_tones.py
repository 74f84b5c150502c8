"""Gram matrices of plates under tones on a Warp device, for modes that damping does not couple.

The numbers are those of :class:`warp_plate.modal.gram.ToneMatrices` and, in the steady state, of
:func:`warp_plate.modal.gram.gram_matrices`, by the kernels of ``kernels/tones.py``. Data that depend only on the
plate are put on the device once; frequencies and places follow with each batch.
"""

import math
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import tones as kernels
from warp_plate.modal.gram import Means, ToneMatrices, mean_exponential
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import APART, as_sparse
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.scene.grid import Window
from warp_plate.solve.devices import load_kernel

# Numbers of the largest matrix of a block of plates.
DEVICE_NUMBERS = 2**24
# The two poles of a mode are kept apart by this part of the highest mode's frequency in the steady state.
SPLIT = 1e-8


class DeviceToneMatrices:
    """Gram matrices of regions, by their mass matrices, under tones from rest, or in the steady state without a window,
    in float64 on a device; of modes that damping does not couple."""

    def __init__(self, means: Means, device: wp.Device, block_numbers: int = DEVICE_NUMBERS) -> None:
        plate, window, self._block_numbers = means.plate, means.window, block_numbers
        self._device, self._window, self._velocity = device, window, int(means.velocity)
        if window is None:
            values, squares, lasting = *_steady_poles(plate), np.empty(0, dtype=int)
            undamped = np.empty(0, dtype=complex)
        else:
            tones = ToneMatrices(means)
            values, squares, lasting = tones.poles.values, tones.poles.sizes**2, tones.lasting
            undamped = values[np.abs(values.real) < APART / window.end]
        free = np.zeros_like(squares)
        free[lasting] = -squares[lasting]
        values, squares, free = (array.reshape(2, -1) for array in (values, squares, free))
        lasting, oscillates = np.flatnonzero(free.any(axis=0)), values[0].imag != 0
        place = np.full(values.shape[1], -1)
        place[lasting] = np.arange(lasting.size)
        self._motions = [*(self._put(array) for array in (values, squares, free, oscillates, place)), lasting.size]
        self._undamped, self._lasting = self._put(undamped), self._put(np.tile(lasting, 2))
        free_means = _free_means(values[:, lasting], oscillates[lasting], window)
        pairs = ((region, np.tile(region[np.ix_(lasting, lasting)], (2, 2)) * free_means) for region in means.regions)
        self._regions = [[self._put_matrix(matrix) for matrix in pair] for pair in pairs]
        # Piezo patches stay in their places; their forces are moments along their edges, which no kernel integrates.
        self._fixed = plate.actuator_forces() if plate.scene.piezo else None
        assert isinstance(plate.space, TensorSplines)
        sides = plate.space.along
        tables = [side.breaks for side in sides] + [side.integral_pieces for side in sides]
        self._splines, self._unknowns = [self._put(table) for table in tables], math.prod(x.functions for x in sides)
        self._shapes, self._modes = self._put_tiles(plate.vectors[: self._unknowns].T), len(place)

    def matrices(self, frequency: np.ndarray, areas: np.ndarray) -> np.ndarray:
        """Return (plates, regions, 2M, 2M) matrices of mean energies [J per (N/m²)²], for frequencies (plates, M) [Hz]
        and rectangles (plates or 1, M, 4) x0, x1, y0, y1 [m], which are the scene's for piezo patches."""
        frequency, areas = np.asarray(frequency, dtype=float), np.asarray(areas, dtype=float)
        plates, actuators = frequency.shape
        matrices = np.empty((plates, len(self._regions), 2 * actuators, 2 * actuators))
        block = max(1, min(plates, self._block_numbers // (2 * actuators * self._modes)))
        work, tones, patches = self._workspace(block * actuators), *map(self._put, (frequency, areas))
        written = wp.empty((block, *matrices.shape[1:]), wp.float64, self._device)
        # While the device computes a block, the host takes the one before, which has a buffer of its own. Pinned memory
        # takes a millisecond to allocate: too long for a single block.
        pinned, before = self._device.is_cuda, None
        buffers = [wp.empty(written.shape, wp.float64, "cpu", pinned=pinned) for _ in range(2 * (block < plates))]
        for first in range(0, plates, block):
            rows = slice(first, min(first + block, plates))
            if first == 0 or len(areas) > 1:
                distinct = self._write_forces(patches[rows] if len(areas) > 1 else patches, work)
            self._write_matrices(tones[rows], distinct, work, written)
            if block == plates:
                return np.asarray(written.numpy())
            buffers.reverse()
            wp.copy(buffers[0], written)
            event = wp.get_stream(self._device).record_event() if pinned else None
            if before is not None:
                _take(*before)
            before = matrices[rows], buffers[0], event
        if before is not None:
            _take(*before)
        return matrices

    def _workspace(self, columns: int) -> dict[str, wp.array]:
        """Return matrices with a number of columns, padded with zeros to whole tiles."""
        rows = {"integrals": self._unknowns, **dict.fromkeys(("forces", "forced", "momenta"), self._modes)}
        rows |= dict.fromkeys(("free", "means", "formed"), max(len(self._lasting), 1))
        kinds, width = {"integrals": wp.float64, "forces": wp.float64}, _fill_up(columns, kernels.COLUMNS)
        return {
            name: wp.zeros((_fill_up(count, kernels.ROWS), width), kinds.get(name, wp.vec2d), self._device)
            for name, count in rows.items()
        }

    def _write_forces(self, areas: wp.array, work: dict[str, wp.array]) -> int:
        """Write modal forces of the actuators' unit pressures; return their number of columns."""
        count, actuators, _ = areas.shape
        if self._fixed is not None:
            whole = np.zeros(work["forces"].shape)
            whole[: self._modes, :actuators] = self._fixed
            work["forces"].assign(whole)
            return actuators
        dim = self._unknowns, count, actuators
        self._launch(kernels.integrate_patches, dim, [*self._splines, areas], [work["integrals"]])
        self._multiply(self._shapes, work["integrals"], work["forces"], count * actuators)
        return int(count * actuators)

    def _write_matrices(
        self, frequency: wp.array, distinct: int, work: dict[str, wp.array], matrices: wp.array
    ) -> None:
        """Write the matrices of a block of plates."""
        (plates, actuators), window = frequency.shape, self._window
        drive = wp.empty(frequency.shape, wp.vec2d, self._device)
        ends, apart = (wp.vec2d(), 0.0) if window is None else (wp.vec2d(window.start, window.end), APART / window.end)
        self._launch(kernels.write_drives, frequency.shape, [frequency, self._undamped, apart], [drive])
        forced, free, means, momenta, formed = (work[name] for name in ("forced", "free", "means", "momenta", "formed"))
        inputs = [*self._motions, self._velocity, ends, drive, work["forces"], distinct]
        self._launch(kernels.write_motions, (self._modes, plates, actuators), inputs, [forced, free, means])
        for index, (region, form) in enumerate(self._regions):
            self._multiply(region, forced, momenta, plates * actuators)
            self._multiply(form, free, formed, plates * actuators)
            inputs = [self._lasting, int(window is None), ends, drive, forced, free, means, momenta, formed, index]
            self._launch(kernels.contract, (plates, actuators, actuators), inputs, [matrices])

    def _multiply(self, left: list[wp.array], right: wp.array, product: wp.array, columns: int) -> None:
        """Write the product of a matrix, see :meth:`_put_matrix`, and columns of another."""
        if len(left) > 1:
            self._launch(kernels.multiply_sparse, (len(left[0]) - 1, columns), [*left, right], [product])
            return
        parts = 2 if right.dtype is wp.vec2d else 1
        reals = [matrix.view(wp.float64).reshape((matrix.shape[0], -1)) for matrix in (right, product)]
        tiles = _fill_up(parts * columns, kernels.COLUMNS) // kernels.COLUMNS, left[0].shape[0] // kernels.ROWS
        shared = {"block_dim": kernels.THREADS, "device": self._device}
        load_kernel(kernels.multiply_dense, self._device, kernels.THREADS)
        wp.launch_tiled(kernels.multiply_dense, dim=tiles, inputs=[*left, reals[0]], outputs=[reals[1]], **shared)

    def _put_matrix(self, matrix: np.ndarray) -> list[wp.array]:
        """Put a matrix on the device, as compressed rows if few of its numbers are not zero."""
        rows = as_sparse(matrix)
        if isinstance(rows, np.ndarray):
            return self._put_tiles(rows)
        return [self._put(array) for array in (rows.indptr, rows.indices, rows.data)]

    def _put_tiles(self, matrix: np.ndarray) -> list[wp.array]:
        """Put a dense matrix on the device, filled up to whole tiles."""
        tiles = zip(matrix.shape, (kernels.ROWS, kernels.INNER), strict=True)
        return [self._put(np.pad(matrix, [(0, _fill_up(count, tile) - count) for count, tile in tiles]))]

    def _put(self, values: np.ndarray) -> wp.array:
        if np.iscomplexobj(values):
            pairs = np.ascontiguousarray(values, dtype=complex).view(float).reshape(*values.shape, 2)
            return wp.array(pairs, dtype=wp.vec2d, device=self._device)
        kind = wp.float64 if values.dtype.kind == "f" else wp.int32
        return wp.array(np.ascontiguousarray(values), dtype=kind, device=self._device)

    def _launch(self, kernel: Any, dim: tuple[int, ...], inputs: list[Any], outputs: list[Any]) -> None:
        load_kernel(kernel, self._device)
        wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=self._device)


def _take(target: np.ndarray, source: wp.array, event: wp.Event | None) -> None:
    """Copy as many matrices as the target has, after an event."""
    if event is not None:
        wp.synchronize_event(event)
    target[...] = source.numpy()[: len(target)]


def _fill_up(count: int, tile: int) -> int:
    """Return a count filled up to whole tiles."""
    return -(-count // tile) * tile


def _steady_poles(plate: ModalPlate) -> tuple[np.ndarray, np.ndarray]:
    """Return poles s and squares ψ² (2 · modes,) with Σ ψ²/(iω − s) = 1/(Λ + iH + iωC − ω²)."""
    square, loss = plate.angular_frequencies**2 + 1j * np.diag(plate.hysteretic), np.diag(plate.damping) / 2
    split, least = np.sqrt(loss**2 - square), SPLIT * plate.angular_frequencies.max()
    split = np.where(np.abs(split) < least, least, split)
    return np.concatenate([split - loss, -split - loss]), np.concatenate([1 / (2 * split), -1 / (2 * split)])


def _free_means(poles: np.ndarray, oscillates: np.ndarray, window: Window | None) -> np.ndarray:
    """Return (2 · modes, 2 · modes) means of products of the free motions of poles (2, modes): exp(st), or Re and Im of
    it where two conjugate poles oscillate."""
    if window is None:
        return np.zeros((0, 0))
    parts = np.where(oscillates, np.array([[[0.5], [0.5]], [[-0.5j], [0.5j]]]), np.eye(2)[:, :, None])
    motions = np.block([[np.diag(part) for part in row] for row in parts])
    means = mean_exponential(poles.reshape(-1, 1), poles.reshape(1, -1), window)
    return np.asarray((motions @ means @ motions.T).real)
