"""`python -m calibration.cli`: the same as `softrod`."""

import sys

from calibration.cli.main import main

sys.exit(main())
