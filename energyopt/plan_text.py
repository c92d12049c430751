"""A plan in a few lines, for people."""

from __future__ import annotations

from energyopt.optima import described
from energyopt.plans import Plan
from energyopt.verification import describe


def plan_table(plan: Plan) -> str:
    """Status, motion, J and its terms, the tightest limit, what the guesses led to, the time it took, and the notes."""
    rows = [
        ("status", f"{plan.status.value}: {plan.message}"),
        ("motion", f"{plan.problem.robot.in_brief()}, {plan.duration:.6g} s"),
        ("J", f"{plan.objective:.6g}{_terms(plan)}{_estimate(plan)}"),
        ("limits", describe(plan.violations)),
    ]
    if plan.violations.distance is not None:
        pair, time = plan.violations.worst.get("clearance", ("", 0.0))
        rows.append(("closest", f"{1e3 * plan.violations.distance:.1f} mm ({pair}, {time:.3f} s)"))
    if plan.optima:
        rows.append(("optima", described(plan.optima)))
    rows.append(("time", ", ".join(f"{stage} {seconds:.2g} s" for stage, seconds in plan.time_s.items())))
    rows += [("note", note) for note in plan.notes]
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"{label:<{width}}  {text}" for label, text in rows)


def _terms(plan: Plan) -> str:
    return f" = {' + '.join(f'{name} {value:.6g}' for name, value in plan.cost_terms.items())}"


def _estimate(plan: Plan) -> str:
    error = plan.discretization_error
    return "" if error is None else f"; within {100 * error:.2g} % of the optimum near this motion (estimate)"
