"""What a run leaves behind: one HDF5 file, and the plain data that it holds."""

from warp_plate.result.model import Case, Result
from warp_plate.result.store import load_result, save_result

__all__ = ["Case", "Result", "load_result", "save_result"]
