"""Ways around obstacles: a quick collision test, RRT-Connect, shorter and rounder paths, the fastest motion along them."""

from energyopt.pathfinding.curves import rounded
from energyopt.pathfinding.free_space import FreeSpace
from energyopt.pathfinding.guesses import Guess, find_guess, find_path, guesses, via_points
from energyopt.pathfinding.rrt import Budget, PathSearch, require_free, rrt_connect
from energyopt.pathfinding.shortening import Effort, length, resampled, shorten
from energyopt.pathfinding.timing import TimeLaw, fastest, shortest_duration, timed, timed_smoothly

__all__ = [
    "Budget",
    "Effort",
    "FreeSpace",
    "Guess",
    "PathSearch",
    "TimeLaw",
    "fastest",
    "find_guess",
    "find_path",
    "guesses",
    "length",
    "require_free",
    "resampled",
    "rounded",
    "rrt_connect",
    "shorten",
    "shortest_duration",
    "timed",
    "timed_smoothly",
    "via_points",
]
