"""The figure of filters on logs."""

from dataclasses import fields

from beamfield.localization.replay import ReplayErrors
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.report.evaluation import Evaluation
from beamfield.report.evaluation_figure import evaluation_figure


def test_a_dollar_in_the_name_of_a_file_begins_no_formula():
    errors = ReplayErrors(**{**{field.name: 0.1 for field in fields(ReplayErrors)}, "lost": False, "updates": 1})
    trials = [ReplayTrials("a.log", (0,), (errors,))]
    evaluation_figure(Evaluation({"$^$.yaml": trials}, {})).draw_without_rendering()
