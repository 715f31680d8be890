"""Columns as a pandas DataFrame, where pandas is installed: no dependency of beamfield."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from numpy.typing import NDArray

from beamfield.errors import needs


def data_frame(columns: Mapping[str, NDArray[Any]]) -> Any:
    """Return columns of one length as a DataFrame; MissingDependencyError if pandas is not installed."""
    with needs("pandas", None, "to_dataframe"):
        pandas = import_module("pandas")
    return pandas.DataFrame(dict(columns))
