"""Read a map, whatever file it is in."""

from __future__ import annotations

import os
from pathlib import Path

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.bag_storage import BAG_SUFFIXES
from beamfield.io.maps.map_image import MAX_PIXELS
from beamfield.io.maps.ros_map import read_ros_map
from beamfield.io.maps.wean_map import read_wean_map
from beamfield.maps.occupancy import OccupancyGrid

_PICTURES = (".pgm", ".png", ".bmp")


def read_map(path: str | os.PathLike[str], *, topic: str | None = None, max_pixels: int = MAX_PIXELS) -> OccupancyGrid:
    """Read an occupancy grid.

    Parameters
    ----------
    path
        A map_server YAML file; Wean Hall's .dat or .dat.gz; or a ROS bag (.bag, .mcap, .db3 or a ROS 2 folder) with a
        nav_msgs/OccupancyGrid.
    topic
        The topic of the map in a bag; None if the bag has only one.
    max_pixels
        Larger pictures are refused before they are decoded.

    Raises
    ------
    FormatError
        If the content is not what its format promises, or of no known format.
    InvalidInputError
        If `topic` is given for a file that is not a bag.
    OSError
        As the file system says.
    """
    source = Path(path)
    if source.is_dir() or source.suffix in BAG_SUFFIXES:
        # Here, because only bags need the extra package that reads them.
        from beamfield.io.bags.reader import read_bag_map

        return read_bag_map(source, topic=topic)
    if topic is not None:
        raise InvalidInputError(f"{source}: topic applies to bags only, and this is not a bag; got {topic!r}")
    if source.suffix in (".yaml", ".yml"):
        return read_ros_map(source, max_pixels=max_pixels)
    if source.suffix == ".dat" or source.name.endswith(".dat.gz"):
        return read_wean_map(source, max_cells=max_pixels)
    source.stat()  # a name that does not exist is the first thing to say
    if source.suffix.lower() in _PICTURES:
        raise FormatError(source, "a picture has no resolution or origin: give the map_server YAML file that names it")
    raise FormatError(
        source, f"expected a map ending in .yaml, .yml, .dat, .dat.gz, {', '.join(BAG_SUFFIXES)} or a bag folder"
    )
