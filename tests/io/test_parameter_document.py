"""What beamfield's own files of parameters share."""

from __future__ import annotations

import math

import pytest
from ruamel.yaml import YAML

from beamfield.io.parameters.document import document_text


@pytest.mark.parametrize("open_interval", [(0.0, math.inf), (math.nan, math.nan)], ids=["no upper end", "unknown"])
def test_an_interval_that_is_not_determined_is_null(open_interval):
    text = document_text("# head\n", {"model": {"a": 1.0}}, intervals={"a": (0.1, 0.2), "b": open_interval})
    assert text.startswith("# head\n")
    assert YAML(typ="safe").load(text)["intervals_95"] == {"a": [0.1, 0.2], "b": None}
