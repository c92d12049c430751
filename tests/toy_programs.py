"""Programs of a few unknowns whose optima are known, for the tests of solvers."""

import numpy as np
from scipy.sparse import csc_array


class Toy:
    """Minimise f(x) with A x rows; derivatives of f given as functions, the Hessian dense (upper triangle)."""

    def __init__(self, f, gradient, hessian, n, *, rows=None, row_bounds=((), ()), bounds=None):
        self.f, self.df, self.ddf, self.size = f, gradient, hessian, n
        self.A = csc_array(np.zeros((0, n)) if rows is None else np.asarray(rows, float))
        self.row_lower, self.row_upper = (np.asarray(b, float) for b in row_bounds)
        self.rows = len(self.row_lower)
        free = np.full(n, np.inf)
        self.lower, self.upper = (np.asarray(b, float) for b in ((-free, free) if bounds is None else bounds))
        self.jacobian_pattern = self.A.indptr, self.A.indices
        self._upper = np.array([(i, j) for j in range(n) for i in range(j + 1)]).T
        self.hessian_pattern = np.concatenate([[0], np.cumsum(np.arange(1, n + 1))]), self._upper[0]
        self.linear_only, self.evaluator, self.moves = True, self, 0

    def move(self, x):
        self.x, self.moves = x.copy(), self.moves + 1

    def objective(self):
        return self.f(self.x)

    def constraints(self, x, out):
        out[:] = self.A @ x

    def gradient(self, out):
        out[:] = self.df(self.x)

    def jacobian(self, out):
        out[:] = self.A.data

    def hessian(self, sigma, multipliers, out):
        out[:] = sigma * self.ddf(self.x)[tuple(self._upper)]


def rosenbrock(**options):
    """f = 100 (y − x²)² + (1 − x)², least at (1, 1)."""
    f = lambda x: 100 * (x[1] - x[0] ** 2) ** 2 + (1 - x[0]) ** 2
    df = lambda x: np.array([-400 * x[0] * (x[1] - x[0] ** 2) - 2 * (1 - x[0]), 200 * (x[1] - x[0] ** 2)])
    ddf = lambda x: np.array([[1200 * x[0] ** 2 - 400 * x[1] + 2, -400 * x[0]], [-400 * x[0], 200.0]])
    return Toy(f, df, ddf, 2, **options)


def parabola(n=2, **options):
    """f = ½ |x|²."""
    return Toy(lambda x: 0.5 * x @ x, lambda x: x, lambda x: np.eye(n), n, **options)
