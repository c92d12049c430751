"""The parts of `energyopt.plotting`: the common look, and one module a figure.

Matplotlib keeps its list of fonts in the user's home. Where that cannot be written it would make a new folder in every process,
and say so in two lines on standard error; here the list is kept beside the compiled kernels then. ``MPLCONFIGDIR``, where it is
set, stays as it is.
"""

import os
import sys
from pathlib import Path

from energyopt.dynamics.compiler import cache_folder


def _find_a_home_for_matplotlib() -> None:
    if "matplotlib" in sys.modules or os.environ.get("MPLCONFIGDIR"):
        return
    home = os.path.expanduser("~")
    places = {"XDG_CONFIG_HOME": ".config", "XDG_CACHE_HOME": ".cache"}
    folders = [Path(os.environ.get(variable) or os.path.join(home, usual)) for variable, usual in places.items()]
    if not all(_can_be_written(folder / "matplotlib") for folder in folders):
        os.environ["MPLCONFIGDIR"] = str(cache_folder() / "matplotlib")


def _can_be_written(folder: Path) -> bool:
    """Whether the folder is there, or can be made (as Matplotlib will), and can be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


_find_a_home_for_matplotlib()
