"""Comparing a local map with a map at many translations at once, by Fourier transforms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beamfield.geometry import FloatArray
from beamfield.kernels.elementary import SNAP
from beamfield.maps.occupancy import BoolArray
from beamfield.models.local_map_cells import LocalCells, OverlapSums

Integers = NDArray[np.int64]
Precision = type[np.float32] | type[np.float64]

# Columns of a spectrum that are transformed at a time: with so few they stay in the cache, which halves the time.
COLUMNS_PER_BLOCK = 32


class Template(NamedTuple):
    """A local map turned to one heading, cell by cell of the global map.

    Parameters
    ----------
    weights
        (3, rows, cols) number of local cells that fall into a cell, sum of their values, and of their squares.
    first
        (row, col) of the first cell relative to the cell in which the robot stands.
    """

    weights: FloatArray
    first: tuple[int, int]


class Places(NamedTuple):
    """Cells of the global map in which the robot stands.

    Parameters
    ----------
    rows
        (r,) distinct rows.
    row_index
        (n,) which of them is the row of each place.
    cols
        (n,) column of each place.
    """

    rows: Integers
    row_index: Integers
    cols: Integers


@dataclass(frozen=True, eq=False)
class MapSpectra:
    """Transforms of a part of a map.

    Parameters
    ----------
    spectra
        (3, rows, cols // 2 + 1) of where the map is defined, of its values, and of their squares; conjugated, so that
        products with a template's belong to the correlation with both axes reversed.
    shape
        (rows, cols) of the transforms.
    first
        (row, col) of the part's first cell in the map.
    """

    spectra: NDArray[np.complexfloating]
    shape: tuple[int, int]
    first: tuple[int, int]


def turned_template(cells: LocalCells, values: FloatArray, heading: float, phase: tuple[float, float]) -> Template:
    """Return a local map turned to a heading, for robots at one and the same place within their cells.

    Parameters
    ----------
    cells
        The local map's defined cells.
    values
        (L,) value of each.
    heading
        Radians in the map's own frame.
    phase
        (row, col) in [0, 1): where the robot stands in its cell. Cells are assigned as by `kernels.correlation`.

    Returns
    -------
    The smallest picture with all cells of the turned map.
    """
    c, s = np.cos(heading), np.sin(heading)
    cols = np.floor(phase[1] + SNAP + c * cells.x - s * cells.y).astype(np.int64)
    rows = np.floor(phase[0] + SNAP + s * cells.x + c * cells.y).astype(np.int64)
    first = int(rows.min()), int(cols.min())
    shape = int(rows.max()) - first[0] + 1, int(cols.max()) - first[1] + 1
    index = (rows - first[0]) * shape[1] + cols - first[1]
    of_cells = (np.ones_like(values), values, values**2)
    weights = np.stack([np.bincount(index, of_cell, shape[0] * shape[1]) for of_cell in of_cells])
    return Template(weights.reshape(3, *shape).astype(np.float64, copy=False), first)


def map_spectra(
    values: FloatArray, defined: BoolArray, first: tuple[int, int], shape: tuple[int, int], precision: Precision
) -> MapSpectra:
    """Return the transforms of a part of a map.

    Parameters
    ----------
    values
        (rows, cols) of the part; those of undefined cells do not count.
    defined
        (rows, cols) mask.
    first
        (row, col) of the part in the map.
    shape
        (rows, cols) of the transforms. To keep the ends of the part apart, they exceed it by as far as a template
        reaches past the places, along either axis.
    precision
        float32 or float64.

    Returns
    -------
    The transforms, complex of the same precision.
    """
    known = np.where(defined, values, 0.0)
    layers = np.stack([defined, known, known**2]).astype(precision)
    spectra = fft.fft(fft.rfft(layers, n=shape[1], axis=2), n=shape[0], axis=1, overwrite_x=True)
    return MapSpectra(np.conj(spectra, out=spectra), shape, first)


def translation_sums(part: MapSpectra, template: Template, places: Places) -> OverlapSums:
    """Return the sums over the cells that both maps define, with the robot at each of n places.

    Each is a correlation of two pictures: sum_d K(d) M(p + d) over the cells d of the template, p the robot's cell.
    Counts are whole numbers again.

    Parameters
    ----------
    part
        The map's transforms; they hold all cells that the template reaches from the places.
    template
        The local map.
    places
        Where the robot stands.

    Returns
    -------
    Sums, each (n,), rounded as the precision of the transforms has it.
    """
    rows, cols = part.shape
    dtype = part.spectra.dtype
    across = fft.rfft(template.weights.astype(dtype.type(0).real.dtype), n=cols, axis=2)
    wanted = (part.first[0] - template.first[0] - places.rows) % rows
    products = np.empty((6, len(wanted), part.spectra.shape[2]), dtype)
    for start in range(0, products.shape[2], COLUMNS_PER_BLOCK):
        block = slice(start, start + COLUMNS_PER_BLOCK)
        turned = fft.fft(across[:, :, block], n=rows, axis=1)
        known, value, value_square = part.spectra[:, :, block]
        both = np.empty((6, *known.shape), dtype)
        np.multiply(turned, known, out=both[:3])
        np.multiply(turned[:2], value, out=both[3:5])
        np.multiply(turned[0], value_square, out=both[5])
        products[:, :, block] = fft.ifft(both, axis=1, overwrite_x=True)[:, wanted]
    index = places.row_index * cols + (part.first[1] - template.first[1] - places.cols) % cols
    n, local, local_square, of_map, product, map_square = (
        fft.irfft(of_kind, n=cols, axis=1).reshape(-1)[index].astype(np.float64) for of_kind in products
    )
    return OverlapSums(np.rint(n), local, of_map, product, local_square, map_square)
