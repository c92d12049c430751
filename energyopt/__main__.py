"""``python -m energyopt`` is the command ``energyopt``."""

import os

try:
    from energyopt import stopping
except KeyboardInterrupt:  # Ctrl-C before it can be heard
    os._exit(130)


def run() -> None:
    """Hear Ctrl-C before anything slow is imported."""
    stopping.run(_command)


def _command() -> int:
    from energyopt.cli import main

    return main()


if __name__ == "__main__":
    run()
