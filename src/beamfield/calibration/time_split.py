"""Split a log by time into blocks for fitting and blocks held out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import require
from beamfield.errors import InvalidInputError

# Beams of one scan and of scans within some 20 s depend on each other; shorter blocks would share their errors.
LONGEST_BLOCK_S = 20.0
FEWEST_BLOCKS = 12
MOST_BLOCKS = 1_000_000
# A bootstrap of fewer blocks tells too little of how parameters vary from one stretch of time to the next.
FEWEST_TRUSTED_BLOCKS = 8


def time_blocks(stamps: ArrayLike, block_s: float | None = None) -> NDArray[np.int64]:
    """Return the number of the time block of each stamp (n,), counted from 0; all 0 if no time passes.

    A block is `block_s` seconds long; None: 20 s, or shorter so that the log has at least 12 blocks. InvalidInputError
    if a stamp is not finite, or the length is not positive.

    >>> time_blocks([0.0, 4.0, 11.0, 30.0], block_s=10.0).tolist()
    [0, 0, 1, 2]
    """
    times = np.asarray(stamps, dtype=np.float64)
    if len(times) == 0:
        return np.zeros(0, dtype=np.int64)
    if not np.isfinite(times).all():
        index = int(np.argmin(np.isfinite(times)))
        raise InvalidInputError(f"stamps[{index}]: expected a finite number of seconds, got {times[index]}")
    duration = float(times.max() - times.min())
    length = block_length(times, block_s)
    if duration > MOST_BLOCKS * length > 0:
        # Only who gave a length is told to give another: not every command has an option for it.
        what, longer = ("stamps", "") if block_s is None else ("block_s", ", or longer blocks")
        raise InvalidInputError(
            f"{what}: {duration:g} s in blocks of {length:g} s make more than {MOST_BLOCKS:,} blocks; "
            f"expected stamps in seconds{longer}"
        )
    if length <= 0:
        return np.zeros(len(times), dtype=np.int64)
    blocks = np.floor((times - times.min()) / length).astype(np.int64)
    # The last stamp would start a block of its own.
    return np.asarray(np.minimum(blocks, max(0, int(np.ceil(duration / length)) - 1)))


def block_length(stamps: ArrayLike, block_s: float | None) -> float:
    """Return how long the blocks of `time_blocks` are, seconds; 0 if no time passes and no length is given."""
    if block_s is None:
        times = np.asarray(stamps, dtype=np.float64)
        return min(LONGEST_BLOCK_S, float(np.ptp(times)) / FEWEST_BLOCKS) if times.size else 0.0
    require(block_s > 0, "block_s", "a positive number of seconds", block_s)
    return float(block_s)


def held_out_mask(stamps: ArrayLike, block_s: float | None = None) -> NDArray[np.bool_]:
    """Return which stamps (n,) are held out: every third block of time, from the second on, of `time_blocks`.

    None is held out where there are too few blocks.

    Examples
    --------
    >>> held_out_mask(np.arange(6) * 10.0, block_s=10.0).tolist()
    [False, True, False, False, True, True]
    """
    return of_held_out(time_blocks(stamps, block_s))


def of_held_out(blocks: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether blocks of these numbers are held out: every third, from the second on."""
    return np.asarray(blocks % 3 == 1)
