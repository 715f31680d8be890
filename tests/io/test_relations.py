"""Relations are read line by line, and steps join what follows one another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.relations import chain, read_relations

TEXT = """# from to x y z roll pitch yaw
10.0 11.0 1.0 0.0 0 0 0 1.5707963267948966

12.0 11.0 -1.0 0.0 0 0 0 0.0
10.0 12.0 1.1 1.1 0 0 0 1.5
14.0 15.0 0.5 0.0 0 0 0 0.0
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "drive.relations"
    path.write_text(TEXT, encoding="ascii")
    return path


def test_moments_and_poses_are_read(path: Path) -> None:
    relations = read_relations(path)
    assert len(relations) == 4
    assert relations.stamps[1].tolist() == [12.0, 11.0]
    assert relations.poses[2].tolist() == [1.1, 1.1, 1.5]


def test_steps_run_forward_and_skip_what_no_relation_joins(path: Path) -> None:
    moments, steps = read_relations(path).steps()
    assert moments.tolist() == [10.0, 11.0, 12.0, 14.0, 15.0]
    np.testing.assert_allclose(steps[:2], [[1.0, 0.0, np.pi / 2], [1.0, 0.0, 0.0]])
    assert np.isnan(steps[2]).all()
    np.testing.assert_allclose(steps[3], [0.5, 0.0, 0.0])
    np.testing.assert_allclose(chain(steps[:2]), [1.0, 1.0, np.pi / 2], atol=1e-12)


def test_an_empty_file_has_no_relations(tmp_path: Path) -> None:
    path = tmp_path / "empty"
    path.write_text("# nothing\n", encoding="ascii")
    moments, steps = read_relations(path).steps()
    assert len(moments) == len(steps) == 0


@pytest.mark.parametrize("bad", ["1 2 3", "1 2 3 4 5 6 7 nan", "1 2 x 4 5 6 7 8", "1 2 3 4 5 6 7 8 9"])
def test_other_lines_are_refused_with_their_number(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "bad"
    path.write_text(TEXT + bad + "\n", encoding="ascii")
    with pytest.raises(FormatError) as caught:
        read_relations(path)
    assert "7" in str(caught.value)
    assert str(path) in str(caught.value)
