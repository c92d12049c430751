/* A primal-dual interior-point method with a filter line search for programs along a time line,

       minimise f(x)   with  xl <= x <= xu,  gl <= g(x) <= gu,

   after A. Waechter, L. T. Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale
   nonlinear programming", Mathematical Programming 106 (2006), whose equation numbers stand below as (WB n). Rows get slacks,
   g(x) - s = 0; w = (x, s) are the N = n + m variables with bounds, y the multipliers of the rows, zl and zu those of the
   bounds. A row with gl = gu has the constant s = gl.

   Slacks and the multipliers of bounded rows are eliminated by hand. What is left,

       [ H + S + J' Z J       E' ]     H: Hessian; S and Z: diagonals of the bounds of x and of the rows J;
       [ E                -1e-12 ]     E: Jacobian of the equality rows,

   is a skyline in the unknowns' own order, equalities last (see skyline.c; dense unknowns, such as a duration, should be the
   last). Three things differ from IPOPT:

   - Where the inertia is not that of a minimum, S and Z are raised by multiples of a metric, not of one: the diagonal of H, and
     what corresponds to it on the slacks. Steps then do not depend on the units and lengths of spans behind the unknowns.
   - Near an optimum steps with a predictor and a corrector are tried first.
   - There is no restoration of feasibility: the caller has IPOPT for that.

   Nothing here allocates after the start, calls back except for the program's functions, or depends on time or chance. */

typedef struct {
  void (*state)(void *, const double *x);
  double (*objective)(void *);
  void (*constraints)(void *, const double *x, double *g);
  void (*gradient)(void *, double *g);
  void (*jacobian)(void *, double *values);
  void (*hessian)(void *, double sigma, const double *lambda, double *values);
  void *context;
} Functions;

typedef struct {
  long n, m;
  const double *lower, *upper, *row_lower, *row_upper;
  const int *jac_start, *jac_row, *hess_start, *hess_row; /* by column; the Hessian's upper triangle */
  Functions call;
} Program;

typedef struct {
  double tolerance, violation, barrier, scale, push;
  long iterations, warm; /* warm: the start may be near an optimum */
  const double *row_guess, *bound_guess; /* multipliers to start with, positive where the upper side holds; may be null */
} Options;

enum { RUNNING, CONVERGED, ACCEPTABLE, ITERATION_LIMIT, NO_STEP, NOT_A_NUMBER, SINGULAR, TOO_WIDE, NO_MEMORY };
enum { FILTER = 200, STALLED = 40 };

typedef struct {
  Program p;
  Options o;
  Skyline k;
  long n, m, N, equalities, status, iteration, filter_size, states, gradients, hessians, acceptable, tiny, unchanged;
  long *equality, *row_start, *row_entry; /* place of a row among the equalities or -1; rows of J by row: entry and column */
  int *row_column;
  double *L, *U, *row_scale;              /* bounds of w; factors of the rows */
  double *w, *y, *zl, *zu, *g, *df, *J, *H, f;
  double *dw, *dy, *dzl, *dzu, *trial, *trial_g, *lambda;
  double *rw, *rc, *rs_w, *rs_y, *sol, *e_w, *e_c, *e_dw, *e_dy, *bare, *sigma, *metric, *soc, *target_l, *target_u, *kept; /* work */
  double filter[FILTER][2];
  double mu, first_mu, delta, last_delta, theta_least, theta_most, scale, first_f, steady_f, error;
  double alpha, alpha_dual;
  void *memory;
} Interior;

/* ---- evaluation, scaled ---- */

static int finite_all(const double *v, long n) {
  for (long i = 0; i < n; ++i)
    if (!isfinite(v[i])) return 0;
  return 1;
}

static int evaluate_point(Interior *I, const double *x, double *f, double *g) {
  I->p.call.state(I->p.call.context, x), ++I->states;
  *f = I->scale * I->p.call.objective(I->p.call.context);
  if (I->m) I->p.call.constraints(I->p.call.context, x, g);
  for (long r = 0; r < I->m; ++r) g[r] *= I->row_scale[r];
  return isfinite(*f) && finite_all(g, I->m);
}

static int evaluate_slopes(Interior *I) {
  I->p.call.gradient(I->p.call.context, I->df), ++I->gradients;
  for (long i = 0; i < I->n; ++i) I->df[i] *= I->scale;
  const long nonzeros = I->p.jac_start[I->n];
  if (I->m) I->p.call.jacobian(I->p.call.context, I->J);
  for (long e = 0; e < nonzeros; ++e) I->J[e] *= I->row_scale[I->p.jac_row[e]];
  return finite_all(I->df, I->n) && finite_all(I->J, nonzeros);
}

static int evaluate_curvature(Interior *I) {
  for (long r = 0; r < I->m; ++r) I->lambda[r] = I->row_scale[r] * I->y[r];
  I->p.call.hessian(I->p.call.context, I->scale, I->lambda, I->H), ++I->hessians;
  return finite_all(I->H, I->p.hess_start[I->n]);
}

/* ---- sparse products ---- */

static void add_jacobian(const Interior *I, const double *x, double *out) { /* out += J x */
  for (long j = 0; j < I->n; ++j)
    for (int e = I->p.jac_start[j]; e < I->p.jac_start[j + 1]; ++e) out[I->p.jac_row[e]] += I->J[e] * x[j];
}

static void add_transposed(const Interior *I, const double *y, double *out) { /* out += J' y */
  for (long j = 0; j < I->n; ++j) {
    double sum = 0.0;
    for (int e = I->p.jac_start[j]; e < I->p.jac_start[j + 1]; ++e) sum += I->J[e] * y[I->p.jac_row[e]];
    out[j] += sum;
  }
}

static void add_hessian(const Interior *I, const double *x, double *out) { /* out += H x */
  for (long j = 0; j < I->n; ++j) {
    double sum = 0.0;
    for (int e = I->p.hess_start[j]; e < I->p.hess_start[j + 1]; ++e) {
      const int i = I->p.hess_row[e];
      sum += I->H[e] * x[i];
      if (i != j) out[i] += I->H[e] * x[j];
    }
    out[j] += sum;
  }
}

/* ---- the linear system ---- */

#define DUAL_SHIFT 1e-12
#define MOST_PRODUCTS 1e8 /* of a factorization, about */
#define LEAST_METRIC 1e-8
#define SLACK_METRIC 10.0

/* first column of each row of the skyline; 0 where there is no memory */
static int find_skyline(Interior *I) {
  const long size = I->n + I->equalities;
  long *first = malloc((size + 1) * sizeof *first);
  if (!first) return 0;
  for (long i = 0; i < size; ++i) first[i] = i;
  for (long j = 0; j < I->n; ++j)
    if (I->p.hess_start[j] < I->p.hess_start[j + 1] && I->p.hess_row[I->p.hess_start[j]] < first[j])
      first[j] = I->p.hess_row[I->p.hess_start[j]];
  for (long r = 0; r < I->m; ++r) {
    if (I->row_start[r] == I->row_start[r + 1]) continue;
    const long low = I->row_column[I->row_start[r]];
    if (I->equality[r] >= 0) first[I->n + I->equality[r]] = low;
    else
      for (long e = I->row_start[r]; e < I->row_start[r + 1]; ++e)
        if (low < first[I->row_column[e]]) first[I->row_column[e]] = low;
  }
  double products = 0.0;
  for (long i = 0; i < size; ++i) products += (double)(i - first[i]) * (i - first[i]);
  if (products > MOST_PRODUCTS) I->status = TOO_WIDE;
  return skyline_make(&I->k, size, first);
}

static void assemble(Interior *I) {
  Skyline *k = &I->k;
  skyline_zero(k);
  for (long j = 0; j < I->n; ++j)
    for (int e = I->p.hess_start[j]; e < I->p.hess_start[j + 1]; ++e) *entry(k, j, I->p.hess_row[e]) += I->H[e];
  for (long i = 0; i < I->n; ++i) k->d[i] += I->sigma[i];
  for (long r = 0; r < I->m; ++r) {
    const long begin = I->row_start[r], end = I->row_start[r + 1];
    if (I->equality[r] >= 0) {
      const long at = I->n + I->equality[r];
      for (long e = begin; e < end; ++e) *entry(k, at, I->row_column[e]) += I->J[I->row_entry[e]];
      k->d[at] = -DUAL_SHIFT;
      continue;
    }
    for (long e = begin; e < end; ++e) {
      const double value = I->sigma[I->n + r] * I->J[I->row_entry[e]];
      double *row = k->values + k->start[I->row_column[e]];
      for (long h = begin; h < e; ++h) row[I->row_column[h]] += value * I->J[I->row_entry[h]];
      k->d[I->row_column[e]] += value * I->J[I->row_entry[e]];
    }
  }
}

/* diagonals of the bounds: z / gap */
static void set_bounds(Interior *I) {
  for (long i = 0; i < I->N; ++i) {
    I->bare[i] = 0.0;
    if (isfinite(I->L[i])) I->bare[i] += I->zl[i] / (I->w[i] - I->L[i]);
    if (isfinite(I->U[i])) I->bare[i] += I->zu[i] / (I->U[i] - I->w[i]);
  }
}

/* |H_ii| of the unknowns; of a slack, some times 1 / (J M^-1 J'), the metric M of the unknowns as the row sees it */
static void set_metric(Interior *I) {
  for (long i = 0; i < I->n; ++i) {
    const int last = I->p.hess_start[i + 1] - 1;
    const int there = last >= I->p.hess_start[i] && I->p.hess_row[last] == i;
    I->metric[i] = fmax(there ? fabs(I->H[last]) : 0.0, LEAST_METRIC);
  }
  for (long r = 0; r < I->m; ++r) {
    double sum = 0.0;
    for (long e = I->row_start[r]; e < I->row_start[r + 1]; ++e) {
      const double value = I->J[I->row_entry[e]];
      sum += value * value / I->metric[I->row_column[e]];
    }
    I->metric[I->n + r] = sum > 0.0 ? SLACK_METRIC / sum : 0.0;
  }
}

/* Factor with a delta that gives the inertia of a minimum, and not much more (WB, algorithm IC). */
static int factor(Interior *I) {
  set_bounds(I), set_metric(I);
  for (I->delta = 0.0; I->delta < 1e20;) {
    for (long i = 0; i < I->N; ++i) I->sigma[i] = I->bare[i] + I->delta * I->metric[i];
    assemble(I);
    if (skyline_factor(&I->k, I->equalities) == I->equalities) {
      if (I->delta > 0.0) I->last_delta = I->delta;
      return 1;
    }
    if (I->delta > 0.0) I->delta *= 3.0;
    else I->delta = I->last_delta == 0.0 ? 1e-4 : fmax(1e-12, I->last_delta / 6.0);
  }
  return 0;
}

/* dw, dy from residuals rw of the variables and rc of the rows: the linear system with right-hand side -(rw, rc) */
static void back_solve(Interior *I, const double *rw, const double *rc, double *dw, double *dy) {
  const long n = I->n;
  double *t = I->rs_y, *x = I->sol;
  for (long r = 0; r < I->m; ++r) t[r] = I->equality[r] < 0 ? I->sigma[n + r] * rc[r] + rw[n + r] : 0.0;
  for (long i = 0; i < n; ++i) x[i] = rw[i];
  add_transposed(I, t, x);
  for (long i = 0; i < n; ++i) x[i] = -x[i];
  for (long r = 0; r < I->m; ++r)
    if (I->equality[r] >= 0) x[n + I->equality[r]] = -rc[r];
  skyline_solve(&I->k, x);
  for (long i = 0; i < n; ++i) dw[i] = x[i];
  for (long r = 0; r < I->m; ++r) t[r] = rc[r];
  add_jacobian(I, dw, t);
  for (long r = 0; r < I->m; ++r) {
    const int equal = I->equality[r] >= 0;
    dw[n + r] = equal ? 0.0 : t[r];
    dy[r] = equal ? x[n + I->equality[r]] : I->sigma[n + r] * t[r] + rw[n + r];
  }
}

static void solve_system(Interior *I, const double *rw, const double *rc, double *dw, double *dy) {
  const long n = I->n;
  back_solve(I, rw, rc, dw, dy);
  for (int round = 0; round < 1; ++round) { /* refined once by the residual of the whole system */
    for (long i = 0; i < I->N; ++i) I->e_w[i] = rw[i] + I->sigma[i] * dw[i];
    add_hessian(I, dw, I->e_w);
    add_transposed(I, dy, I->e_w);
    for (long r = 0; r < I->m; ++r) {
      I->e_w[n + r] = I->equality[r] >= 0 ? 0.0 : I->e_w[n + r] - dy[r];
      I->e_c[r] = rc[r] - dw[n + r];
    }
    add_jacobian(I, dw, I->e_c);
    back_solve(I, I->e_w, I->e_c, I->e_dw, I->e_dy);
    for (long i = 0; i < I->N; ++i) dw[i] += I->e_dw[i];
    for (long r = 0; r < I->m; ++r) dy[r] += I->e_dy[r];
  }
}
