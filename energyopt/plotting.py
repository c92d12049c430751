"""Figures of a plan: `plot_metrics` shows how it moves over time, `plot_joints` its joints against their limits, `plot_clearance`
how far it stays from what it must not touch, `plot_energy` where its joules go, `plot_robustness` what other arms make of it,
`plot_scene` the arm's sweep in space; `plot_sweep` shows cost against duration.

Figures belong to the caller alone: nothing is shown, pyplot is not touched, the caller's settings of Matplotlib stay as
they are. ``figure.savefig(path)`` writes one.
"""

from energyopt.plots.energy_time import plot_sweep
from energyopt.plots.joints import plot_joints
from energyopt.plots.over_cases import plot_robustness
from energyopt.plots.over_causes import plot_energy
from energyopt.plots.over_distance import plot_clearance
from energyopt.plots.over_time import plot_metrics
from energyopt.plots.scene import plot_scene

__all__ = [
    "plot_clearance",
    "plot_energy",
    "plot_joints",
    "plot_metrics",
    "plot_robustness",
    "plot_scene",
    "plot_sweep",
]
