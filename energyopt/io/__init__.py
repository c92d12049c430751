"""Files: problems in TOML, plans in .npz, and exports as CSV and JSON. Units are converted here and nowhere else."""

from energyopt.io.find import catalogue_problems, find_problem, problems_folder
from energyopt.io.problems import load_problem, load_task

__all__ = ["catalogue_problems", "find_problem", "load_problem", "load_task", "problems_folder"]
