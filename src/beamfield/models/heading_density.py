"""What markers say about a camera's heading, and drawing from it: a von Mises density times wrapped normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray, wrap_angle

# The histogram starts with so many cells; those that matter are split until they are narrow.
FIRST_CELLS, SPLIT = 1024, 8
# So many cells to the least possible standard deviation: then 95 of 100 draws are accepted.
CELLS_PER_DEVIATION = 16.0
# Cells that lie so far below the highest one have no mass beside it in float64.
NEGLIGIBLE = 60.0


@dataclass(frozen=True, eq=False)
class HeadingDensity:
    """The density exp(Re(moment exp(-i theta))) prod_j WN(theta; turns_j, sigma) over theta, up to a factor.

    Parameters
    ----------
    moment
        kappa exp(i theta_0) of the von Mises factor.
    turns
        (k,) means of the wrapped normals, radians; none is possible.
    sigma
        Their standard deviation, radians.
    n_turns
        Full turns to either side that are added up in a wrapped normal.

    Notes
    -----
    The second derivative of the logarithm is nowhere below -(kappa + k / sigma^2), for the sum in a wrapped normal only
    adds to it. Between two points h apart the logarithm is thus at most h^2 / 8 of that above the higher one: this
    makes a histogram that surely lies above the density, and rejection exact.
    """

    moment: complex
    turns: FloatArray
    sigma: float
    n_turns: int

    def log(self, theta: FloatArray) -> FloatArray:
        """Return the logarithm, up to a constant, in nats and of theta's shape."""
        # cos(a) - 1 without its cancellation: kappa may be 1e17.
        value = -2.0 * abs(self.moment) * np.sin((theta - np.angle(self.moment)) / 2.0) ** 2
        for mean in self.turns:
            off = wrap_angle(theta - mean)
            around = off + 2.0 * np.pi * np.arange(-self.n_turns, self.n_turns + 1).reshape(-1, *[1] * off.ndim)
            value = value + np.logaddexp.reduce(-0.5 * (around / self.sigma) ** 2, axis=0)
        return np.asarray(value)

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw n headings (n,) by rejection, not wrapped; the same state of the generator gives the same headings."""
        starts, width, log_height = self._histogram()
        mass = np.cumsum(np.exp(log_height - log_height.max()))
        parts: list[FloatArray] = []
        missing = n
        while missing > 0:
            drawn = int(1.1 * missing) + 10
            cell = np.minimum(np.searchsorted(mass, rng.uniform(0.0, mass[-1], drawn), side="right"), len(mass) - 1)
            theta: FloatArray = np.asarray(starts[cell] + width * rng.random(drawn), dtype=np.float64)
            accepted = np.log(rng.random(drawn)) < self.log(theta) - log_height[cell]
            parts.append(theta[accepted][:missing])
            missing -= len(parts[-1])
        return np.concatenate(parts) if parts else np.empty(0)

    def _histogram(self) -> tuple[FloatArray, float, FloatArray]:
        """Return starts (c,) and width of cells, and logarithms (c,) that the density does not exceed in them."""
        bend = abs(self.moment) + len(self.turns) / self.sigma**2
        width = 2.0 * np.pi / FIRST_CELLS
        starts: FloatArray = np.asarray(-np.pi + width * np.arange(FIRST_CELLS), dtype=np.float64)
        while True:
            above = bend * width**2 / 8.0
            log_height = np.maximum(self.log(starts), self.log(starts + width)) + above
            kept = log_height >= log_height.max() - above - NEGLIGIBLE
            starts, log_height = starts[kept], log_height[kept]
            if width * np.sqrt(bend) < 1.0 / CELLS_PER_DEVIATION:
                return starts, width, log_height
            width /= SPLIT
            starts = (starts[:, None] + width * np.arange(SPLIT)).ravel()
