"""energyopt: energy-optimal motions for robot arms, planned by direct collocation and proved in simulation.

Names are imported when first used, so that ``import energyopt`` is quick and loads neither MuJoCo nor Matplotlib.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOME = {
    "ActuatorModel": "actuators",
    "Actuators": "actuators",
    "Attached": "geometry",
    "BatchInterrupted": "errors",
    "BSpline": "parameterizations",
    "Box": "geometry",
    "Capsule": "geometry",
    "ConvexMesh": "geometry",
    "Cylinder": "geometry",
    "EnergyOptError": "errors",
    "FramePose": "problem",
    "HalfSpace": "geometry",
    "HermiteSimpson": "parameterizations",
    "InputError": "errors",
    "Moving": "geometry",
    "NoSolutionFound": "errors",
    "Payload": "robots",
    "Plan": "plans",
    "PlanFailure": "batch",
    "Problem": "problem",
    "ReplayLog": "simulation",
    "RepulsivePotential": "geometry",
    "RobotModel": "robots",
    "Sinusoid": "parameterizations",
    "Sphere": "geometry",
    "Status": "plans",
    "Waypoint": "problem",
    "Workspace": "geometry",
    "baseline": "baselines",
    "energy_account": "energy",
    "duration_bounds": "durations",
    "judge": "judging",
    "load_plan": "io",
    "load_problem": "io",
    "load_robot": "robots",
    "minimum_duration": "durations",
    "plan": "planning",
    "plan_each": "batch",
    "plan_many": "batch",
    "plan_sequence": "sequence",
    "plan_robust": "robust",
    "plot_clearance": "plotting",
    "plot_energy": "plotting",
    "plot_joints": "plotting",
    "plot_metrics": "plotting",
    "plot_robustness": "plotting",
    "plot_scene": "plotting",
    "plot_sweep": "plotting",
    "replay": "simulation",
    "retime": "retiming",
    "replay_trials": "robust",
    "robustness": "robust",
    "sensitivities": "sensitivity",
    "sweep": "sweeping",
    "uniform_scaling": "timing",
    "validate": "validation",
    "what_if": "whatif",
    "what_if_problem": "whatif",
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
