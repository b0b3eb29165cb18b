"""Importing the package loads none of its modules; ``tests/unit/test_public_api.py`` runs its examples."""

from __future__ import annotations

import subprocess
import sys


def test_importing_the_package_imports_none_of_its_modules() -> None:
    program = "import sys, design; sys.exit(any(name.startswith('design.') for name in sys.modules))"
    subprocess.run([sys.executable, "-c", program], check=True)
