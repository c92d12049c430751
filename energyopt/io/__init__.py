"""Files: problems in TOML, plans in .npz, and exports as CSV and JSON. Units are converted here and nowhere else."""

from energyopt.io.archive import write_atomic
from energyopt.io.exports import write_csv, write_joint_trajectory
from energyopt.io.find import catalogue_problems, find_problem, problems_folder
from energyopt.io.plan_file import load_plan, save_plan
from energyopt.io.problems import load_problem, load_task

__all__ = [
    "catalogue_problems",
    "find_problem",
    "load_plan",
    "load_problem",
    "load_task",
    "problems_folder",
    "save_plan",
    "write_atomic",
    "write_csv",
    "write_joint_trajectory",
]
