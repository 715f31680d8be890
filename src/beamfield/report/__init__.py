"""The calibration report: figures, one HTML page, plain-text tables and a JSON document.

Entry points: `html.render_report`, `text_table.parameter_table`, `text_table.score_table`,
`as_json.calibration_as_dict`. Each figure is a function of its own in one of the ``*_figures`` modules;
`figures.report_figures` puts them in the order of the page.
"""
