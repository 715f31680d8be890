"""Tests of the fleet need its extra."""

from __future__ import annotations

from importlib.util import find_spec

collect_ignore_glob: list[str] = []
if any(find_spec(name) is None for name in ("distributed", "fsspec", "pyarrow")):
    collect_ignore_glob.append("test_*.py")
