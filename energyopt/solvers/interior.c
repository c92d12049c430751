/* A primal-dual interior-point method with a filter line search for programs along a time line,

       minimise f(x)   with  xl <= x <= xu,  gl <= g(x) <= gu,

   after A. Waechter, L. T. Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale
   nonlinear programming", Mathematical Programming 106 (2006), whose equation numbers stand below as (WB n). Rows get slacks,
   g(x) - s = 0; w = (x, s) are the N = n + m variables with bounds, y the multipliers of the rows, zl and zu those of the
   bounds. A row with gl = gu has the constant s = gl.

   Slacks and the multipliers of bounded rows are eliminated by hand. What is left,

       [ H + S + J' Z J + delta   E' ]     H: Hessian, S and Z: diagonals of the bounds of x and of the rows J,
       [ E                    -1e-12 ]     E: Jacobian of the equality rows,

   is a skyline of the unknowns' own order, equalities last (see skyline.c). Where its inertia is not that of a minimum delta
   is raised. Nothing here allocates after the start, calls back except for the program's functions, or depends on time. */

#include <time.h>

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
  long iterations;
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
  double *rw, *rc, *rs_w, *rs_y, *sol, *e_w, *e_c, *e_dw, *e_dy, *sigma, *base, *soc; /* work */
  double filter[FILTER][2];
  double mu, delta, last_delta, theta_least, theta_most, scale, first_f, steady_f, error;
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
    const long b = I->row_start[r], end = I->row_start[r + 1];
    if (I->equality[r] >= 0) {
      for (long e = b; e < end; ++e) *entry(k, I->n + I->equality[r], I->row_column[e]) += I->J[I->row_entry[e]];
      k->d[I->n + I->equality[r]] = -DUAL_SHIFT;
      continue;
    }
    const double weight = I->sigma[I->n + r];
    for (long e = b; e < end; ++e) {
      const double value = weight * I->J[I->row_entry[e]];
      const long i = I->row_column[e];
      double *row = k->values + k->start[i];
      for (long h = b; h < e; ++h) row[I->row_column[h]] += value * I->J[I->row_entry[h]];
      k->d[i] += value * I->J[I->row_entry[e]];
    }
  }
  memcpy(I->base, k->values, (k->profile + k->n) * sizeof(double));
}

/* Factor with the least delta that gives the inertia of a minimum (WB, algorithm IC). */
static int factor(Interior *I) {
  Skyline *k = &I->k;
  assemble(I);
  I->delta = 0.0;
  for (int attempt = 0; attempt < 60; ++attempt) {
    if (skyline_factor(k, I->equalities) == I->equalities) {
      if (I->delta > 0.0) I->last_delta = I->delta;
      return 1;
    }
    if (I->delta == 0.0) I->delta = I->last_delta == 0.0 ? 1e-4 : fmax(1e-20, I->last_delta / 3.0);
    else I->delta *= I->last_delta == 0.0 ? 100.0 : 8.0;
    if (I->delta > 1e40) return 0;
    memcpy(k->values, I->base, (k->profile + k->n) * sizeof(double));
    for (long i = 0; i < I->n; ++i) k->d[i] += I->delta;
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
    for (long i = 0; i < I->N; ++i) I->e_w[i] = rw[i] + (I->sigma[i] + (i < n ? I->delta : 0.0)) * dw[i];
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

/* ---- measures ---- */

static double infeasibility(const Interior *I, const double *w, const double *g) {
  double sum = 0.0;
  for (long r = 0; r < I->m; ++r) sum += fabs(g[r] - w[I->n + r]);
  return sum;
}

static double barrier_value(const Interior *I, double f, const double *w) {
  double logs = 0.0, product = 1.0;
  for (long i = 0; i < I->N; ++i) {
    if (isfinite(I->L[i])) product *= w[i] - I->L[i];
    if (isfinite(I->U[i])) product *= I->U[i] - w[i];
    if (!(product > 1e-100 && product < 1e100)) logs += log(product), product = 1.0;
  }
  return f - I->mu * (logs + log(product));
}

/* residual of the variables at the barrier parameter mu, with the multipliers y */
static void barrier_gradient(const Interior *I, double mu, double *out) {
  for (long i = 0; i < I->N; ++i) {
    double sum = i < I->n ? I->df[i] : 0.0;
    if (isfinite(I->L[i])) sum -= mu / (I->w[i] - I->L[i]);
    if (isfinite(I->U[i])) sum += mu / (I->U[i] - I->w[i]);
    out[i] = sum;
  }
}

/* the scaled optimality error (WB 5); mu = 0 for the program itself */
static double optimality_error(Interior *I, double mu, double *violation) {
  double dual = 0.0, product = 0.0, sum_z = 0.0, sum_y = 0.0, primal = 0.0;
  long count = 0;
  for (long i = 0; i < I->N; ++i) I->e_w[i] = i < I->n ? I->df[i] : -I->y[i - I->n];
  add_transposed(I, I->y, I->e_w);
  for (long i = 0; i < I->N; ++i) {
    if (i >= I->n && I->equality[i - I->n] >= 0) continue;
    if (isfinite(I->L[i])) product = fmax(product, fabs(I->zl[i] * (I->w[i] - I->L[i]) - mu)), sum_z += I->zl[i], ++count;
    if (isfinite(I->U[i])) product = fmax(product, fabs(I->zu[i] * (I->U[i] - I->w[i]) - mu)), sum_z += I->zu[i], ++count;
    dual = fmax(dual, fabs(I->e_w[i] - I->zl[i] + I->zu[i]));
  }
  *violation = 0.0;
  for (long r = 0; r < I->m; ++r) {
    const double miss = fabs(I->g[r] - I->w[I->n + r]);
    primal = fmax(primal, miss), *violation = fmax(*violation, miss / I->row_scale[r]), sum_y += fabs(I->y[r]);
  }
  const double of_dual = fmax(100.0, (sum_y + sum_z) / fmax(1, I->m + count)) / 100.0;
  const double of_product = fmax(100.0, sum_z / fmax(1, count)) / 100.0;
  return fmax(fmax(dual / of_dual, product / of_product), primal);
}

/* ---- steps ---- */

/* largest step for which variables and multipliers keep a share 1 - tau of their distance to zero (WB 15) */
static double to_boundary(const Interior *I, const double *dw, double tau) {
  double alpha = 1.0;
  for (long i = 0; i < I->N; ++i) {
    if (dw[i] < 0.0 && isfinite(I->L[i])) alpha = fmin(alpha, tau * (I->w[i] - I->L[i]) / -dw[i]);
    if (dw[i] > 0.0 && isfinite(I->U[i])) alpha = fmin(alpha, tau * (I->U[i] - I->w[i]) / dw[i]);
  }
  return alpha;
}

static double dual_to_boundary(const Interior *I, double tau) {
  double alpha = 1.0;
  for (long i = 0; i < I->N; ++i) {
    if (I->dzl[i] < 0.0) alpha = fmin(alpha, tau * I->zl[i] / -I->dzl[i]);
    if (I->dzu[i] < 0.0) alpha = fmin(alpha, tau * I->zu[i] / -I->dzu[i]);
  }
  return alpha;
}

static void direction(Interior *I, double mu, const double *rc, double *dw, double *dy) {
  barrier_gradient(I, mu, I->rw);
  add_transposed(I, I->y, I->rw);
  for (long r = 0; r < I->m; ++r) I->rw[I->n + r] -= I->y[r];
  solve_system(I, I->rw, rc, dw, dy);
}

static void dual_direction(Interior *I, double mu, const double *dw) {
  for (long i = 0; i < I->N; ++i) {
    I->dzl[i] = I->dzu[i] = 0.0;
    if (isfinite(I->L[i])) { const double gap = I->w[i] - I->L[i]; I->dzl[i] = (mu - I->zl[i] * dw[i]) / gap - I->zl[i]; }
    if (isfinite(I->U[i])) { const double gap = I->U[i] - I->w[i]; I->dzu[i] = (mu + I->zu[i] * dw[i]) / gap - I->zu[i]; }
  }
}

static void set_sigma(Interior *I) {
  for (long i = 0; i < I->N; ++i) {
    I->sigma[i] = 0.0;
    if (isfinite(I->L[i])) I->sigma[i] += I->zl[i] / (I->w[i] - I->L[i]);
    if (isfinite(I->U[i])) I->sigma[i] += I->zu[i] / (I->U[i] - I->w[i]);
  }
}

/* ---- filter line search (WB, section 2.3) ---- */

static const double eta = 1e-8, margin_theta = 1e-5, margin_phi = 1e-8, s_phi = 2.3, s_theta = 1.1;

static int not_above(double a, double b, double size) { return a - b <= 10.0 * 2.2e-16 * fabs(size); }

static int filtered(const Interior *I, double theta, double phi) {
  for (long k = 0; k < I->filter_size; ++k)
    if (theta >= I->filter[k][0] && !not_above(phi, I->filter[k][1], phi)) return 1;
  return 0;
}

static void augment(Interior *I, double theta, double phi) {
  if (I->filter_size == FILTER) --I->filter_size;
  I->filter[I->filter_size][0] = (1.0 - margin_theta) * theta;
  I->filter[I->filter_size++][1] = phi - margin_phi * theta;
}

/* 1: accepted, 2: accepted by decrease of the barrier function alone */
static int acceptable(const Interior *I, double alpha, double slope, double theta, double phi, double new_theta, double new_phi) {
  if (!(new_theta <= I->theta_most) || filtered(I, new_theta, new_phi)) return 0;
  const int descends = slope < 0.0 && alpha * pow(-slope, s_phi) > pow(theta, s_theta);
  if (descends && theta <= I->theta_least) return not_above(new_phi - phi, eta * alpha * slope, phi) ? 2 : 0;
  if (!(not_above(new_theta, (1.0 - margin_theta) * theta, theta) || not_above(new_phi - phi, -margin_phi * theta, phi))) return 0;
  return descends && not_above(new_phi - phi, eta * alpha * slope, phi) ? 2 : 1;
}

static int evaluate_trial(Interior *I, const double *dw, double alpha, double *f, double *theta, double *phi) {
  for (long i = 0; i < I->N; ++i) I->trial[i] = I->w[i] + alpha * dw[i];
  if (!evaluate_point(I, I->trial, f, I->trial_g)) return 0;
  *theta = infeasibility(I, I->trial, I->trial_g), *phi = barrier_value(I, *f, I->trial);
  return isfinite(*phi);
}

/* second-order corrections (WB, section 2.4): the rows' curvature is met by another solve with the same factors */
static int correct(Interior *I, double alpha, double tau, double slope, double theta, double phi, double *f) {
  double *rc = I->rc, *dw = I->soc, new_theta = infeasibility(I, I->trial, I->trial_g), new_phi, last = theta;
  for (long r = 0; r < I->m; ++r) rc[r] = alpha * (I->g[r] - I->w[I->n + r]) + I->trial_g[r] - I->trial[I->n + r];
  for (int round = 0; round < 4; ++round) {
    direction(I, I->mu, rc, dw, I->rs_w);
    const double step = to_boundary(I, dw, tau);
    if (!evaluate_trial(I, dw, step, f, &new_theta, &new_phi)) return 0;
    const int verdict = acceptable(I, alpha, slope, theta, phi, new_theta, new_phi);
    if (verdict) return verdict;
    if (new_theta > 0.99 * last) return 0;
    last = new_theta;
    for (long r = 0; r < I->m; ++r) rc[r] = step * rc[r] + I->trial_g[r] - I->trial[I->n + r];
  }
  return 0;
}

/* Move w along dw. Returns 0 where no step is acceptable. */
static int search(Interior *I, double tau) {
  const double theta = infeasibility(I, I->w, I->g), phi = barrier_value(I, I->f, I->w);
  double slope = 0.0, f = 0.0, new_theta, new_phi, least = margin_theta;
  barrier_gradient(I, I->mu, I->e_w);
  for (long i = 0; i < I->N; ++i) slope += I->e_w[i] * I->dw[i];
  if (slope < 0.0) {
    least = fmin(least, margin_phi * theta / -slope);
    if (theta <= I->theta_least) least = fmin(least, pow(theta, s_theta) / pow(-slope, s_phi));
  }
  least = fmax(0.05 * least, 1e-14);
  double alpha = to_boundary(I, I->dw, tau);
  for (int first = 1; alpha >= least; alpha *= 0.5, first = 0) {
    if (!evaluate_trial(I, I->dw, alpha, &f, &new_theta, &new_phi)) continue;
    int verdict = acceptable(I, alpha, slope, theta, phi, new_theta, new_phi);
    if (!verdict && first && new_theta >= theta && I->m) verdict = correct(I, alpha, tau, slope, theta, phi, &f);
    if (!verdict) continue;
    if (verdict == 1) augment(I, theta, phi);
    memcpy(I->w, I->trial, I->N * sizeof(double)), memcpy(I->g, I->trial_g, I->m * sizeof(double));
    I->f = f, I->alpha = alpha;
    return 1;
  }
  return 0;
}

static void take_dual_step(Interior *I, double tau) {
  const double a = I->alpha_dual = dual_to_boundary(I, tau), spread = 1e10;
  for (long r = 0; r < I->m; ++r) I->y[r] += I->alpha * I->dy[r];
  for (long i = 0; i < I->N; ++i) {
    I->zl[i] += a * I->dzl[i], I->zu[i] += a * I->dzu[i];
    if (isfinite(I->L[i])) { const double c = I->mu / (I->w[i] - I->L[i]); I->zl[i] = fmax(fmin(I->zl[i], spread * c), c / spread); }
    if (isfinite(I->U[i])) { const double c = I->mu / (I->U[i] - I->w[i]); I->zu[i] = fmax(fmin(I->zu[i], spread * c), c / spread); }
  }
}

/* ---- the barrier parameter ---- */

static void new_barrier(Interior *I, double mu) {
  if (mu != I->mu) I->filter_size = 0;
  I->mu = mu;
}

/* one lower value, or several, where the present barrier problem is solved (WB 7) */
static void lower_barrier(Interior *I) {
  double violation;
  const double least = I->o.tolerance / 11.0;
  while (I->mu > least && optimality_error(I, I->mu, &violation) <= 10.0 * I->mu)
    new_barrier(I, fmax(least, fmin(0.2 * I->mu, pow(I->mu, 1.5))));
}

/* ---- iterations ---- */

static int finished(Interior *I) {
  double violation;
  I->error = optimality_error(I, 0.0, &violation);
  if (I->error <= I->o.tolerance && violation <= I->o.violation) return CONVERGED;
  I->acceptable = I->error <= 100.0 * I->o.tolerance && violation <= I->o.violation ? I->acceptable + 1 : 0;
  if (I->acceptable >= 15) return ACCEPTABLE;
  if (fabs(I->f - I->steady_f) > 1e-6 * fabs(I->first_f)) I->steady_f = I->f, I->unchanged = 0;
  else if (++I->unchanged >= STALLED && violation <= 1e-9) return ACCEPTABLE;
  return I->iteration >= I->o.iterations ? ITERATION_LIMIT : RUNNING;
}

static int iterate(Interior *I) {
  if (!evaluate_curvature(I)) return NOT_A_NUMBER;
  set_sigma(I);
  if (!factor(I)) return SINGULAR;
  for (long r = 0; r < I->m; ++r) I->rc[r] = I->g[r] - I->w[I->n + r];
  lower_barrier(I);
  direction(I, I->mu, I->rc, I->dw, I->dy);
  dual_direction(I, I->mu, I->dw);
  const double tau = fmax(0.99, 1.0 - I->mu);
  double size = 0.0;
  for (long i = 0; i < I->N; ++i) size = fmax(size, fabs(I->dw[i]) / (1.0 + fabs(I->w[i])));
  I->tiny = size < 10.0 * 2.2e-16 ? I->tiny + 1 : 0;
  if (!isfinite(size)) return SINGULAR;
  if (I->tiny > 1) return NO_STEP;
  if (!search(I, tau)) return NO_STEP;
  take_dual_step(I, tau);
  if (!evaluate_slopes(I)) return NOT_A_NUMBER;
  ++I->iteration;
  return finished(I);
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* Go on for some iterations, or until some time has passed (which changes nothing but where it pauses); returns the status. */
long eo_interior_run(Interior *I, long iterations, double seconds) {
  if (!I) return NO_MEMORY;
  const double end = now() + seconds;
  for (long k = 0; k < iterations && I->status == RUNNING && (!k || now() < end); ++k) I->status = iterate(I);
  return I->status;
}

/* ---- the start ---- */

/* move inside the bounds (WB, section 3.6) */
static double inside(double value, double low, double high, double push) {
  const double width = high - low;
  const double from_low = isfinite(low) ? fmin(push * fmax(1.0, fabs(low)), isfinite(width) ? push * width : INFINITY) : 0.0;
  const double from_high = isfinite(high) ? fmin(push * fmax(1.0, fabs(high)), isfinite(width) ? push * width : INFINITY) : 0.0;
  return fmin(fmax(value, low + from_low), high - from_high);
}

static void find_rows(Interior *I) {
  const long n = I->n, m = I->m;
  for (long r = 0; r <= m; ++r) I->row_start[r] = 0;
  for (int e = 0; e < I->p.jac_start[n]; ++e) ++I->row_start[I->p.jac_row[e] + 1];
  for (long r = 0; r < m; ++r) I->row_start[r + 1] += I->row_start[r];
  for (long j = 0; j < n; ++j)
    for (int e = I->p.jac_start[j]; e < I->p.jac_start[j + 1]; ++e) {
      const long at = I->row_start[I->p.jac_row[e]]++;
      I->row_entry[at] = e, I->row_column[at] = (int)j;
    }
  for (long r = m; r > 0; --r) I->row_start[r] = I->row_start[r - 1];
  I->row_start[0] = 0;
}

static void set_scales(Interior *I) {
  double most = 0.0;
  for (long i = 0; i < I->n; ++i) most = fmax(most, fabs(I->df[i]));
  I->scale *= fmin(1.0, 100.0 / fmax(most, 1e-300));
  for (long r = 0; r < I->m; ++r) {
    double largest = 0.0;
    for (long e = I->row_start[r]; e < I->row_start[r + 1]; ++e) largest = fmax(largest, fabs(I->J[I->row_entry[e]]));
    I->row_scale[r] = fmin(1.0, 100.0 / fmax(largest, 1e-300));
  }
}

static int start(Interior *I, const double *x0) {
  const long n = I->n, m = I->m;
  for (long i = 0; i < n; ++i) I->w[i] = inside(x0[i], I->L[i], I->U[i], I->o.push);
  if (!evaluate_point(I, I->w, &I->f, I->g) || !evaluate_slopes(I)) return NOT_A_NUMBER;
  set_scales(I);
  for (long r = 0; r < m; ++r) I->L[n + r] *= I->row_scale[r], I->U[n + r] *= I->row_scale[r];
  if (!evaluate_point(I, I->w, &I->f, I->g) || !evaluate_slopes(I)) return NOT_A_NUMBER;
  for (long r = 0; r < m; ++r) {
    if (I->equality[r] >= 0) I->w[n + r] = I->L[n + r], I->L[n + r] = -INFINITY, I->U[n + r] = INFINITY;
    else I->w[n + r] = inside(I->g[r], I->L[n + r], I->U[n + r], I->o.push);
  }
  for (long i = 0; i < I->N; ++i) {
    I->zl[i] = isfinite(I->L[i]) ? fmin(1.0, I->mu / (I->w[i] - I->L[i])) : 0.0;
    I->zu[i] = isfinite(I->U[i]) ? fmin(1.0, I->mu / (I->U[i] - I->w[i])) : 0.0;
  }
  const double theta = infeasibility(I, I->w, I->g);
  I->theta_least = 1e-4 * fmax(1.0, theta), I->theta_most = 1e4 * fmax(1.0, theta);
  I->first_f = I->steady_f = I->f;
  return finished(I);
}

void eo_interior_free(Interior *I) {
  if (!I) return;
  skyline_free(&I->k), free(I->base), free(I->memory), free(I);
}

static double *carve(double **at, long size) {
  double *here = *at;
  *at += size;
  return here;
}

Interior *eo_interior_new(const Program *p, const Options *o, const double *x0) {
  const long n = p->n, m = p->m, N = n + m, nj = p->jac_start[n], nh = p->hess_start[n];
  Interior *I = calloc(1, sizeof *I);
  if (!I) return 0;
  I->p = *p, I->o = *o, I->n = n, I->m = m, I->N = N, I->mu = o->barrier, I->scale = o->scale;
  const long reals = 20 * N + 12 * m + 2 * n + nj + nh + 16, integers = 2 * m + 2 + nj;
  I->memory = calloc(1, reals * sizeof(double) + integers * sizeof(long) + nj * sizeof(int));
  if (!I->memory) { free(I); return 0; }
  double *at = I->memory;
  double **of_N[] = {&I->L, &I->U, &I->w, &I->zl, &I->zu, &I->dw, &I->dzl, &I->dzu, &I->trial,
                     &I->rw, &I->e_w, &I->e_dw, &I->sigma, &I->soc, &I->sol};
  double **of_m[] = {&I->y, &I->g, &I->dy, &I->trial_g, &I->lambda, &I->rc, &I->rs_y, &I->rs_w, &I->e_c, &I->e_dy, &I->row_scale};
  for (unsigned k = 0; k < sizeof of_N / sizeof *of_N; ++k) *of_N[k] = carve(&at, N);
  for (unsigned k = 0; k < sizeof of_m / sizeof *of_m; ++k) *of_m[k] = carve(&at, m);
  I->df = carve(&at, n), I->J = carve(&at, nj), I->H = carve(&at, nh);
  I->equality = (long *)(I->memory) + reals;
  I->row_start = I->equality + m, I->row_entry = I->row_start + m + 1, I->row_column = (int *)(I->row_entry + nj);
  memcpy(I->L, p->lower, n * sizeof(double)), memcpy(I->U, p->upper, n * sizeof(double));
  for (long r = 0; r < m; ++r) {
    I->L[n + r] = p->row_lower[r], I->U[n + r] = p->row_upper[r], I->row_scale[r] = 1.0;
    I->equality[r] = p->row_lower[r] == p->row_upper[r] ? I->equalities++ : -1;
  }
  find_rows(I);
  if (!find_skyline(I) || !(I->base = malloc((I->k.profile + I->k.n + 1) * sizeof(double)))) { eo_interior_free(I); return 0; }
  if (I->status == RUNNING) I->status = start(I, x0);
  return I;
}

enum { OBJECTIVE, ERROR, VIOLATION, BARRIER, STEP, SHIFT, ITERATIONS, STATES, GRADIENTS, JACOBIANS, HESSIANS };

/* the present point, the multipliers of the rows, and numbers as above */
void eo_interior_read(Interior *I, double *x, double *y, double *numbers) {
  if (!I) return;
  memcpy(x, I->w, I->n * sizeof(double));
  for (long r = 0; r < I->m; ++r) y[r] = I->y[r] * I->row_scale[r] / I->scale;
  double worst = 0.0, miss;
  for (long r = 0; r < I->m; ++r)
    worst = fmax(worst, fmax(I->p.row_lower[r] - I->g[r] / I->row_scale[r], I->g[r] / I->row_scale[r] - I->p.row_upper[r]));
  numbers[VIOLATION] = worst, numbers[ERROR] = optimality_error(I, 0.0, &miss);
  numbers[OBJECTIVE] = I->f / I->scale, numbers[BARRIER] = I->mu, numbers[STEP] = I->alpha, numbers[SHIFT] = I->delta;
  numbers[ITERATIONS] = I->iteration, numbers[STATES] = I->states;
  numbers[GRADIENTS] = numbers[JACOBIANS] = I->gradients, numbers[HESSIANS] = I->hessians;
}
