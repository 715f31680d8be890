"""Write what joins the versions of the site: ``python docs/make_versions.py site``.

Each version stands in a folder of its own, site/0.1.0; older ones stay as they were built. versions.js tells all
which there are, and index.html leads to the newest.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path


def main(site: Path) -> None:
    """List the versions, newest first."""
    versions = sorted((path.parent.name for path in site.glob("*/index.html")), key=numbers, reverse=True)
    (site / "versions.js").write_text(f"window.VERSIONS = {json.dumps(versions)};\n", encoding="utf-8")
    newest = f'<meta http-equiv="refresh" content="0; url={versions[0]}/index.html">'
    (site / "index.html").write_text(f"<!doctype html><title>beamfield</title>{newest}\n", encoding="utf-8")


def numbers(version: str) -> list[int]:
    """Return the numbers of a version, so that 0.10 comes after 0.9."""
    return [int(number) for number in re.findall(r"\d+", version)]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
