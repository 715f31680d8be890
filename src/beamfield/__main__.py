"""Run the command line as ``python -m beamfield``."""

import sys

from beamfield.cli.main import main

sys.exit(main())
