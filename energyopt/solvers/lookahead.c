/* One Newton step of a program from a point, along the limits that are near there: what it promises. See `lookahead.py`; the
   matrices are laid out as for `interior.c`. */

typedef struct {
  long n, m;
  const double *lower, *upper, *row_lower, *row_upper;
  const int *jac_start, *jac_row, *hess_start, *hess_row;
  const double *x, *g, *gradient, *jacobian, *hessian;
  long known;              /* unknowns from here on are held */
  double near, stiffness;
  const double *shifts;
  long tries;
} Point;

/* whether a limit is near: less than a share of its interval is left */
static int is_near(const Point *p, double value, double low, double high) {
  const double width = isfinite(high - low) ? high - low : 1.0;
  return fmin(high - value, value - low) <= p->near * width;
}

/* unknowns scaled to a curvature of one; 0 for those held */
static void find_sizes(const Point *p, double *size) {
  for (long i = 0; i < p->n; ++i) {
    const int last = p->hess_start[i + 1] - 1;
    const double curvature = last >= p->hess_start[i] && p->hess_row[last] == i ? fabs(p->hessian[last]) : 0.0;
    size[i] = i >= p->known || is_near(p, p->x[i], p->lower[i], p->upper[i]) ? 0.0 : 1.0 / sqrt(fmax(curvature, 1e-300));
  }
}

/* entries of the rows near their limits, in scaled unknowns and of length one: by row, columns rising */
typedef struct {
  long *start;
  int *column;
  double *value;
} Active;

static void find_active(const Point *p, const double *size, Active *a) {
  for (long r = 0; r <= p->m; ++r) a->start[r] = 0;
  for (long j = 0; j < p->n; ++j)
    for (int e = p->jac_start[j]; e < p->jac_start[j + 1]; ++e) ++a->start[p->jac_row[e] + 1];
  for (long r = 0; r < p->m; ++r) a->start[r + 1] += a->start[r];
  for (long j = 0; j < p->n; ++j)
    for (int e = p->jac_start[j]; e < p->jac_start[j + 1]; ++e) {
      const long at = a->start[p->jac_row[e]]++;
      a->column[at] = (int)j, a->value[at] = p->jacobian[e] * size[j];
    }
  for (long r = p->m; r > 0; --r) a->start[r] = a->start[r - 1];
  a->start[0] = 0;
  for (long r = 0; r < p->m; ++r) {
    double square = 0.0;
    const double on = is_near(p, p->g[r], p->row_lower[r], p->row_upper[r]);
    for (long e = a->start[r]; e < a->start[r + 1]; ++e) square += a->value[e] * a->value[e];
    for (long e = a->start[r]; e < a->start[r + 1]; ++e) a->value[e] *= square > 0.0 ? on / sqrt(square) : 0.0;
  }
}

static void find_profile(const Point *p, const double *size, const Active *a, long *first) {
  for (long j = 0; j < p->n; ++j) {
    first[j] = j;
    for (int e = p->hess_start[j]; e < p->hess_start[j + 1] && size[j] != 0.0; ++e)
      if (size[p->hess_row[e]] != 0.0 && p->hess_row[e] < first[j]) first[j] = p->hess_row[e];
  }
  for (long r = 0; r < p->m; ++r) {
    long low = -1;
    for (long e = a->start[r]; e < a->start[r + 1]; ++e) {
      if (a->value[e] == 0.0) continue;
      if (low < 0) low = a->column[e];
      if (low < first[a->column[e]]) first[a->column[e]] = low;
    }
  }
}

static void fill(const Point *p, const double *size, const Active *a, double shift, Skyline *k) {
  skyline_zero(k);
  for (long j = 0; j < p->n; ++j) {
    for (int e = p->hess_start[j]; e < p->hess_start[j + 1] && size[j] != 0.0; ++e)
      if (size[p->hess_row[e]] != 0.0) *entry(k, j, p->hess_row[e]) += p->hessian[e] * size[j] * size[p->hess_row[e]];
    k->d[j] += size[j] == 0.0 ? 1.0 : shift;
  }
  for (long r = 0; r < p->m; ++r)
    for (long e = a->start[r]; e < a->start[r + 1]; ++e) {
      if (a->value[e] == 0.0) continue;
      const double value = p->stiffness * a->value[e];
      k->d[a->column[e]] += value * a->value[e];
      for (long h = a->start[r]; h < e; ++h)
        if (a->value[h] != 0.0) *entry(k, a->column[e], a->column[h]) += value * a->value[h];
    }
}

/* d' H d, scaled */
static double curvature_along(const Point *p, const double *size, const double *d) {
  double sum = 0.0;
  for (long j = 0; j < p->n; ++j)
    for (int e = p->hess_start[j]; e < p->hess_start[j + 1]; ++e) {
      const long i = p->hess_row[e];
      sum += (i == j ? 1.0 : 2.0) * p->hessian[e] * size[i] * d[i] * size[j] * d[j];
    }
  return sum;
}

/* The gain, and |g_j d_j| by unknown. Returns which shift made the curvature positive; -1 where none did, -2 without memory. */
long eo_newton_gain(const Point *p, double *gain, double *share) {
  const long n = p->n, nj = p->jac_start[n];
  double *reals = malloc((2 * n + nj + 1) * sizeof *reals);
  long *integers = malloc((p->m + 1) * sizeof *integers + (nj + 1) * sizeof(int)), *first = malloc((n + 1) * sizeof *first);
  Skyline k = {0};
  long found = -2;
  if (reals && integers && first) {
    double *size = reals, *d = reals + n;
    Active a = {integers, (int *)(integers + p->m + 1), reals + 2 * n};
    find_sizes(p, size), find_active(p, size, &a), find_profile(p, size, &a, first);
    if (skyline_make(&k, n, first)) {
      found = -1;
      for (long t = 0; t < p->tries && found < 0; ++t) {
        fill(p, size, &a, p->shifts[t], &k);
        if (skyline_factor(&k, 0) == 0) found = t;
      }
    }
    first = 0; /* the skyline's own */
    if (found >= 0) {
      for (long i = 0; i < n; ++i) d[i] = size[i] * p->gradient[i];
      skyline_solve(&k, d);
      *gain = -0.5 * curvature_along(p, size, d);
      for (long i = 0; i < n; ++i) *gain += size[i] * p->gradient[i] * d[i], share[i] = fabs(size[i] * p->gradient[i] * d[i]);
    }
  }
  skyline_free(&k), free(first), free(integers), free(reals);
  return found;
}
