"""What the tests of commands share."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import pytest

from beamfield.calibration import pose_windows
from beamfield.localization import trajectory_start
from beamfield.simulation import floor_plan
from beamfield.stacks.fit import fit_space, motion_candidates, replay_amount, replay_choice
from tests.few_poses import FEW_POSES, few_poses

# Out of the fixture: a process runs files of other packages in between, and comes back.
draw_once = cache(floor_plan.draw_floor_plan)


@pytest.fixture(scope="package", autouse=True)
def less_to_do() -> Iterator[None]:
    """Draw each floor plan once for all commands that simulate in it.

    Trajectories are searched for from few places: from where is tested elsewhere.
    """
    with pytest.MonkeyPatch.context() as patch, few_poses():
        patch.setattr(trajectory_start, "PLACES", 2)
        patch.setattr(floor_plan, "draw_floor_plan", draw_once)
        yield


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of reports out: drawing them takes most of the time of a short calibration."""
    monkeypatch.setattr("beamfield.report.html.report_figures", lambda *_, **__: [])


@pytest.fixture
def short_stack_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try few settings, numbers of beams and poses for a stack: which are tried is tested elsewhere."""
    few = replay_amount.ReplayOptions(runs=10, most_stretches=2, longest=12)
    monkeypatch.setattr(replay_amount, "OF_FIELDS", few)
    monkeypatch.setattr(replay_amount, "OF_RAYS", few)
    monkeypatch.setattr(replay_choice, "KEPT", 2)
    monkeypatch.setattr(replay_choice, "LAST", 1)
    monkeypatch.setattr(motion_candidates, "ALPHAS", ((0.05, 0.05),))
    monkeypatch.setattr(motion_candidates, "OMNI_ALPHAS", ())
    monkeypatch.setattr(fit_space, "BEAM_COUNTS", (9,))
    monkeypatch.setattr(pose_windows, "WindowOptions", FEW_POSES)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write pictures of likelihoods and of a robot's way empty, where only what is said about them is tested."""
    monkeypatch.setattr("beamfield.figures.likelihood_over_map.likelihood_figure", lambda *_, **__: None)
    monkeypatch.setattr("beamfield.figures.localization.localization_figure", lambda *_, **__: None)
    monkeypatch.setattr("beamfield.figures.gallery.save_figure", lambda _, path: path.touch())
