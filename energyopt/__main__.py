"""``python -m energyopt`` is the command ``energyopt``."""

import sys

from energyopt.cli import main

if __name__ == "__main__":
    sys.exit(main())
