"""Standard errors and intervals from what each block of time adds to an estimate (delete-a-block jackknife)."""

from __future__ import annotations

import numpy as np
from scipy.special import betaincinv, stdtrit

from beamfield.geometry import FloatArray

# Beyond this a factor overflows; the interval is then all there is.
LONGEST_REACH = 500.0


def jackknife_error(replicates: FloatArray) -> FloatArray:
    """Return the standard error (p,) of estimates of which (b, p) were made without one of b >= 2 blocks each.

    Examples
    --------
    Of a mean, that is the usual standard error:

    >>> values = np.array([1.0, 2.0, 4.0, 7.0])
    >>> means = np.array([np.delete(values, i).mean() for i in range(4)])
    >>> bool(np.isclose(jackknife_error(means[:, None])[0], values.std(ddof=1) / 2.0))
    True
    """
    n = len(replicates)
    return np.asarray(np.sqrt((n - 1.0) / n * np.square(replicates - replicates.mean(axis=0)).sum(axis=0)))


def block_interval(value: float, standard_error: float, n_blocks: int, *, most: float = np.inf) -> tuple[float, float]:
    """Return the 95% interval of a positive parameter, symmetric in its logarithm, or in its logit if it has a limit.

    The standard error is from 2 or more blocks; the interval is by Student's t: few blocks vary less than their
    population. `most` is the parameter's upper limit, 1 for weights.

    >>> low, high = block_interval(0.5, 0.1, 10, most=1.0)
    >>> round(low, 3), round(high, 3)
    (0.288, 0.712)
    """
    reach = float(stdtrit(n_blocks - 1, 0.975)) * standard_error / value
    reach = min(reach, LONGEST_REACH)
    if most == np.inf:
        return value * float(np.exp(-reach)), value * float(np.exp(reach))
    odds = value / (most - value)
    spread = float(np.exp(min(reach / (1.0 - value / most), LONGEST_REACH)))
    low, high = odds / spread, odds * spread
    return most * low / (1.0 + low), most * (1.0 - 1.0 / (1.0 + high))


def share_interval(share: float, variance: float, outside: float) -> tuple[float, float]:
    """Return Clopper and Pearson's interval for a share in (0, 1), from the sample size that its variance implies.

    `outside` is the share of such intervals that may miss the truth; the variance is positive.
    """
    n = share * (1.0 - share) / variance
    hits, misses = share * n, (1.0 - share) * n
    low = float(betaincinv(hits, misses + 1.0, 0.5 * outside)) if hits > 1e-100 else 0.0  # SciPy's is NaN there
    return low, float(betaincinv(hits + 1.0, misses, 1.0 - 0.5 * outside))
