"""The names of `beamfield.fleet` for type checkers and editors."""

from beamfield.fleet.comparison import compare_robots as compare_robots
from beamfield.fleet.daily import daily_series as daily_series
from beamfield.fleet.drift import find_drift as find_drift
from beamfield.fleet.engine import Engine as Engine
from beamfield.fleet.fleet_report import judge_fleet as judge_fleet
from beamfield.fleet.hierarchy import pool as pool
from beamfield.fleet.learning import learn as learn
from beamfield.fleet.report_files import write_fleet_report as write_fleet_report
from beamfield.fleet.scan import scan_fleet as scan_fleet
from beamfield.fleet.stale_map import find_stale_places as find_stale_places
