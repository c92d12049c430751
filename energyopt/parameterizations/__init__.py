"""Ways to describe a motion with finitely many numbers, and the numeric trajectories they give."""

from energyopt.parameterizations.trajectory import (
    PolynomialTrajectory,
    SinusoidTrajectory,
    SplineTrajectory,
    Trajectory,
    trajectory_from_arrays,
)

__all__ = ["PolynomialTrajectory", "SinusoidTrajectory", "SplineTrajectory", "Trajectory", "trajectory_from_arrays"]
