"""What the command line prints of an outcome and of a batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from energyopt.batch_files import Row
from energyopt.verification import excessive
from energyopt.workflow import Outcome

REFERENCE = "quintic"
"""The baseline that savings are stated against: the minimum-jerk motion of the same duration."""


def outcome_table(outcome: Outcome) -> str:
    """Status, objective, joules, saving, worst margin of each limit, replay error, times, files."""
    plan = outcome.plan
    robot = plan.problem.robot
    rows = [
        ("status", f"{plan.status.value}: {plan.message}"),
        ("motion", f"{robot.name}, {robot.nv} joints, {plan.duration:g} s"),
        ("objective J", f"{plan.objective:.6g}{_shares(outcome)}{_estimate(outcome)}"),
        ("mechanical energy", _energy(outcome)),
        *_electrical(outcome),
        (f"against {REFERENCE}", _saving(outcome)),
        *_margins(outcome),
        *_clearance(outcome),
        ("replay in MuJoCo", _replay(outcome)),
        ("checks", _checks(outcome)),
        ("time", _times(outcome)),
    ]
    if outcome.files:
        names = ", ".join(path.name for path in outcome.files)
        rows.append(("files", f"{_shown(outcome.files[0].parent)}: {names}"))
    width = max(len(label) for label, _ in rows)
    lines = [f"  {label:<{width}}  {text}" for label, text in rows]
    lines += [f"  {'note':<{width}}  {note}" for note in plan.notes]
    return "\n".join([plan.problem.name or "problem", *lines])


def batch_line(row: Row) -> str:
    """One problem of a batch in one line; where it is not valid, the reason."""
    verdict = "valid" if row.valid else row.status
    if not row.valid or row.objective is None:
        return f"  {verdict:<16}  {row.name:<24}  {row.message}"
    saving = "" if row.saving_percent is None else f"{-row.saving_percent:+.1f} % against the {REFERENCE}"
    sizes = f"{row.duration_s:6.3g} s   J {row.objective:<10.6g}"
    return f"  {verdict:<16}  {row.name:<24}  {row.robot:<12}  {sizes}  {saving:<28}  {row.plan_s:.2f} s to plan"


def batch_total(rows: list[Row], out: Path | None) -> str:
    """How many are solved and valid, and where the results are."""
    valid = sum(row.valid for row in rows)
    where = "" if out is None else f"; results in {_shown(out)}, tables in results.csv and results.json there"
    return f"{valid} of {len(rows)} problems are solved and valid{where}"


def _shares(outcome: Outcome) -> str:
    """What of J is not torque, in %; nothing where J has one term."""
    terms, whole = outcome.plan.cost_terms, outcome.plan.objective
    if len(terms) < 2:
        return ""
    words = {"velocity_squared": "velocity", "potential": "nearness to obstacles"}
    percent = lambda term: 100 * terms[term] / whole if whole > 0 else 0.0
    said = [f"{percent(t):.1f} % for {words.get(t, t.replace('_', ' '))}" for t in terms if t != "torque_squared"]
    return f", of which {' and '.join(said)}"


def _estimate(outcome: Outcome) -> str:
    error = outcome.plan.discretization_error
    iterations = f"{outcome.plan.iterations} iterations"
    return (
        f"; {iterations}"
        if error is None
        else f"; within {100 * error:.2g} % of the optimum near this motion (estimate); {iterations}"
    )


def _energy(outcome: Outcome) -> str:
    planned = f"{outcome.report.plan_metrics.mechanical_abs_J:.4g} J planned (sum of ∫|τ q̇|dt)"
    replayed = outcome.report.replay_metrics
    if replayed is None:
        return planned
    return f"{planned}, {replayed.mechanical_abs_J:.4g} J replayed ({outcome.report.energy_gap_percent:+.3f} %)"


def _electrical(outcome: Outcome) -> list[tuple[str, str]]:
    """Input of the drives, where they are known."""
    account, other = outcome.report.account, outcome.report.baselines[REFERENCE]
    if account.electrical_J is None or other.account is None:
        return []
    causes = ", ".join(f"{cause} {value:.3g}" for cause, value in account.totals().items() if abs(value) >= 5e-4)
    saving = f"{_percent(other.electrical_saving_percent)} than the {REFERENCE}'s {other.account.electrical_J:.4g} J"
    return [("electrical energy", f"{account.electrical_J:.4g} J ({causes}), {saving}")]


def _saving(outcome: Outcome) -> str:
    other = outcome.report.baselines[REFERENCE]
    objective, energy = (_percent(x) for x in (other.saving_percent, other.energy_saving_percent))
    breaks = "which touches something" if "clearance" in excessive(other.violations) else "which breaks a limit"
    holds = "which holds the limits" if other.within_limits else breaks
    theirs = f"J {other.objective:.4g}, {other.metrics.mechanical_abs_J:.4g} J of mechanical energy"
    same = f"same {outcome.plan.duration:g} s; {theirs}, {holds}"
    return f"J {objective} (motor heat goes with torque squared), mechanical energy {energy}; {same}"


def _percent(saving: float | None) -> str:
    if saving is None:
        return "–"
    return f"{saving:.1f} % less" if saving >= 0 else f"{-saving:.1f} % more"


def _margins(outcome: Outcome) -> list[tuple[str, str]]:
    """One row a limit: the least margin in % of the limit, with joint and time."""
    violations, rows = outcome.report.violations, []
    for name, margin in violations.margin.items():
        if not np.isfinite(margin):
            continue
        joint, time = violations.worst.get(name, ("", np.nan))
        where = f" ({joint}, {time:.2f} s)" if joint and np.isfinite(time) else ""
        rows.append((f"margin {name.removesuffix('_percent').replace('_', ' ')}", f"{margin:.2f} %{where}"))
    return rows


def _clearance(outcome: Outcome) -> list[tuple[str, str]]:
    """The closest pair over the whole motion, where anything was to be kept apart."""
    violations = outcome.report.violations
    if violations.distance is None or not np.isfinite(violations.distance):
        return []
    pair, time = violations.worst.get("clearance", ("", 0.0))
    return [("closest", f"{1000 * violations.distance:.1f} mm ({pair}, {time:.2f} s)")]


def _replay(outcome: Outcome) -> str:
    tracking = outcome.report.tracking
    if tracking is None:
        return outcome.summary.get("replay_failure", "not done")
    joints = f"{tracking.joint_rms:.2g} rad RMS, {tracking.joint_max:.2g} rad largest"
    touches = outcome.report.touches
    contacts = "contacts not looked for" if touches is None else f"{len(touches)} contacts" if touches else "no contact"
    return f"tracking error {joints}; tool {1000 * tracking.tool_max:.2g} mm largest; {contacts}"


def _checks(outcome: Outcome) -> str:
    checks = outcome.report.checks
    failed = [check for check in checks if not check.passed]
    if not failed:
        return f"all {len(checks)} passed"
    shown = "; ".join(f"{c.name} {c.value:.3g} {c.unit}, at most {c.threshold:g}" for c in failed)
    return f"{len(failed)} of {len(checks)} FAILED: {shown}"


def _times(outcome: Outcome) -> str:
    parts = {**outcome.plan.time_s}
    if outcome.log is not None:
        parts["replay"] = outcome.log.wall_s
    return ", ".join(f"{name} {seconds:.3g} s" for name, seconds in parts.items())


def _shown(folder: Path) -> str:
    text = str(folder)
    return text if text.endswith("/") else f"{text}/"
