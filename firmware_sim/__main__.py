"""Entry point of ``python -m firmware_sim``, which is the command ``firmware-sim``."""

import sys

from firmware_sim.cli import main

sys.exit(main())
