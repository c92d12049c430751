"""Energy-optimal time laws on given paths: closed forms, the planner's own optimum, ordinary timings, limits, derivatives."""

from functools import cache

import arms
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import energyopt as eo
from energyopt.parameterizations import PathTrajectory, SplineTrajectory
from energyopt.timing.law_program import LawProgram, SampleRows, end_rows
from energyopt.timing.law_search import even_law, smooth_law
from energyopt.timing.law_space import Ends, LawSpace
from energyopt.timing.paths import as_path
from energyopt.timing.profile import PathProfile
from energyopt.verification import objective


@cache
def panda_points(seed=8):
    limits = arms.catalogue_robot("panda").limits
    return np.random.default_rng(seed).uniform(0.7 * limits.lower + 0.3 * limits.upper, limits.upper, (5, 7))


@cache
def panda_plan():
    """A plan whose limits bind for a part of the time."""
    robot = arms.catalogue_robot("panda")
    return eo.plan(eo.Problem(robot, robot.home, robot.home + 0.6, 1.2, velocity_limits=1.4, self_collision=False))


def off_the_path(plan, path):
    """Largest distance of the motion from the path at the places its law says, and of these places from a monotone order."""
    t = np.linspace(0, plan.duration, 3000)
    s = plan.trajectory.places(t)
    assert np.all(np.diff(s) >= -1e-12 * path.duration), "the law never runs backwards"
    assert np.all(plan.trajectory.law(t, 1) >= -1e-12)
    return np.abs(plan.trajectory(t) - path(np.clip(s, 0, path.duration))).max()


@pytest.mark.parametrize(("weight", "expected"), [(0.0, 12.0), (1.0, 13.1985871), (10.0, 23.8713172), (100.0, 124.9971627)])
def test_a_mass_on_a_line_is_timed_as_the_closed_form_says(weight, expected):
    """x⁗ = λ x″: J = λ d²/(T − 2 tanh(√λ T/2)/√λ), and 12 d²/T³ for λ = 0; a cubic spline of 40 spans is within 1e-5 of it."""
    robot = arms.sliders(1)
    plan = eo.retime([[0.0], [1.0]], robot, 1.0, velocity_weight=weight, smooth_ends=False, self_collision=False)
    assert plan.objective == pytest.approx(expected, rel=1e-5)
    smooth = eo.retime([[0.0], [1.0]], robot, 1.0, velocity_weight=weight, self_collision=False)
    assert expected * (1 - 1e-9) < smooth.objective < expected * 1.01
    assert np.allclose(smooth.trajectory(np.array([0.0, 1.0]), 2), 0.0, atol=1e-9)


def test_energy_falls_with_the_third_power_of_the_duration_without_gravity():
    robot = arms.sliders(1)
    cost = [eo.retime([[0.0], [0.5]], robot, T, velocity_weight=0.0, smooth_ends=False, self_collision=False).objective
            for T in (1.0, 2.0)]  # fmt: skip
    assert cost[0] / cost[1] == pytest.approx(8.0, rel=1e-5)


def test_the_optimal_timing_of_an_optimal_plan_is_the_one_it_has():
    """On the path of a plan the best law is the plan's own: its J, from another program, to the splines' accuracy (0.2 %)."""
    plan = panda_plan()
    limits = plan.problem.limits
    again = eo.retime(
        plan.trajectory, plan.problem.robot, plan.duration, velocity_weight=plan.problem.velocity_weight,
        velocity_limits=limits.velocity, self_collision=False,
    )  # fmt: skip
    assert again.solved and again.objective == pytest.approx(plan.objective, rel=2e-3)


@pytest.mark.parametrize("ratio", [1.05, 1.5, 3.0])
def test_a_retimed_motion_keeps_the_path_and_the_limits_and_costs_least(ratio):
    """Against the quintic law and the fastest law made slower, both of the same duration on the same path."""
    robot, points = arms.catalogue_robot("panda"), panda_points()
    path = as_path(points, robot)
    T = ratio * eo.minimum_duration(points, robot)
    plan = eo.retime(points, robot, T, self_collision=False)
    assert plan.solved and plan.duration == T and plan.options["method"] == "retime"
    assert off_the_path(plan, path) < 1e-9
    assert np.allclose(plan.trajectory(0.0), points[0]) and np.allclose(plan.trajectory(T), points[-1])
    apart = [np.linalg.norm(plan.trajectory(np.linspace(0, T, 20_000)) - q, axis=1).min() for q in points]
    assert max(apart) < 1e-3, "every configuration is passed"
    quintic = PathTrajectory(path, smooth_law(path, T))
    assert plan.objective < objective(plan.problem, quintic)


@pytest.mark.parametrize("ratio", [1.2, 2.0])
def test_the_pace_of_a_recorded_motion_does_not_count(ratio):
    """The same path, recorded at an even pace and as a quintic that stands still at its ends."""
    robot = arms.catalogue_robot("panda")
    points = robot.home + np.array([[0.0] * 7, [0.5, 0.4, -0.5, 0.6, 0.3, 0.2, 1.0]])
    line = as_path(points, robot)
    T = ratio * eo.minimum_duration(points, robot)
    options = {"self_collision": False}
    recorded = PathTrajectory(line, smooth_law(line, 3.0))
    first, second = eo.retime(points, robot, T, **options), eo.retime(recorded, robot, T, **options)
    assert first.solved and second.solved
    assert second.objective == pytest.approx(first.objective, rel=0.01)
    assert eo.minimum_duration(recorded, robot) == pytest.approx(eo.minimum_duration(points, robot), rel=0.01)


def test_a_free_duration_is_the_cheapest_of_all():
    """Between neighbours that were solved with their duration given."""
    robot, points = arms.catalogue_robot("panda"), arms.catalogue_robot("panda").home + np.array([[0.0] * 7, [0.6] * 7])
    free = eo.retime(points, robot, (0.3, 6.0), self_collision=False)
    assert free.solved and 0.3 < free.duration < 6.0
    for share in (0.97, 1.03):
        near = eo.retime(points, robot, share * free.duration, self_collision=False, throw=False)
        assert not near.solved or near.objective > free.objective * (1 - 1e-4)


def test_limits_of_acceleration_and_jerk_are_sought_and_hold():
    robot, points = arms.catalogue_robot("panda"), arms.catalogue_robot("panda").home + np.array([[0.0] * 7, [0.6] * 7])
    free = eo.retime(points, robot, 1.2, self_collision=False)
    tight = eo.retime(points, robot, 1.2, acceleration_limits=3.0, jerk_limits=30.0, self_collision=False)
    assert np.abs(free.trajectory(np.linspace(0, 1.2, 500), 2)).max() > 3.1
    assert tight.solved and tight.objective > free.objective
    assert tight.violations.margin["acceleration"] >= -1e-3 and tight.violations.margin["jerk"] >= -1e-3


def test_friction_counts_in_the_law_and_in_the_check():
    robot = eo.load_robot("panda", viscous_friction=4.0, coulomb_friction=2.0)
    points = robot.home + np.array([[0.0] * 7, [0.6] * 7])
    plan = eo.retime(points, robot, 1.5, self_collision=False)
    quintic = PathTrajectory(as_path(points, robot), smooth_law(as_path(points, robot), 1.5))
    assert plan.solved and plan.objective < objective(plan.problem, quintic)


def test_given_speeds_at_the_ends_are_kept():
    robot = arms.catalogue_robot("panda")
    points = robot.home + np.array([[0.0] * 7, [0.6] * 7])
    plan = eo.retime(points, robot, (0.8, 2.0), start_speed=0.5, goal_speed=0.2, self_collision=False)
    speed = np.linalg.norm(plan.trajectory(np.array([0.0, plan.duration]), 1), axis=1)
    assert plan.solved and np.allclose(speed, [0.5, 0.2], atol=1e-7)


def test_a_retimed_plan_is_saved_replayed_and_validated_as_any_other(tmp_path):
    robot = arms.catalogue_robot("panda")
    plan = eo.retime(robot.home + np.array([[0.0] * 7, [0.6] * 7]), robot, 1.5)
    plan.save(tmp_path / "plan.npz")
    again, t = eo.load_plan(tmp_path / "plan.npz"), np.linspace(0, 1.5, 60)
    assert all(np.array_equal(again.trajectory(t, order), plan.trajectory(t, order)) for order in range(4))
    assert eo.validate(again, eo.replay(again)).passed


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("trajectory.law.coefficients", lambda x: x[::-1]),
        ("trajectory.law.coefficients", lambda x: 2.0 * x),
        ("trajectory.law.coefficients", lambda x: x * np.nan),
        ("trajectory.law.degree", lambda x: np.array(90)),
        ("trajectory.path.kind", lambda x: np.frombuffer(b"nonsense", np.uint8)),
        ("trajectory.path.knots", lambda x: x[:3]),
        ("trajectory.path.coefficients", lambda x: x[:, :1]),
    ],
)
def test_a_damaged_law_or_path_in_a_file_is_one_clear_line(tmp_path, name, change):
    robot = arms.two_link()
    eo.retime(PATH, robot, 2.0, self_collision=False).save(tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz") as file:
        arrays = dict(file)
    arrays[name] = change(arrays[name])
    np.savez(tmp_path / "changed.npz", **arrays)
    with pytest.raises(eo.InputError, match=r"changed\.npz") as caught:
        eo.load_plan(tmp_path / "changed.npz")
    assert "\n" not in str(caught.value)


def test_a_path_in_the_way_of_something_is_not_solved():
    robot = arms.catalogue_robot("panda")
    points = robot.home + np.array([[0.0] * 7, [0.6] * 7])
    hand = robot.placement("panda_hand", robot.home + 0.3).translation
    plan = eo.retime(points, robot, 1.5, obstacles=[eo.Sphere(0.1, hand)], throw=False)
    assert plan.status is eo.Status.LIMITS_VIOLATED and "overlap" in plan.message
    with pytest.raises(eo.NoSolutionFound):
        eo.retime(points, robot, 1.5, obstacles=[eo.Sphere(0.1, hand)])


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("speeds", [(0.0, 0.0), (0.3, None)])
def test_derivatives_of_the_program_are_exact(free, speeds):
    """Central differences, on a path whose fourth derivative is continuous; relative error 1e-5."""
    robot = arms.rubbing_chain()
    points = arms.random_states(robot, 6, seed=2)[0]
    spline = make_interp_spline(np.linspace(0, 4, 6), points, k=5)
    path, rng, ends = SplineTrajectory(spline.t, spline.c, 5), np.random.default_rng(4), Ends(speeds, True)
    kinds = np.array(["velocity", "acceleration", "jerk", "torque"], dtype="<U12")[rng.integers(0, 4, 30)]
    ones = np.ones(30)
    limits = SampleRows(rng.uniform(0, 1, 30), kinds, rng.integers(0, 3, 30), 0.1 * ones, -ones, ones)
    rows = SampleRows.joined([end_rows(ends, path.duration), limits])
    weights = (np.array([1.0, 2.0, 0.5]), np.full(3, 0.3))
    program = LawProgram(
        PathProfile(path, robot), LawSpace(10, path.duration), ends, weights, (1.0, 4.0) if free else (2.0, 2.0), rows
    )
    x, mu = np.sort(rng.uniform(0, 1, program.size)), rng.normal(size=program.rows)
    if free:
        x[-1] = 0.4

    def evaluated(at):
        program.move(at)
        slope, g, entries = np.zeros(program.size), np.zeros(program.rows), np.zeros(len(program.jacobian_pattern[1]))
        program.gradient(slope)
        program.constraints(at, g)
        program.jacobian(entries)
        return program.objective(), slope, g, dense(program.jacobian_pattern, entries, program.rows)

    _, slope, _, jacobian = evaluated(x)
    entries = np.zeros(len(program.hessian_pattern[1]))
    program.hessian(0.7, mu, entries)
    upper = dense(program.hessian_pattern, entries, program.size)
    hessian = upper + np.triu(upper, 1).T
    for i, h in enumerate(1e-6 * np.eye(program.size)):
        more, less = evaluated(x + h), evaluated(x - h)
        change = [(a - b) / 2e-6 for a, b in zip(more, less, strict=True)]
        assert change[0] == pytest.approx(slope[i], abs=1e-5 * np.abs(slope).max())
        assert np.allclose(change[2], jacobian[:, i], atol=1e-5 * np.abs(jacobian).max())
        assert np.allclose(0.7 * change[1] + mu @ change[3], hessian[i], atol=1e-5 * np.abs(hessian).max())


def dense(pattern, entries, rows):
    start, row = pattern
    matrix = np.zeros((rows, len(start) - 1))
    for column in range(len(start) - 1):
        matrix[row[start[column] : start[column + 1]], column] = entries[start[column] : start[column + 1]]
    return matrix


def test_quantities_on_a_path_are_those_of_the_arm():
    """The table of the dynamics against numeric Pinocchio at random states: 1e-8 of the largest torque."""
    robot = arms.rubbing_chain()
    points = arms.random_states(robot, 4, seed=2)[0]
    path, rng = as_path(points, robot), np.random.default_rng(0)
    z = np.c_[rng.uniform(0, path.duration, 300), rng.normal(size=(300, 3))]
    v, a = z[:, 1:2], z[:, 2:3]
    found = PathProfile(path, robot).at(z, ("velocity", "acceleration", "torque"))
    q, first, second = (path(z[:, 0], order) for order in range(3))
    expected = {"velocity": first * v, "acceleration": second * v**2 + first * a}
    expected["torque"] = robot.torque(q, expected["velocity"], expected["acceleration"])
    for kind, value in expected.items():
        assert np.allclose(found[kind].value, value, atol=1e-8 * np.abs(value).max()), kind


def test_an_even_law_passes_the_path_at_its_own_pace():
    path = as_path(panda_points(), arms.catalogue_robot("panda"))
    assert np.allclose(PathTrajectory(path, even_law(path, path.duration))(1.0, 1), path(1.0, 1))


PATH = [[0.0, 0.0], [1.0, 0.5], [1.5, -0.5]]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda r: eo.retime(PATH, r, 0.01),
            r"duration: 0\.01 s is too short for this path: within the limits it takes at least",
        ),
        (lambda r: eo.retime(PATH, r, (0.001, 0.01)), "too short for this path"),
        (lambda r: eo.retime(PATH[:1], r, 1.0), r"path has the shape \(1, 2\): expected a trajectory, or at least two"),
        (lambda r: eo.retime([PATH[0], PATH[0]], r, 1.0), "all its configurations are the same"),
        (lambda r: eo.retime([[0.0], [1.0]], r, 1.0), "2 joint positions, one a row"),
        (lambda r: eo.retime([[0.0, np.nan], [1.0, 1.0]], r, 1.0), r"path\[0\] \(joint 'joint2'\) is nan"),
        (lambda r: eo.retime("path", r, 1.0), "path is 'path'"),
        (lambda r: eo.retime(PATH, r, -1.0), "duration is -1.0"),
        (lambda r: eo.retime(PATH, r, (2.0, 1.0)), "expected the least below the most"),
        (lambda r: eo.retime(PATH, None, 1.0), "robot is None"),
        (lambda r: eo.retime(PATH, r, 1.0, start_speed=-1.0), "start_speed is -1.0: .* never runs backwards"),
        (lambda r: eo.retime(PATH, r, 1.0, start_speed=1e6), "start speed 1e.* is more than the limits allow"),
        (lambda r: eo.retime(PATH, r, 1.0, smooth_ends="no"), "expected True or False"),
        (lambda r: eo.retime(PATH, r, 1.0, potential=1), "no option 'potential'"),
        (lambda r: eo.retime([[0.0, 0.0], [100.0, 0.0]], r, 9.0), r"joint 'joint1' is at .* beyond its position limit"),
        (lambda r: eo.retime(PATH, r, 1.0, torque_limits=0.1), "to be held and moved on the way"),
        (lambda r: eo.retime(eo.baseline(eo.Problem(arms.sliders(1), [0.0], [1.0], 1.0)), r, 1.0), "a motion of 1 joints"),
        (lambda r: eo.retime(eo.baseline(eo.Problem(r, PATH[0], PATH[0], 1.0)), r, 1.0), "stands still"),
    ],
)
def test_bad_input_is_one_clear_line(call, said):
    with pytest.raises(eo.InputError, match=said) as caught:
        call(arms.two_link())
    assert "\n" not in str(caught.value)
