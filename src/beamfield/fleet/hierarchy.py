"""Partial pooling: parameters per fleet, site and robot that borrow from one another what the data lack."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamfield.arguments import checked
from beamfield.errors import TooLittleDataError
from beamfield.fleet.learning import FleetFit, GroupFit
from beamfield.fleet.shard_passes import SensorLimits
from beamfield.fleet.transformed import NAMES, UNKNOWN, intervals_from, parameters_from, transformed
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

# Standard deviations between robots and between sites that are tried, up to so many times that of the estimates, denser
# near 0. Two robots may well lie 10 times as close as others would: with 3, intervals of their centre hold it in 80%.
_GRID = np.linspace(0.0, 1.0, 61)[1:]
_WIDEST_ROBOTS, _WIDEST_SITES = 10.0, 3.0
# 95% of a normal distribution.
_REACH = 1.959963984540054


@dataclass(frozen=True, eq=False)
class Pooled:
    """Pooled parameters of the fleet, a site or a robot.

    Parameters
    ----------
    site, robot
        Whose; None for those of all.
    parameters
        Posterior means of the transformed parameters, as a beam model.
    intervals
        (low, high) that hold the truth with 95%, by the names of `BeamParameters` that were learned.
    shrinkage
        By the same names less z_hit, for robots: 0 where the robot's own estimate stands, 1 where that of its site
        takes its place. Empty for sites and the fleet.
    """

    site: str | None
    robot: str | None
    parameters: BeamParameters
    intervals: Mapping[str, tuple[float, float]]
    shrinkage: Mapping[str, float]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Partial pooling of robots with sensors of equal limits.

    Parameters
    ----------
    limits
        Limits of the sensors.
    fleet, sites, robots
        Pooled parameters; those of the fleet and of a site are the centre of their members.
    spread_of_robots, spread_of_sites
        Standard deviation between the robots of a site, and between sites, of the transformed parameters: log odds of
        a weight against z_hit, log of sigma_hit and of lambda_short, range_offset. By the names of `BeamParameters`.
    """

    limits: SensorLimits
    fleet: Pooled
    sites: tuple[Pooled, ...]
    robots: tuple[Pooled, ...]
    spread_of_robots: Mapping[str, float]
    spread_of_sites: Mapping[str, float]

    __repr__ = short_repr


@checked
def pool(fit: FleetFit) -> tuple[Hierarchy, ...]:
    """Pool the parameters of robots: each keeps what its own beams determine, and borrows the rest.

    A robot with a month of beams keeps its own parameters; one with ten minutes gets mostly those of its site, and a
    new site mostly those of the fleet.

    Parameters
    ----------
    fit
        Of ``learn(by="robot")``.

    Returns
    -------
    One hierarchy per set of sensor limits, in their order.

    Raises
    ------
    InvalidInputError
        If the fit is not one by robot.
    TooLittleDataError
        If a parameter other than lambda_short and range_offset has no interval in any robot.

    Notes
    -----
    See `partial_pooling`, which pools one transformed parameter at a time: log odds of z_short, z_max and z_rand
    against z_hit, log sigma_hit, log lambda_short, and range_offset, with the variances of the block jackknife. What
    links the errors of two parameters of a robot is left out. A weight that was learned as 0 counts as its one-sided
    interval says, a lambda_short that no beam determines not at all.
    """
    return tuple(_hierarchy(robots) for robots in fit.robots_by_limits())


@dataclass(frozen=True, eq=False)
class Pooling:
    """Posterior of one parameter in a fleet.

    Parameters
    ----------
    fleet, sites, robots
        Means and variances: of shape (2,), (2, s) in the order of the sites' names, and (2, n).
    shrinkage
        (n,) weight of its site in each robot's mean.
    spread_of_robots, spread_of_sites
        Posterior means of the standard deviations.
    """

    fleet: FloatArray
    sites: FloatArray
    robots: FloatArray
    shrinkage: FloatArray
    spread_of_robots: float
    spread_of_sites: float


def partial_pooling(values: FloatArray, variances: FloatArray, sites: Sequence[str]) -> Pooling:
    """Pool one parameter of robots in sites.

    Parameters
    ----------
    values, variances
        Estimates of n robots, and their error variances, positive, shape (n,).
    sites
        Each robot's.

    Notes
    -----
    Estimates are normal about a robot's value, robots about their site's with the variance r^2, and sites about the
    fleet's with s^2. With r and s given, all posteriors are closed forms (those of best linear unbiased prediction,
    which account for the fleet's mean being estimated). r and s come from the data, by restricted likelihood under
    flat priors on r and s; posteriors are averaged over both, so that a fleet of three sites does not look as if its
    spread were known. A fleet of one site has s = 0.

    References
    ----------
    Efron and Morris, "Data analysis using Stein's estimator and its generalizations", JASA 70, 1975.
    Gelman, "Prior distributions for variance parameters in hierarchical models", Bayesian Analysis 1, 2006.

    Examples
    --------
    Three robots that are known well keep their values; the fourth, known badly, borrows:

    >>> variances = np.array([0.01, 0.01, 0.01, 100.0])
    >>> pooling = partial_pooling(np.array([1.0, 2.0, 3.0, 9.0]), variances, ["north"] * 4)
    >>> pooling.robots[0].round(1).tolist(), pooling.shrinkage.round(1).tolist()
    ([1.0, 2.0, 3.0, 2.9], [0.0, 0.0, 0.0, 0.9])
    """
    names, of_site = np.unique(np.asarray(sites), return_inverse=True)
    member = (of_site[:, None] == np.arange(len(names))).astype(np.float64)  # (n, s)
    r, s, log_prior = _spreads(values, variances, n_sites=len(names))

    total = variances + r[:, None] ** 2  # (g, n) over the grid of r and s
    precision = (1.0 / total) @ member  # (g, s) of a site's mean, by its robots
    means = (values / total) @ member / precision
    of_sites = s[:, None] ** 2 + 1.0 / precision
    fleet_variance = 1.0 / (1.0 / of_sites).sum(axis=1)
    fleet = (means / of_sites).sum(axis=1) * fleet_variance
    log_likelihood = -0.5 * (
        (np.log(total) + (values - means[:, of_site]) ** 2 / total).sum(axis=1)
        + (np.log(precision) + np.log(of_sites) + (means - fleet[:, None]) ** 2 / of_sites).sum(axis=1)
        - np.log(fleet_variance)
    )
    share = np.exp(log_likelihood + log_prior - (log_likelihood + log_prior).max())
    share /= share.sum()

    borrowed = 1.0 / precision / of_sites
    site = borrowed * fleet[:, None] + (1.0 - borrowed) * means
    site_variance = (1.0 - borrowed) / precision + borrowed**2 * fleet_variance[:, None]
    shrinkage = variances / total
    robot = shrinkage * site[:, of_site] + (1.0 - shrinkage) * values
    robot_variance = shrinkage * r[:, None] ** 2 + shrinkage**2 * site_variance[:, of_site]
    return Pooling(
        fleet=_averaged(share, fleet[:, None], fleet_variance[:, None])[:, 0],
        sites=_averaged(share, site, site_variance),
        robots=_averaged(share, robot, robot_variance),
        shrinkage=share @ shrinkage,
        spread_of_robots=float(share @ r),
        spread_of_sites=float(share @ s),
    )


def _spreads(values: FloatArray, variances: FloatArray, n_sites: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pairs of r and s that are tried, (g,) each, and the log prior of each, for points denser near 0."""
    known = variances < UNKNOWN
    usual = float(np.std(values[known])) if known.any() else 0.0
    of_sites = _WIDEST_SITES * usual * _GRID**2 if n_sites > 1 else np.zeros(1)
    r, s = np.meshgrid(_WIDEST_ROBOTS * usual * _GRID**2, of_sites)
    density = np.outer(_GRID if n_sites > 1 else np.ones(1), _GRID)
    return r.reshape(-1), s.reshape(-1), np.log(density.reshape(-1))


def _averaged(share: FloatArray, means: FloatArray, variances: FloatArray) -> FloatArray:
    mean = share @ means
    return np.stack([mean, share @ (variances + (means - mean) ** 2)])


def _hierarchy(fits: Sequence[GroupFit]) -> Hierarchy:
    estimates = [transformed(item) for item in fits]
    values, variances = (np.stack([estimate[i] for estimate in estimates]) for i in range(2))
    sites = [item.site or "" for item in fits]
    poolings = [partial_pooling(values[:, i], variances[:, i], sites) for i in range(len(NAMES))]
    shrinkage = np.stack([pooling.shrinkage for pooling in poolings])
    known = np.any(variances < UNKNOWN, axis=0)
    for name in np.array(NAMES[:4])[~known[:4]]:
        raise TooLittleDataError(f"{name}: no robot has beams of two blocks of time that determine it")

    def pooled(site: str | None, robot: str | None, moments: list[FloatArray], own: FloatArray | None = None) -> Pooled:
        mean, variance = np.stack(moments).T
        intervals = intervals_from(mean, variance, _REACH)
        for name in np.array(NAMES)[~known]:
            del intervals[name]
        shares = {} if own is None else {name: float(own[i]) for i, name in enumerate(NAMES) if known[i]}
        parameters = parameters_from(mean)
        if not known[NAMES.index("lambda_short")]:  # shorts uniform, as where there are none
            parameters = replace(parameters, lambda_short=0.0)
        return Pooled(site, robot, parameters, intervals, shares)

    return Hierarchy(
        fits[0].limits,
        fleet=pooled(None, None, [pooling.fleet for pooling in poolings]),
        sites=tuple(
            pooled(site, None, [pooling.sites[:, k] for pooling in poolings])
            for k, site in enumerate(sorted(set(sites)))
        ),
        robots=tuple(
            pooled(item.site, item.robot, [pooling.robots[:, k] for pooling in poolings], shrinkage[:, k])
            for k, item in enumerate(fits)
        ),
        spread_of_robots={name: poolings[i].spread_of_robots for i, name in enumerate(NAMES) if known[i]},
        spread_of_sites={name: poolings[i].spread_of_sites for i, name in enumerate(NAMES) if known[i]},
    )
