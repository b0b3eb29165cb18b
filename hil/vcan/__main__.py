"""``python -m hil.vcan`` is ``hil vcan``, for use before anything else is installed."""

import sys

from hil.cli import main

sys.exit(main(["vcan", *sys.argv[1:]]))
