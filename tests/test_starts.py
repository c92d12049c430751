"""Many searches of one plan: which optima are kept apart, which take part in the race, and which of them wins."""

import time
from dataclasses import dataclass, field, replace
from typing import ClassVar

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt import campaign, found, racing, rounds
from energyopt.actuators import ActuatorModel
from energyopt.costs import Duration, ElectricalEnergy, TorqueSquared
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations import PolynomialTrajectory
from energyopt.rounds import DEEP
from energyopt.search_state import SearchOptions
from energyopt.solvers import Outcome
from energyopt.transcription.penalty import overlap
from energyopt.verification import verify

FIXED = eo.BSpline(control_points=16, accuracy=None)


def folding(**options):
    """A move of a UR5 whose cheapest straight motion, were links allowed to overlap, passes through the arm itself."""
    robot = arms.catalogue_robot("ur5")
    start, goal = np.array([0.86, -1.5, 2.21, -0.67, -1.97, 0.65]), np.array([2.14, -0.3, 2.27, 0.0, -0.37, 0.6])
    return eo.Problem(robot, start, goal, 1.5, **options)


def begun(problem, starts):
    """A campaign that has made its first searches."""
    made = campaign.Campaign(problem, FIXED, kernels_of(problem.robot.dynamics), SearchOptions(), 0)
    made._search_all(made.attempts.all(made.attempts.targets()), starts)
    return made


@dataclass(eq=False)
class Fake:
    """What `found` and `racing` know of a search."""

    objective: float
    name: str = "fake"
    converged: bool = True
    depth: float = 0.0
    stiffness: int = 0
    outcome: Outcome = Outcome.CONVERGED
    at: float | None = None

    @property
    def trajectory(self):
        """Somewhere else for another J, unless it is said where."""
        offset = self.objective if self.at is None else self.at
        return PolynomialTrajectory(np.array([0.0, 1.0]), np.array([[[offset], [1.0]]]))


@dataclass
class FakeSearcher:
    """Keeping links apart costs what a table says; asked: of which J, in turn; looked: at which J links were seen not to be."""

    costs: dict
    asked: list = field(default_factory=list)
    looked: list = field(default_factory=list)

    def is_apart(self, search):
        self.looked.append(search.objective)
        return False

    def apart(self, search, attempt):
        self.asked.append(search.objective)
        return Fake(search.objective + self.costs.get(search.objective, 0.0), depth=0.1 if attempt == "stuck" else 0.0)


def looked_at(values, costs, stuck=()):
    known, searcher = found.Found(), FakeSearcher(costs)
    for value in values:
        known.add(Fake(value), "stuck" if value in stuck else "guess")
    known.keep_apart(searcher, lambda: False)
    assert len(set(searcher.looked)) == len(searcher.looked)
    return known, searcher.asked


def test_links_are_kept_apart_in_the_cheapest_optimum_first_and_only_where_it_can_still_be_the_best():
    known, asked = looked_at([130.0, 100.0, 110.0, 300.0, 100.0], {100.0: 25.0, 110.0: 5.0})
    assert asked == [100.0, 110.0]
    assert [one.objective for one in known.best()] == [115.0, 125.0]
    known, asked = looked_at([100.0, 110.0, 300.0], {}, stuck=[100.0])
    assert asked == [100.0, 110.0] and [one.objective for one in known.best()] == [110.0]


def test_what_was_looked_at_is_not_looked_at_again():
    known, asked = looked_at([100.0, 110.0], {100.0: 50.0, 110.0: 60.0})
    known.add(Fake(105.0), "guess")
    again = FakeSearcher({})
    known.keep_apart(again, lambda: False)
    assert asked == [100.0, 110.0] and again.asked == [105.0]


def test_a_price_may_be_negative():
    """Drives that feed energy back: what is worse by 5 % is −95, and what is worse by a half is hopeless."""
    known, asked = looked_at([-100.0, -95.0, -50.0], {-100.0: 20.0})
    assert asked == [-100.0, -95.0] and [one.objective for one in known.best()] == [-95.0, -80.0]


def test_mirrored_motions_of_equal_price_are_two_optima():
    known, searcher = found.Found(), FakeSearcher({100.0: 1.0})
    for at in (2.0, -2.0, 2.05):
        known.add(Fake(100.0, at=at), "guess")
    known.keep_apart(searcher, lambda: False)
    assert [one.at for one in known.firsts()] == [2.0, -2.0] and searcher.asked == [100.0, 100.0]


def test_optima_count_as_known_once_hardly_another_one_is_to_be_expected():
    """After n searches in w optima: 11 < n for one, 28 < n for two, 53 < n for three (w (n − 1) / (n − w − 2) < w + ¼)."""
    for w, enough in ((1, 12), (2, 29), (3, 54)):
        known = found.Found()
        for n in range(1, enough + 1):
            known.add(Fake(100.0 + n % w))
            assert known.all_known == (n == enough)
        known.add(Fake(50.0))
        assert not known.all_known


def test_a_motion_with_one_optimum_takes_few_guesses_unless_more_are_asked_for():
    easy = eo.Problem(arms.catalogue_robot("ur5"), [0, -1.6, 0, 0, 0, 0], [0.2, -1.5, 0.2, 0, 0, 0], 1.0)
    plan = eo.plan(easy)
    assert plan.solved and len(plan.optima) == 1 and len(plan.options["tried"]) == 2 * campaign.BLOCK
    assert len(eo.plan(easy, starts=20).options["tried"]) == 20


def test_no_further_optimum_is_looked_at_where_time_is_short():
    known, searcher = found.Found(), FakeSearcher({100.0: 50.0})
    for value in (100.0, 110.0):
        known.add(Fake(value), "guess")
    known.keep_apart(searcher, lambda: True)
    assert searcher.asked == [100.0]  # without one there would be nothing to refine


@pytest.fixture(scope="module")
def folded():
    made = begun(folding(), 8)
    made.found.keep_apart(made.searcher, lambda: False)
    return made


def test_an_arm_that_would_be_in_its_own_way_is_kept_apart_at_a_higher_j(folded):
    known = folded.found
    (alone, *_), best = known.alone(), known.best()[0]
    assert overlap(alone.avoidance, alone.trajectory) > 10 * DEEP and overlap(best.avoidance, best.trajectory) <= DEEP
    assert best.objective > known.firsts()[0].objective


def test_drives_that_feed_energy_back_are_planned_to_the_accuracy_asked():
    """J is negative: what braking returns is more than the motion takes."""
    robot = eo.load_robot("ur5", actuators=ActuatorModel(100.0, 0.1, 0.05, regeneration=1.0))
    lowered = eo.Problem(robot, [0, -1.8, 0.3, 0, 0, 0], [0.5, -0.1, 0.2, 0, 0, 0], 2.0, costs=ElectricalEnergy())
    plan, exact = (eo.plan(lowered, eo.BSpline(accuracy=accuracy), starts=6) for accuracy in (1e-2, 1e-3))
    assert plan.objective < -50.0 and len(plan.optima) > 1 and plan.objective == pytest.approx(exact.objective, rel=1e-2)
    assert plan.discretization_error < 1e-2 and exact.discretization_error < 1e-3


def test_the_best_of_many_starts_with_self_collision_holds_and_its_optima_are_kept_apart():
    plan = eo.plan(folding(), FIXED, starts=12)
    assert plan.solved and verify(plan.problem, plan.trajectory).distance > 0.0
    assert len(plan.options["tried"]) == 12 == len(set(plan.options["tried"]))
    assert plan.objective <= eo.plan(folding(), FIXED, starts=1).objective * 1.001


def test_self_collision_gives_the_same_plan_in_one_process_or_in_several(two_workers):
    with two_workers.idle():
        first = eo.plan(folding(), FIXED, starts=12)
    again = eo.plan(folding(), FIXED, starts=12)
    assert two_workers.answers > 4
    assert again.options["tried"] == first.options["tried"] and again.objective == first.objective
    assert [one.summary for one in again.optima] == [one.summary for one in first.optima]


@dataclass
class FakeRunner:
    """Refines to what a table says; only `finished` ones count as refined."""

    search: Fake
    accuracy: float
    judge: object
    late: bool = False
    finished: ClassVar[list[float]] = []

    @property
    def objective(self):
        return 0.95 * self.search.objective

    @property
    def trajectory(self):
        return self.search.trajectory

    def step(self):
        return True

    def finish(self):
        FakeRunner.finished.append(self.search.objective)
        return self.search


@dataclass
class FakeJudge:
    broken: tuple = ()

    def holds(self, search):
        return search.objective not in self.broken

    def excess(self, search):
        return search.objective


def unasked():
    raise AssertionError("nothing else is needed")
    yield


@pytest.mark.parametrize(
    ("broken", "refined", "won"),
    [((), [100.0, 101.0], 100.0), ((100.0,), [100.0, 101.0], 101.0), ((100.0, 101.0), [100.0, 101.0, 109.0], 109.0)],
    ids=["best holds", "second holds", "third holds"],
)
def test_searches_are_refined_while_they_are_close_or_nothing_holds(monkeypatch, broken, refined, won):
    monkeypatch.setattr(racing, "Runner", FakeRunner)
    FakeRunner.finished = []
    searches = [Fake(value) for value in (150.0, 109.0, 101.0, 100.0, 110.0)]
    assert racing.winner(searches, unasked(), 0.01, FakeJudge(broken)).objective == won
    assert FakeRunner.finished == refined


def test_the_best_of_negative_prices_wins(monkeypatch):
    monkeypatch.setattr(racing, "Runner", FakeRunner)
    FakeRunner.finished = []
    searches = [Fake(value) for value in (-50.0, -99.0, -100.0, -80.0)]
    assert racing.winner(searches, unasked(), 0.01, FakeJudge()).objective == -100.0
    assert FakeRunner.finished == [-100.0, -99.0]


def test_of_searches_for_one_optimum_only_the_earliest_is_refined(monkeypatch):
    monkeypatch.setattr(racing, "Runner", FakeRunner)
    FakeRunner.finished = []
    searches = [Fake(100.5, at=0.05), Fake(100.0, at=0.0), Fake(101.6, at=0.0), Fake(100.9, at=0.2)]
    racing.winner(searches, [], 0.01, FakeJudge())
    assert FakeRunner.finished == [100.5, 100.9, 101.6]  # the last is at the same place, but its J is another


def test_the_others_are_refined_where_none_in_the_race_holds_and_the_least_bad_is_returned(monkeypatch):
    monkeypatch.setattr(racing, "Runner", FakeRunner)
    FakeRunner.finished = []
    won = racing.winner([Fake(100.0)], [Fake(200.0), Fake(90.0)], 0.01, FakeJudge((100.0, 200.0)))
    assert won.objective == 90.0 and FakeRunner.finished == [100.0, 200.0, 90.0]
    nothing = racing.winner([Fake(100.0)], [Fake(200.0), Fake(90.0)], 0.01, FakeJudge((90.0, 100.0, 200.0)))
    assert nothing.objective == 90.0


class LateRunner(FakeRunner):
    """One that a time limit ends."""

    def finish(self):
        self.late = True
        return replace(self.search, outcome=Outcome.TIME_LIMIT)


def test_when_time_is_over_the_cheapest_that_holds_wins_refined_or_not(monkeypatch):
    monkeypatch.setattr(racing, "Runner", LateRunner)
    searches = [Fake(value) for value in (110.0, 100.0, 120.0)]
    assert racing.winner(searches, unasked(), 0.01, FakeJudge((100.0,))).objective == 110.0
    assert racing.winner(searches, unasked(), 0.01, FakeJudge((100.0,)), [Fake(105.0)]).objective == 105.0
    nothing = racing.winner(searches, unasked(), 0.01, FakeJudge((100.0, 110.0, 120.0)))
    assert nothing.outcome is Outcome.TIME_LIMIT


def test_a_runner_that_is_late_solves_nothing_and_keeps_what_holds(solved):
    made = begun(eo.Problem(arms.pendulum(), [-1.2], [1.0], 1.5), 1)
    search, before = made.found.searches[0], len(solved)
    search.options = SearchOptions(deadline=0.0)
    runner = racing.Runner(search, 0.01, made.judge)
    done = runner.finish()
    assert runner.late and len(solved) == before and done.converged and made.judge.holds(done)
    assert "the time limit has passed" in done.reason


@pytest.mark.parametrize("limited", [False, True])
def test_where_time_is_limited_the_first_guess_is_made_valid_before_others_are_tried(limited):
    problem = folding()
    options = SearchOptions(deadline=time.monotonic() + 1e6 if limited else None)
    made = campaign.Campaign(problem, FIXED, kernels_of(problem.robot.dynamics), options, 0)
    best = made.run(6)
    assert [search.name for search in made._sure] == ["straight"] * limited and all(map(made.judge.holds, made._sure))
    assert made.judge.holds(best) and best.objective <= min((sure.objective for sure in made._sure), default=np.inf)


def test_a_race_is_won_by_the_best_of_what_its_runners_would_reach_alone(folded):
    best = folded.found.best()
    alone = [folded.refined(search).objective for search in best[:3]]
    won = racing.winner(best[:3], [], None, folded.judge)
    assert won.objective == pytest.approx(min(alone), rel=1e-6)


# ---- what is solved ----


@pytest.fixture
def solved(monkeypatch):
    """Programs and options of all solves, in turn."""
    found, solve = [], rounds.solve

    def noted(program, x0, options, *rest):
        found.append((program, options))
        return solve(program, x0, options, *rest)

    monkeypatch.setattr(rounds, "solve", noted)
    return found


def test_a_given_spline_is_solved_on_its_own_knots_first(solved):
    problem = eo.Problem(arms.pendulum(), [-1.2], [1.0], 1.5)
    fine = eo.plan(problem, eo.BSpline(knots=1.5 * np.linspace(0.0, 1.0, 24) ** 1.1))
    solved.clear()
    again = eo.plan(problem, guess=fine.trajectory)
    np.testing.assert_allclose(solved[0][0].space.breaks, fine.trajectory.breaks)
    assert again.objective <= fine.objective * (1.0 + 1e-6) and len(again.options["tried"]) == 1


def test_a_first_look_is_followed_by_an_exact_solve_where_no_accuracy_is_asked_for(solved):
    plan = eo.plan(folding(), FIXED, starts=6)
    looks = [options.tolerance > rounds.ROUGH_TOLERANCE[1] for _, options in solved]
    assert plan.solved and any(looks) and not looks[-1]


def test_torque_rows_of_a_motion_of_free_duration_keep_their_multipliers(solved):
    robot, costs = arms.two_link(), [TorqueSquared(), 1e4 * Duration()]
    problem = eo.Problem(robot, [0.3, -0.2], [-0.5, 0.9], (0.1, 6.0), costs=costs, torque_limits=25.0)
    plan = eo.plan(problem, eo.BSpline(accuracy=None), starts=1)
    kept = []
    for program, options in solved:
        linear, torque = len(program.layout.linear.lower), len(program.layout.torque.lower)
        if options.multipliers is not None:
            kept.append(np.count_nonzero(options.multipliers[0][linear : linear + torque]))
    assert plan.solved and len(kept) > 1 and max(kept) > 50


def test_what_was_planned_before_does_not_change_a_bit_of_a_plan():
    """Exact distances do depend on it: the library that computes them remembers where it ended."""
    robot, rng = arms.catalogue_robot("panda"), np.random.default_rng(0)
    goals = [robot.home + rng.uniform(-0.3, 0.3, 7) for _ in range(22)]
    method, problem = eo.BSpline(control_points=10, accuracy=None), eo.Problem(robot, robot.home, goals[14], 1.5)
    first = eo.plan(problem, method, starts=6)
    for k in (0, 7, 21):
        eo.plan(eo.Problem(robot, robot.home, goals[k], 1.5), method, starts=1, throw=False)
        assert eo.plan(problem, method, starts=6).objective == first.objective


def test_knots_that_hold_no_motion_are_given_up_after_a_few_guesses_before_any_process_is_started(two_workers):
    limits = {"velocity_limits": 3.0, "acceleration_limits": 20.0}
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], 0.58, **limits)
    method = eo.BSpline(control_points=10)
    with two_workers.idle():
        one = eo.plan(problem, method, throw=False)
    several = eo.plan(problem, method, throw=False)
    assert two_workers.answers == 0 and len(one.options["tried"]) < campaign.STARTS
    assert one.options["tried"] == several.options["tried"] and one.iterations == several.iterations


def test_knots_whose_bounds_contradict_each_other_hold_no_motion():
    problem = eo.Problem(arms.two_link(), [0.0, 0.0], [1.0, 0.5], 1.0, velocity_limits=1.25)
    plan = eo.plan(problem, eo.BSpline(control_points=7, accuracy=None), throw=False)
    assert plan.status is eo.Status.INFEASIBLE and eo.plan(problem).solved
