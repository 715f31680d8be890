"""Shapes on the raster that floor plans are drawn on."""

import numpy as np
import pytest

from beamfield.geometry import invert, transform_points
from beamfield.simulation.drawing import Arc, Box, Canvas


@pytest.mark.parametrize("shape", [Box(-0.3, 0.2, 1.1, 0.5), Arc(0.4, -0.2, 0.6, 0.3, 0.0, 2.0)], ids=["box", "arc"])
@pytest.mark.parametrize("pose", [(2.0, 1.5, 0.7), (0.1, 2.9, -2.0), (9.0, 1.0, 0.0)], ids=["within", "border", "off"])
def test_a_shape_is_drawn_whole_and_nothing_besides(shape, pose):
    canvas = Canvas(4.0, 3.0, 0.05)
    canvas.carve(Box(0.0, 0.0, 4.0, 3.0))
    canvas.build(shape, np.array(pose))
    rows, cols = np.indices((60, 80))
    centres = np.stack([cols + 0.5, rows + 0.5], axis=-1) * 0.05
    x, y = np.moveaxis(transform_points(invert(pose), centres), -1, 0)
    np.testing.assert_array_equal(canvas.solid, shape.contains(x, y))
