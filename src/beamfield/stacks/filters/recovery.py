"""How large a share of random poses a filter mixes in when its weights drop."""

from __future__ import annotations


class WeightAverages:
    """A slow and a fast average of the particles' mean weight.

    Parameters
    ----------
    slow, fast
        Rates; with 0 the average stays at its first value.

    References
    ----------
    Probabilistic Robotics, Table 8.3 (Augmented MCL).
    """

    def __init__(self, slow: float, fast: float) -> None:
        self._rates = slow, fast
        self._averages = [0.0, 0.0]

    def add(self, weight: float) -> None:
        """Take in the mean weight of an update."""
        self._averages = [
            weight if average == 0.0 else average + rate * (weight - average)
            for average, rate in zip(self._averages, self._rates, strict=True)
        ]

    def random_share(self) -> float:
        """Return the share of particles to draw at random: how far the fast average has fallen below the slow one."""
        slow, fast = self._averages
        return max(0.0, 1.0 - fast / slow) if slow > 0.0 else 0.0

    def reset(self) -> None:
        """Forget all weights, as after every resampling that mixed random poses in."""
        self._averages = [0.0, 0.0]
