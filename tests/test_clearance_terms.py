"""Clearance inside the program: exact derivatives, the right rows, samples that miss nothing."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scenes import chain_of_spheres, surroundings
from test_transcription import DIFFERENCES, METHODS, differences, evaluate, some_point, wriggle

import energyopt as eo
from energyopt.avoidance import RESERVE, Avoidance
from energyopt.collision import Hinge, Scene, pair_kernels
from energyopt.dynamics.kernels import kernels_of
from energyopt.transcription import Cuts, transcribe
from energyopt.transcription.clearance import EXCESS, ClearanceTerms, close_pairs
from energyopt.transcription.penalty import overlap, penalty_samples, travel_times

KINKS = 20.0
"""Second derivatives of distances jump where the nearest feature changes: steps across such places are that much worse."""


def avoidance(obstacles=None):
    arm = chain_of_spheres()
    obstacles = surroundings() if obstacles is None else obstacles
    scene = Scene.of(arm, obstacles, [0.0], RESERVE, RESERVE, potential=eo.RepulsivePotential(0.01, 0.2))
    return Avoidance(arm, pair_kernels(arm, obstacles), scene, RESERVE)


def problem():
    return eo.Problem(arms.rubbing_chain(), [0.1, -0.2, 0.3], [0.8, 0.3, -0.5], 0.8, self_collision=False)


HINGE = Hinge(50.0, 0.02)


def program_of(method, kept, rows, hinge=HINGE):
    asked, space = problem(), method.space(0.8)
    goal = asked.goal if isinstance(method, eo.Sinusoid) else np.array([0.2, 0.4, 0.1])
    samples = penalty_samples(kept, eo.baseline(asked, goal=goal)) if hinge.stiffness else (np.zeros(0), np.zeros(0))
    terms = lambda space, unknowns, cuts: ClearanceTerms(kept, space, unknowns, rows, hinge, samples)
    return transcribe(asked, space, kernels_of(asked.robot.dynamics), Cuts(), terms if rows or hinge.stiffness else None)


ROWS = {(0.11, 3, 2): 0.01, (0.11, 9, -2): 0.02, (0.43, 12, 5): 0.0, (0.62, 7, 6): 0.03, (0.62, 7, 0): 0.03}


@pytest.mark.parametrize("name", METHODS)
def test_gradient_jacobian_and_hessian_match_differences(name):
    program = program_of(METHODS[name], avoidance((eo.Sphere(0.1, (0.4, 0.2, 0.1)), eo.HalfSpace((0.2, 0.1, 1.0), -0.4))), {
        (0.11, 3, 1): 0.01, (0.11, 9, -2): 0.02, (0.43, 12, 0): 0.0, (0.62, 7, 1): 0.03, (0.62, 7, 0): 0.03
    })  # fmt: skip
    x = some_point(program)
    found = evaluate(program, x)
    differenced = differences(lambda x: np.concatenate([[(e := evaluate(program, x))["objective"]], e["rows"], e["slope"]]), x)
    rows = program.rows
    assert arms.relative(found["gradient"], differenced[0]) < DIFFERENCES
    assert arms.relative(found["jacobian"], differenced[1 : rows + 1]) < DIFFERENCES
    assert arms.relative(found["hessian"], differenced[rows + 1 :]) < KINKS * DIFFERENCES


def test_rows_are_the_distances_of_the_motion():
    kept = avoidance()
    program = program_of(METHODS["cubic spline"], kept, ROWS, Hinge())
    x = program.guess(wriggle(program))
    values = evaluate(program, x)["rows"][-len(ROWS) :]
    motion = program.trajectory(x)
    for value, (t, a, b) in zip(values, sorted(ROWS), strict=True):
        placed = kept.kernels.place(kept.scene.at([t]), motion(np.array([t])))
        assert value == pytest.approx(placed.pairs(np.array([0]), np.array([[a, b]]))[0][0], abs=1e-12)
    assert np.array_equal(program.row_lower[-len(ROWS) :], [ROWS[key] for key in sorted(ROWS)])


def test_the_penalty_is_the_integral_over_the_motion():
    """Against the same energy summed over 20,000 instants."""
    kept, hinge = avoidance(), HINGE
    kept = replace(kept, scene=replace(kept.scene, potential=None))
    with_penalty, without = (program_of(METHODS["cubic spline"], kept, {}, h) for h in (hinge, Hinge()))
    x = with_penalty.guess(eo.baseline(problem()))
    motion, (times, weights) = with_penalty.trajectory(x), penalty_samples(kept, eo.baseline(problem()))
    assert weights.sum() == pytest.approx(0.8, rel=1e-12) and np.all(np.diff(times) > 0)
    fine = (np.arange(20_000) + 0.5) * 0.8 / 20_000
    scene = replace(kept.scene, hinge=hinge).at(fine)
    energy = kept.kernels.place(scene, motion(fine)).penalty(derivatives=False)[0].sum(axis=1).mean() * 0.8
    priced = evaluate(with_penalty, x)["objective"] - evaluate(without, x)["objective"]
    assert priced == pytest.approx(energy, rel=5e-3)


def test_between_two_samples_no_sphere_moves_far():
    kept, motion = avoidance(), eo.baseline(problem())
    times = travel_times(kept, motion, 0.02, (5, 500))
    centers = kept.kernels.place(kept.scene.at(times), motion(times)).centers()
    assert times[0] == 0 and times[-1] == motion.duration
    assert np.linalg.norm(np.diff(centers, axis=0), axis=2).max() < 1.1 * 0.02


def test_rows_are_asked_for_where_a_motion_is_too_close_and_only_there():
    kept, motion = avoidance(), eo.baseline(problem())
    rows = close_pairs(kept, motion)
    assert rows and overlap(kept, motion) > EXCESS
    for (t, a, b), bound in rows.items():
        placed = kept.kernels.place(kept.scene.at([t]), motion(np.array([t])))
        assert placed.pairs(np.array([0]), np.array([[a, b]]))[0][0] < bound + 2.1e-3
    far = avoidance((eo.Sphere(0.1, (9.0, 9.0, 9.0)),))
    only_itself = close_pairs(far, motion)
    assert all(b < 0 for _, _, b in only_itself)
