"""Plans for arms that are not quite as modelled: what it costs, what it uses of the limits, and how replays spread."""

from energyopt.robust.evaluation import CaseResult, Robustness, robustness
from energyopt.robust.planning import plan_robust
from energyopt.robust.trials import Trial, Trials, replay_trials
from energyopt.robust.uncertainty import Case, Uncertainty

__all__ = ["Case", "CaseResult", "Robustness", "Trial", "Trials", "Uncertainty", "plan_robust", "replay_trials", "robustness"]
