"""Figures of a plan: `plot_metrics` shows how it moves over time, `plot_joints` its joints against their limits.

Figures belong to the caller alone: nothing is shown, pyplot is not touched, the caller's settings of Matplotlib stay as
they are. ``figure.savefig(path)`` writes one.
"""

from energyopt.plots.joints import plot_joints
from energyopt.plots.over_time import plot_metrics

__all__ = ["plot_joints", "plot_metrics"]
