"""Looking for the energy-optimal time law on a path: solve, look densely for limits that are broken, add rows there, solve again.

Few limits bind, and a row costs as much where it does not: a solve begins with the rows that the guess comes near to, and every
round adds those that its solution comes near to, and the very places where a limit is exceeded most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SplineTrajectory, Trajectory
from energyopt.robots.model import Limits
from energyopt.solvers import Outcome, SolverOptions, solve
from energyopt.timing.law_program import LawProgram, SampleRows, end_rows
from energyopt.timing.law_space import Ends, LawSpace
from energyopt.timing.profile import PathProfile, bounds_of

ROUNDS = 15
MISSES = 2
"""Solves that may run out of iterations; where more do, the limits leave no law."""
COARSE, FINE = 3, 20
"""Samples a span: places at which rows may stand, and at which limits are looked at."""
NEAR = 0.93
"""Share of a limit from which a place gets a row."""
BEFORE = 1e-8
"""Share of the duration before a break at which its left side is looked at: there the jerk jumps."""
PEAK = 0.98
"""Share of a limit from which a peak between samples is looked for."""
EXCEEDED = 1e-7
"""Share of a limit that may be exceeded at the fine samples."""
MARGIN = 1e-5
"""Share of the limits kept back for what happens between the samples; doubled in late rounds."""
LATE = 5
ITERATIONS = 100
"""Of one solve: one that needs more, such as a first one without rows, goes on in the next round."""
BARRIER, WARM_BARRIER = 1e-1, 1e-6
_GO_ON = (Outcome.CONVERGED, Outcome.ACCEPTABLE, Outcome.ITERATION_LIMIT)


@dataclass(frozen=True, eq=False)
class LawRequest:
    """What is asked of a law.

    Attributes:
        profile: the arm on its path. limits: of velocity, acceleration, jerk and torque.
        weights: w and λ, (nv,) each. ends: of the law. durations: shortest and longest T [s], the same where it is given.
        spans: of the spline. margin: share of the limits kept back.
    """

    profile: PathProfile
    limits: Limits
    weights: tuple[np.ndarray, np.ndarray]
    ends: Ends
    durations: tuple[float, float]
    spans: int
    margin: float = MARGIN


@dataclass(frozen=True, eq=False)
class LawResult:
    """What was found.

    Attributes:
        law: s(t) as a motion of one joint. outcome: of the last solve.
        iterations: of all solves. rounds: how many. rows: samples with a limit at the end.
    """

    law: SplineTrajectory
    outcome: Outcome
    iterations: int
    rounds: int
    rows: int


def optimal_law(request: LawRequest, guess: Trajectory, stop: Callable[[], bool] | None = None) -> LawResult:
    """The law of least J from a guess s(t); ``stop`` ends the search, with the last law kept."""
    path, margin = request.profile.path, request.margin
    space = LawSpace(request.spans, path.duration, _quick(request))
    wanted = end_rows(request.ends, path.duration)
    c, T = space.guess(guess), float(np.clip(guess.duration, *request.durations))
    found = _near(request, space, space.law(c, T))
    iterations, misses, barrier = 0, 0, BARRIER
    weights = _scaled_weights(request, space, c, T)
    for number in range(1, ROUNDS + 1):
        rows = SampleRows.joined([wanted, _limit_rows(request.limits, *found, margin)])
        program = LawProgram(request.profile, space, request.ends, weights, request.durations, rows)
        solved = solve(program, program.unknowns(c, T), SolverOptions(1e-6, ITERATIONS, barrier), stop=stop)
        iterations, barrier = iterations + solved.iterations, WARM_BARRIER
        c, T = program.coefficients(solved.x), program.duration(solved.x)
        law = space.law(c, T)
        result = LawResult(law, solved.outcome, iterations, number, len(found[0]))
        exceeded, unfinished = _exceeded(request, law), solved.outcome is Outcome.ITERATION_LIMIT
        misses += unfinished
        if solved.outcome not in _GO_ON or misses > MISSES or not (len(exceeded[0]) or unfinished):
            break
        found = _merged(found, _near(request, space, law), exceeded)
        margin *= 2.0 if number >= LATE else 1.0
    return result


def _quick(request: LawRequest) -> tuple[bool, bool]:
    """At which ends the acceleration rises from zero and no jerk limit says how fast."""
    free = request.ends.smooth and not np.any(np.isfinite(request.limits.jerk))
    return tuple(free and speed is not None for speed in request.ends.speeds)


def _scaled_weights(request: LawRequest, space: LawSpace, c: np.ndarray, T: float) -> tuple[np.ndarray, ...]:
    """The weights divided by J of the guess: tolerances and barriers are made for objectives near one."""
    program = LawProgram(request.profile, space, request.ends, request.weights, (T, T), end_rows(Ends(), 1.0))
    program.move(program.unknowns(c, T))
    size = program.objective()
    return tuple(w / size for w in request.weights) if size > 0 else request.weights


def smooth_law(path: Trajectory, duration: float) -> PolynomialTrajectory:
    """The quintic s/L = 10σ³ − 15σ⁴ + 6σ⁵."""
    powers = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0]) / duration ** np.arange(6)
    return PolynomialTrajectory([0.0, duration], path.duration * powers[None, :, None])


def even_law(path: Trajectory, duration: float) -> PolynomialTrajectory:
    """s/L = σ: the path at its own pace."""
    return PolynomialTrajectory([0.0, duration], np.array([[[0.0], [path.duration / duration]]]))


def with_pause(law: Trajectory, place: float, pause: float) -> PolynomialTrajectory:
    """A law in straight pieces between its breaks, with a pause [s] at the break nearest after a place."""
    t, s = law.breaks, law(law.breaks)[:, 0]
    k = int(np.clip(np.searchsorted(s, place), 1, len(s) - 2))
    t, s = np.concatenate([t[: k + 1], t[k:] + pause]), np.concatenate([s[: k + 1], s[k:]])
    return PolynomialTrajectory(t, np.stack([s[:-1], np.diff(s) / np.diff(t)], axis=1)[:, :, None])


def _usage(request: LawRequest, law: Trajectory, t: np.ndarray) -> dict[str, np.ndarray]:
    """Share of every limit in use at the times ``t`` (K,), by kind (K, nv)."""
    z = np.stack([law(t, order)[:, 0] for order in range(4)], axis=1)
    bounds = bounds_of(request.limits)
    found = request.profile.at(z, tuple(bounds))
    return {kind: np.abs(found[kind].value) / bound for kind, bound in bounds.items()}


def _near(request: LawRequest, space: LawSpace, law: Trajectory) -> tuple[np.ndarray, ...]:
    """Coarse samples at which a law comes near to a limit: σ, kind and joint, each (R,)."""
    b = space.breaks
    inside = (b[:-1, None] + np.diff(b)[:, None] * np.arange(COARSE) / COARSE).ravel()
    sigma = np.concatenate([inside, b[1:] - BEFORE])
    parts = []
    for kind, usage in _usage(request, law, sigma * law.duration).items():
        node, joint = np.nonzero(usage > NEAR)
        parts.append((sigma[node], np.full(len(node), kind, dtype="<U12"), joint))
    return _merged(*parts)


def _exceeded(request: LawRequest, law: Trajectory) -> tuple[np.ndarray, ...]:
    """Places where a limit is exceeded most, as `_near`: peaks among fine samples, and vertices of parabolas through them."""
    motion = PathTrajectory(request.profile.path, law)
    before = motion.breaks[1:] - BEFORE * law.duration
    t = np.sort(np.concatenate([motion.sample_times(FINE), before]))
    parts = []
    for kind, usage in _usage(request, law, t).items():
        padded = np.pad(usage, ((1, 1), (0, 0)), constant_values=-np.inf)
        node, joint = np.nonzero((usage >= padded[:-2]) & (usage >= padded[2:]) & (usage > PEAK))
        at = np.concatenate([t[node], _vertices(t, usage, node, joint)])
        joint = np.tile(joint, 2)
        high = _usage(request, law, at)[kind][np.arange(len(at)), joint] > 1.0 + EXCEEDED
        parts.append((at[high] / law.duration, np.full(high.sum(), kind, dtype="<U12"), joint[high]))
    return _merged(*parts)


def _vertices(t: np.ndarray, usage: np.ndarray, node: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Times of the vertices of the parabolas through the samples ``node`` and their neighbours."""
    node = np.clip(node, 1, len(t) - 2)
    before, at, after = (usage[node + d, joint] for d in (-1, 0, 1))
    left, right = t[node] - t[node - 1], t[node + 1] - t[node]
    rise, fall = (at - before) / left, (after - at) / right
    with np.errstate(all="ignore"):
        share = np.nan_to_num(rise / (rise - fall), nan=0.5)
    middle = 0.5 * (t[node - 1] + t[node])
    return np.clip(middle + share * 0.5 * (left + right), t[node - 1], t[node + 1])


def _merged(*parts: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Places of several searches, each once."""
    if not parts:
        return np.zeros(0), np.zeros(0, "<U12"), np.zeros(0, int)
    sigma, kind, joint = (np.concatenate([part[k] for part in parts]) for k in range(3))
    kept = {(round(x, 9), str(k), int(i)): n for n, (x, k, i) in enumerate(zip(sigma, kind, joint, strict=True))}
    index = np.array(sorted(kept.values()), dtype=int)
    return sigma[index], kind[index], joint[index]


def _limit_rows(limits: Limits, sigma: np.ndarray, kind: np.ndarray, joint: np.ndarray, margin: float) -> SampleRows:
    bounds = bounds_of(limits)
    scale = np.array([1.0 / bounds[str(k)][i] for k, i in zip(kind, joint, strict=True)]).reshape(-1)
    most = np.full(len(sigma), 1.0 - margin)
    return SampleRows(sigma, kind, joint, scale, -most, most)
