"""Results of all commands, and their files."""

from importlib import import_module
from typing import Any


def import_xarray() -> Any:
    """Return the module xarray, or raise an ImportError that says how to install it."""
    try:
        return import_module("xarray")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("to_xarray needs xarray: pip install 'warp-plate[data]'", name=error.name) from None
