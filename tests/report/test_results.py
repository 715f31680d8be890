"""What results say, draw and write of themselves, and that all that people hold is short to look at."""

from __future__ import annotations

import dataclasses
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import beamfield as bf
from beamfield.errors import InvalidInputError, MissingDependencyError
from beamfield.report.text_table import form_line, parameter_table, score_table
from beamfield.scan_fit.scan_fit import ScanFits
from beamfield.scan_fit.statistics import FitStatistics
from beamfield.sensors import Track


@pytest.fixture
def fits() -> ScanFits:
    numbers = np.linspace(0.1, 1.0, 6)
    values = {item.name: numbers for item in dataclasses.fields(FitStatistics)}
    return ScanFits(np.arange(6.0), FitStatistics(**values | {"n_beams": np.full(6, 9)}), numbers, 1.0 - numbers,
                    np.array([0, 0, 0, 0, 3, 4], np.int8))  # fmt: skip


class TestCalibration:
    def test_its_summary_is_what_the_command_prints(self, case):
        text = case.calibration.summary()
        assert parameter_table(case.calibration) in text
        assert f"{score_table(case.calibration)}\n{form_line(case.calibration)}\n" in text
        assert text.endswith("warning (poor-map): The map is poor. It matters. Draw a better one.")

    def test_its_picture_has_the_readings_and_the_fit(self, case):
        figure = case.calibration.plot()
        assert isinstance(figure, Figure)
        assert all(axes.lines or axes.patches or axes.collections for axes in figure.axes)

    def test_a_notebook_shows_table_warnings_and_picture(self, case):
        markup = case.calibration._repr_html_()
        assert markup.index(">sigma_hit</th>") < markup.index("The map is poor.") < markup.index("<svg")
        assert "The poses are good" not in markup

    def test_it_saves_what_a_model_takes(self, case, tmp_path):
        case.calibration.save(tmp_path / "beam_model.yaml")
        parameters = bf.read_beam_model(tmp_path / "beam_model.yaml")
        assert parameters.sigma_hit == pytest.approx(case.calibration.parameters.sigma_hit, rel=1e-5)
        assert "/scan" in (tmp_path / "beam_model.yaml").read_text()

    def test_all_that_is_held_is_a_few_lines(self, case):
        for held in (case.calibration, case.calibration.table, case.calibration.intervals, case.log, case.log[3],
                     case.log.finder, case.grid, bf.BeamModel(case.grid, case.calibration.parameters)):  # fmt: skip
            text = repr(held)
            assert text.startswith(f"{type(held).__name__}(")
            assert len(text) < 2500
            assert max(len(line) for line in text.splitlines()) <= 110
        assert "72 x 3 numbers" in repr(case.log.finder)
        assert f"sigma_hit={case.calibration.parameters.sigma_hit:.6g}" in repr(case.calibration)


class TestScanFits:
    def test_they_say_draw_and_write_themselves(self, fits, tmp_path):
        lost, fit, *_ = fits.summary().splitlines()
        assert lost == "lost probability above 0.5 for 2.0 s at the longest, from 0.0 to 2.0 s after the first scan"
        assert fit.startswith("100.0% of 6 scans fit at 5%")
        figure = fits.plot()
        assert [axes.get_ylabel() for axes in figure.axes] == ["p-value [1]", "lost probability [1]"]
        # The worst scans of a log whose robot begins lost are at the lower left, where a legend would hide them.
        figure.draw_without_rendering()
        assert figure.axes[0].get_legend().get_window_extent().y0 >= figure.axes[0].get_window_extent().y1
        fits.save(tmp_path / "fit.csv")
        assert len((tmp_path / "fit.csv").read_text().splitlines()) == 7

    def test_there_is_no_picture_of_nothing(self, fits):
        with pytest.raises(InvalidInputError, match="expected a scan that could be judged"):
            dataclasses.replace(fits, p_value=np.full(6, np.nan)).plot()


class TestDataFrames:
    def test_tables_become_frames_where_pandas_is(self, fits, case, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
        frame = fits.to_dataframe()
        assert frame["problem"].tolist() == ["", "", "", "", "off the map", "inside a wall"]
        assert {len(column) for column in frame.values()} == {6}
        table = case.calibration.table
        assert table.to_dataframe()["expected_range"] is table.expected_ranges
        track = Track(np.array([0.5]), np.array([[1.0, 2.0, 3.0]]))
        assert {name: column.tolist() for name, column in track.to_dataframe().items()} == {
            "stamp": [0.5], "x": [1.0], "y": [2.0], "theta": [3.0]}  # fmt: skip

    def test_without_pandas_the_error_says_what_to_install(self, case, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(MissingDependencyError, match="pip install pandas"):
            case.calibration.table.to_dataframe()
