"""The formats that commands read, as their help names them."""

from __future__ import annotations

# Not `SUPPORTED` of `beamfield.io.read_log`: that loads the numerical libraries, and --help is to answer at once.
LOG_FORMATS = (
    "CARMEN, Wean Hall, GMapping, g2o or CoreSLAM text, plain or .gz; a folder with measurement.txt and poses.txt; "
    "ROS 1 .bag; ROS 2 folder, .db3 or .mcap"
)
MAP_FORMATS = "map_server .yaml, Wean .dat, or a bag"
