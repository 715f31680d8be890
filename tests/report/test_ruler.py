"""Rulers against matplotlib's own axes."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from beamfield.report.drawing import log_scale, new_axes, new_figure, new_panel, style
from beamfield.report.ruler import use_rulers


def pixels(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3].astype(int)


def linear():
    figure, axes = new_axes(4.7, 3.0, title="a title", x="time [s]", y="two\nlines [m]")
    axes.plot([-3.2, 7.1], [0.2, 1.9])
    return figure


def named_places():
    figure, axes = new_axes(4.7, 3.0, x="gain [nats]", grid="x")
    axes.plot([0.1, 0.4], [0, 1], "o")
    axes.set_yticks([0, 1], ["plain Gaussian", "range offset"])
    return figure


def logarithmic_and_shared():
    figure = new_panel(4.7, 4.6)
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot([1.0, 30.0], [1e-4, 2.0])
    log_scale(above)
    style(above, y="density [1/m]", grid="y")
    below.plot([1.0, 30.0], [0.0, 1.0])
    below.invert_yaxis()
    style(below, x="range [m]", y="share [1]", grid="none")
    return figure


@pytest.mark.parametrize("make", [linear, named_places, logarithmic_and_shared])
def test_a_ruler_draws_what_matplotlib_draws(make):
    expected, figure = pixels(make()), make()
    use_rulers(figure)
    assert not any(axes.xaxis.get_visible() or axes.yaxis.get_visible() for axes in figure.axes)
    difference = np.abs(pixels(figure) - expected).max(axis=2)
    # Where a label is half a pixel off, its edges have another grey.
    assert (difference > 64).mean() < 0.002
    assert (expected < 128).all(axis=2).mean() > 0.005


def test_the_factor_of_large_numbers_is_shown():
    figure, axes = new_axes(4.7, 3.0)
    axes.plot([0.0, 1.0], [0.0, 3e7])
    use_rulers(figure)
    pixels(figure)
    assert axes.yaxis.offsetText.get_text() == "1e7"
    top = axes.bbox.y1
    assert top <= axes.yaxis.offsetText.get_window_extent().y0 < top + 20


def test_other_figures_stay_as_they_are():
    for figure in (new_figure(4.7, 3.0), Figure()):
        axes = figure.add_subplot()
        use_rulers(figure)
        assert axes.xaxis.get_visible()
