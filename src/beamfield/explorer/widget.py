"""The explorer in a notebook: Jupyter, marimo, and whatever else shows anywidgets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.errors import BeamfieldError, needs
from beamfield.explorer.open_session import open_session
from beamfield.explorer.parameter_set import read_set
from beamfield.explorer.server import MODULES, as_json, page_file
from beamfield.explorer.session import Session
from beamfield.explorer.shown_run import read_shown_run
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog

if TYPE_CHECKING:
    from anywidget import AnyWidget

# The component asks by messages of the notebook in place of requests to a server.
RENDER = """
async function render({ model, el }) {
  const waiting = new Map();
  let asked = 0;
  model.on("msg:custom", ({ id, answer, error }) => {
    const [use, fail] = waiting.get(id) ?? [];
    waiting.delete(id);
    if (error !== undefined) fail?.(new Error(error)); else use?.(answer);
  });
  const ask = (message) => new Promise((use, fail) => {
    waiting.set(++asked, [use, fail]);
    model.send({ id: asked, message });
  });
  const root = document.createElement("div");
  root.className = "beamfield-explorer in-notebook";
  el.append(root);
  await mount(root, ask);
}
export default { render };
"""


def explore(
    log: SensorLog,
    grid: OccupancyGrid,
    files: Sequence[str | Path] = (),
    *,
    run: str | Path | None = None,
    fit: bool = True,
) -> AnyWidget:
    """Return a widget in which to move the robot of a log, and see what models say of its scans.

    Parameters
    ----------
    log
        Scans of a laser scanner, with reference poses for all that judges, and odometry for filters.
    grid
        The map.
    files
        Parameter files to compare: beam_model.yaml, likelihood_field.yaml, or of nav2, ROS 1 amcl, Beluga, MRPT or
        F1TENTH.
    run
        A filter's run to show: the folder that ``beamfield localize`` wrote, or a trajectory that `read_trajectory`
        reads.
    fit
        Whether to learn a beam model and a likelihood field from the log first, and to judge its scans: some seconds.

    Raises
    ------
    InvalidInputError
        If the log has no scans.
    FormatError
        If a file cannot be used, or the run is of another log.
    MissingDependencyError
        If anywidget is not installed.

    References
    ----------
    Probabilistic Robotics, Figures 6.3, 6.4 and 6.7, to be moved by hand.
    """
    sets = [read_set(Path(file), grid, log.finder) for file in files]
    shown = None if run is None else read_shown_run(Path(run), log, grid)
    session, _ = open_session(log, grid, sets, run=shown, fit=fit)
    return session_widget(session)


def session_widget(session: Session) -> AnyWidget:
    """Return the widget of a session."""
    with needs("anywidget", "notebook", "the explorer in a notebook"):
        import anywidget

    class Explorer(anywidget.AnyWidget):  # type: ignore[misc, unused-ignore]
        """The page's component."""

        _esm = component() + RENDER
        _css = page_file("explorer.css").decode()

    widget: Any = Explorer()
    widget.on_msg(lambda _, content, __: widget.send(answered(session, content)))
    return widget  # type: ignore[no-any-return]


def component() -> str:
    """Return the page's modules as one, as a notebook has it: none of their names occurs twice."""
    lines = "\n".join(page_file(name).decode() for name in MODULES).splitlines()
    kept = (line.removeprefix("export ") for line in lines if not line.startswith("import "))
    return "\n".join(kept)


def answered(session: Session, content: Any) -> dict[str, Any]:
    """Return the answer to a message of the component, or why there is none."""
    number = content.get("id") if isinstance(content, dict) else None
    try:
        answer = session.answer(content.get("message") if isinstance(content, dict) else None)
    except BeamfieldError as error:
        return {"id": number, "error": str(error)}
    return {"id": number, "answer": json.loads(as_json(answer))}
