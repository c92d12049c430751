"""Trajectories from the numbers that define them: the inverse of `Trajectory.to_arrays`."""

from __future__ import annotations

import numpy as np

from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory, Trajectory


def trajectory_from_arrays(kind: str, arrays: dict[str, np.ndarray]) -> Trajectory:
    """Make the trajectory whose `to_arrays` gave ``arrays``; the numbers are the same bit for bit."""
    if kind == SplineTrajectory.kind:
        return SplineTrajectory(arrays["knots"], arrays["coefficients"], int(arrays["degree"]))
    if kind == PolynomialTrajectory.kind:
        return PolynomialTrajectory(arrays["breaks"], arrays["coefficients"])
    if kind == SinusoidTrajectory.kind:
        return SinusoidTrajectory(float(arrays["duration"]), arrays["polynomial"], arrays["sine"], arrays["cosine"])
    if kind == PathTrajectory.kind:
        return PathTrajectory(_part(arrays, "path"), _part(arrays, "law"))
    raise ValueError(f"unknown kind of trajectory '{kind}'")


def _part(arrays: dict[str, np.ndarray], name: str) -> Trajectory:
    own = {key.removeprefix(f"{name}."): value for key, value in arrays.items() if key.startswith(f"{name}.")}
    return trajectory_from_arrays(np.asarray(own.pop("kind"), np.uint8).tobytes().decode(), own)
