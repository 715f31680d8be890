"""Logs of the CoreSLAM (tinySLAM) examples: one line of numbers per scan of a Hokuyo URG-04LX."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.io.files.text_lines import word_lines
from beamfield.io.logs.text_scans import DEFAULTS, TextOptions, TextScans
from beamfield.sensors import ScanLog

N_BEAMS = 682
RANGES_FROM = 24
# URG-04LX: 1024 steps a turn, steps 44 to 725 are measured, step 384 points ahead.
STEP = 2.0 * np.pi / 1024.0
FRONT = 384 - 44
# Below 20 mm the sensor writes error codes instead of ranges.
MIN_RANGE = 0.02


def read_coreslam(path: str | Path, options: TextOptions = DEFAULTS) -> ScanLog:
    """Read a log of the CoreSLAM examples, plain or gzip; its sensor is called ``laser``.

    Word 1 of a line is the time in microseconds, words 3 and 4 count the ticks of the wheels, words 25 to 706 are 682
    ranges in millimetres over 240 degrees, 0 for "no return"; one more word may follow. The file says neither how far a
    tick is nor where the laser is mounted, so there is no odometry and the mount is 0.

    Raises
    ------
    FormatError
        If a line has another number of words or something else than numbers.

    References
    ----------
    Steux and El Hamzaoui, "tinySLAM: a SLAM algorithm in less than 200 lines of C", 2010. Hokuyo URG-04LX
    specification: step numbers, error codes.
    """
    source = Path(path)
    scans = TextScans(source, "laser")
    most = RANGES_FROM + N_BEAMS + 1
    for line in word_lines(source):
        if len(line.words) not in (most - 1, most):
            raise line.error(f"expected {most - 1} or {most} words, got {len(line.words)}: the line is cut off?")
        (stamp,) = line.numbers(0, 1, "time")
        scans.add(line.number, line.numbers(RANGES_FROM, most - 1, "ranges") / 1000.0, (stamp / 1e6,))
    if not len(scans):
        raise FormatError(source, "no scans: the file is empty")
    beams = np.column_stack([np.zeros((N_BEAMS, 2)), (np.arange(N_BEAMS) - FRONT) * STEP])
    sensor, notes = scans.finish(beams, options, declared_min=MIN_RANGE)
    notes.append("laser: wheel ticks are not read as odometry, because the file does not give their length")
    return ScanLog({"laser": sensor}, None, str(source), tuple(notes))
