"""Results, checkpoints, comparisons and sweeps: data classes, their HDF5 files, and exports."""

from warp_plate.result.model import Case, Result, load_result, save_result

__all__ = ["Case", "Result", "load_result", "save_result"]
