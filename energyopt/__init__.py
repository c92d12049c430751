"""energyopt: energy-optimal motions for robot arms, planned by direct collocation and proved in simulation.

Names are imported when first used, so that ``import energyopt`` is quick and loads neither MuJoCo nor Matplotlib.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOME = {
    "BSpline": "parameterizations",
    "EnergyOptError": "errors",
    "FramePose": "problem",
    "HermiteSimpson": "parameterizations",
    "InputError": "errors",
    "NoSolutionFound": "errors",
    "Payload": "robots",
    "Plan": "plans",
    "Problem": "problem",
    "ReplayLog": "simulation",
    "RobotModel": "robots",
    "Sinusoid": "parameterizations",
    "Status": "plans",
    "Waypoint": "problem",
    "baseline": "baselines",
    "load_plan": "io",
    "load_problem": "io",
    "load_robot": "robots",
    "plan": "planning",
    "plot_joints": "plotting",
    "plot_metrics": "plotting",
    "replay": "simulation",
    "validate": "validation",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'energyopt' has no attribute '{name}'")
    value = getattr(import_module(f"energyopt.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted(__all__)
