"""Clearance inside the program: exact derivatives, the right rows, samples that miss nothing."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scenes import chain_of_spheres, surroundings
from test_obstacles import gantry
from test_transcription import DIFFERENCES, METHODS, differences, evaluate, some_point, wriggle

import energyopt as eo
from energyopt.avoidance import RESERVE, Avoidance, avoidance_of
from energyopt.collision import Hinge, Scene, pair_kernels
from energyopt.dynamics.kernels import kernels_of
from energyopt.transcription import Cuts, transcribe
from energyopt.transcription.clearance import EXCESS, ClearanceTerms, close_pairs
from energyopt.transcription.easing import MOST, NEAR, eased
from energyopt.transcription.penalty import overlap, penalty_samples, price, travel_times

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


def test_the_price_of_a_penalty_is_force_times_the_way_left():
    """Against Σ f (required + band − m − required) pair by pair, f = k m² / 2 band; nothing overlaps more than the band."""
    post, hinge, motion = (eo.Sphere(0.1, (0.4, 0.2, 1.2)),), Hinge(50.0, 0.4), eo.baseline(problem())
    arm = replace(chain_of_spheres(), self_pair=np.zeros((0, 2), np.int64))
    kept = Avoidance(arm, pair_kernels(arm, post), Scene.of(arm, post, [0.0], RESERVE, RESERVE), RESERVE)
    times, weights = penalty_samples(kept, motion)
    placed = kept.kernels.place(kept.scene.at(times), motion(times))
    pairs = np.array([(a, 0) for k in np.flatnonzero(arm.moving_links) for a in range(*arm.link_start[k : k + 2])])
    sample, every = np.repeat(np.arange(len(times)), len(pairs)), np.tile(pairs, (len(times), 1))
    missing = np.maximum(RESERVE + hinge.band - placed.pairs(sample, every)[0], 0.0)
    assert 0.0 < missing.max() < hinge.band
    expected = weights[sample] @ (0.5 * hinge.stiffness * missing**2 * (hinge.band - missing) / hinge.band)
    assert price(kept, motion, hinge) == pytest.approx(expected, rel=1e-5)


def past_a_post(post_at):
    """A gantry carries a cube past a post at a distance."""
    cube = eo.Attached(eo.Box((0.2, 0.2, 0.2)), name="cube")
    asked = eo.Problem(
        gantry(), [-1.0, 0.0], [1.0, 0.0], 2.0, obstacles=[eo.Cylinder(0.1, 1.0, (0, post_at, 0), "post")], attached=(cube,)
    )
    return asked, avoidance_of(asked), eo.baseline(asked)


def test_spheres_that_stick_out_are_asked_less_and_no_more_than_exact_distances_allow():
    """The face of the cube passes 5 mm from the post; its spheres, which stick out, seem to touch it."""
    asked, kept, motion = past_a_post(0.205)
    before = overlap(kept, motion, NEAR)
    given = eased(kept, asked, motion)
    assert before > 0.0 and 0.0 < np.max(given.given) <= MOST
    assert np.all(given.scene.required <= kept.scene.required) and overlap(given, motion) < before


def test_what_was_given_too_much_is_taken_back():
    """The cube passes where it just may; spheres that stick out by some 11 mm were given 14."""
    asked, kept, motion = past_a_post(0.2 + RESERVE)
    given = kept.less(np.full(1, 0.014), 0.02)
    back = eased(given, asked, motion, back=True)
    assert np.max(back.given) < 0.014 - 1e-3 and np.all(back.scene.required <= kept.scene.required)


def test_a_ball_is_its_own_sphere_and_is_given_nothing():
    ball = eo.Attached(eo.Sphere(0.1), name="ball")
    asked = eo.Problem(gantry(), [-1.0, 0.0], [1.0, 0.0], 2.0, obstacles=[eo.Sphere(0.1, (0, 0.2 + 2e-3, 0))], attached=(ball,))
    kept = avoidance_of(asked)
    assert np.max(eased(kept, asked, eo.baseline(asked)).given) < 1e-6
