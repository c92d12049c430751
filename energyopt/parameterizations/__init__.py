"""Ways to describe a motion with finitely many numbers, and the numeric trajectories they give."""

from energyopt.parameterizations.bspline import BSpline
from energyopt.parameterizations.hermite_simpson import HermiteSimpson
from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.sinusoid import Sinusoid
from energyopt.parameterizations.space import BoundaryState, MotionSpace, Unknowns
from energyopt.parameterizations.stored import trajectory_from_arrays
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory, Trajectory

__all__ = [
    "BSpline",
    "BoundaryState",
    "HermiteSimpson",
    "MotionSpace",
    "PathTrajectory",
    "PolynomialTrajectory",
    "Sinusoid",
    "SinusoidTrajectory",
    "SplineTrajectory",
    "Trajectory",
    "Unknowns",
    "trajectory_from_arrays",
]
