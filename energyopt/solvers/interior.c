/* The iterations of the interior-point method, its start and its interface; see `interior_system.c` for the mathematics. */

#include <time.h>

/* ---- the barrier parameter ---- */

static void new_barrier(Interior *I, double mu) {
  if (mu != I->mu) I->filter_size = 0;
  I->mu = mu;
}

static double least_barrier(const Interior *I) { return I->o.tolerance / 11.0; }

/* one lower value, or several, where the present barrier problem is solved (WB 7) */
static void lower_barrier(Interior *I) {
  double violation;
  const double least = least_barrier(I);
  while (I->mu > least && optimality_error(I, I->mu, &violation) <= 10.0 * I->mu)
    new_barrier(I, fmax(least, fmin(0.2 * I->mu, pow(I->mu, 1.5))));
}

/* ---- predictor and corrector ---- */

#define LESS 0.9       /* of the optimality error, for a step to be kept */
#define SHORTEST 0.1   /* step that is kept */
#define CENTRED 0.3    /* barrier parameter over mean complementarity after a step that was not kept */

static double complementarity(const Interior *I, double a, double b) { /* the mean after steps a and b */
  double sum = 0.0;
  long count = 0;
  for (long i = 0; i < I->N; ++i) {
    if (isfinite(I->L[i])) sum += (I->w[i] + a * I->dw[i] - I->L[i]) * (I->zl[i] + b * I->dzl[i]), ++count;
    if (isfinite(I->U[i])) sum += (I->U[i] - I->w[i] - a * I->dw[i]) * (I->zu[i] + b * I->dzu[i]), ++count;
  }
  return count ? sum / count : 0.0;
}

/* Targets foreseen by the step with targets zero, less what its own curvature adds to the products (S. Mehrotra, "On the
   implementation of a primal-dual interior point method", SIAM J. Optimization 2, 1992). Returns the barrier parameter. */
static double foresee(Interior *I, double least) {
  set_targets(I, 0.0);
  direction(I, I->rc, I->dw, I->dy);
  dual_direction(I, I->dw);
  const double now = complementarity(I, 0.0, 0.0);
  const double ratio = now > 0.0 ? complementarity(I, to_boundary(I, I->dw, 1.0), dual_to_boundary(I, 1.0)) / now : 0.0;
  const double mu = fmax(least, fmin(1.0, ratio * ratio * ratio) * now);
  for (long i = 0; i < I->N; ++i)
    I->target_l[i] = mu - I->dw[i] * I->dzl[i], I->target_u[i] = mu + I->dw[i] * I->dzu[i];
  return mu;
}

static void copy_point(Interior *I, int back) {
  struct { double *what; long count; } parts[] = {{I->w, I->N}, {I->zl, I->N}, {I->zu, I->N}, {I->y, I->m}, {I->g, I->m},
                                                  {I->df, I->n}, {I->J, I->p.jac_start[I->n]}, {&I->f, 1}, {&I->mu, 1}};
  double *kept = I->kept;
  for (unsigned k = 0; k < sizeof parts / sizeof *parts; kept += parts[k++].count)
    memcpy(back ? parts[k].what : kept, back ? kept : parts[k].what, parts[k].count * sizeof(double));
}

/* Whether such a step lowered the optimality error enough to be kept; else nothing but the barrier parameter is changed. */
static int foreseen_step(Interior *I, double least) {
  double violation;
  copy_point(I, 0);
  const double before = complementarity(I, 0.0, 0.0);
  I->mu = foresee(I, least);
  direction(I, I->rc, I->dw, I->dy);
  dual_direction(I, I->dw);
  const double tau = fmax(0.99, 1.0 - I->mu);
  I->alpha = to_boundary(I, I->dw, tau);
  for (long i = 0; i < I->N; ++i) I->w[i] += I->alpha * I->dw[i];
  take_dual_step(I, tau);
  const int there = fmin(I->alpha, I->alpha_dual) >= SHORTEST && evaluate_point(I, I->w, &I->f, I->g) && evaluate_slopes(I);
  I->filter_size = 0;
  if (there && optimality_error(I, 0.0, &violation) <= LESS * I->error) return 1;
  copy_point(I, 1);
  new_barrier(I, fmax(least, CENTRED * before));
  return 0;
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

/* a step by the line search */
static int searched_step(Interior *I) {
  double size = 0.0;
  lower_barrier(I);
  set_targets(I, I->mu);
  direction(I, I->rc, I->dw, I->dy);
  dual_direction(I, I->dw);
  for (long i = 0; i < I->N; ++i) size = fmax(size, fabs(I->dw[i]) / (1.0 + fabs(I->w[i])));
  if (!isfinite(size)) return SINGULAR;
  I->tiny = size < 10.0 * DBL_EPSILON ? I->tiny + 1 : 0;
  const double tau = fmax(0.99, 1.0 - I->mu);
  if (I->tiny > 1 || !search(I, tau)) return NO_STEP;
  take_dual_step(I, tau);
  return evaluate_slopes(I) ? RUNNING : NOT_A_NUMBER;
}

static int iterate(Interior *I) {
  if (!evaluate_curvature(I)) return NOT_A_NUMBER;
  if (!factor(I)) return SINGULAR;
  for (long r = 0; r < I->m; ++r) I->rc[r] = I->g[r] - I->w[I->n + r];
  const int near = I->delta == 0.0 && I->mu < I->first_mu;
  if (!near || !foreseen_step(I, least_barrier(I))) {
    const int status = searched_step(I);
    if (status != RUNNING) return status;
  }
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

#define BESIDE 0.1 /* share of an interval within which a limit has to be for its given multiplier to count */
#define ROOM 1e-2

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

/* Multipliers given by the caller for some of w: gaps at which their products with them are the barrier parameter, but no wider
   than they are, or some share of the interval. */
static void take_guess(Interior *I, long from, long to, const double *guess, double share) {
  for (long i = from; i < to; ++i) {
    const double z = I->scale * (i < I->n ? guess[i] : guess[i - I->n] / I->row_scale[i - I->n]);
    const double width = isfinite(I->U[i] - I->L[i]) ? I->U[i] - I->L[i] : 1.0;
    const double gap = z > 0.0 ? I->U[i] - I->w[i] : I->w[i] - I->L[i];
    const double wanted = fmin(I->mu / fabs(z), fmax(gap, share * width));
    if (z == 0.0 || !(gap <= BESIDE * width)) continue;
    I->w[i] = z > 0.0 ? I->U[i] - wanted : I->L[i] + wanted;
  }
}

static int start(Interior *I, const double *x0) {
  const long n = I->n, m = I->m;
  for (long i = 0; i < n; ++i) I->w[i] = inside(x0[i], I->L[i], I->U[i], I->o.push);
  if (!evaluate_point(I, I->w, &I->f, I->g) || !evaluate_slopes(I)) return NOT_A_NUMBER;
  set_scales(I);
  for (long r = 0; r < m; ++r) I->L[n + r] *= I->row_scale[r], I->U[n + r] *= I->row_scale[r];
  if (I->o.row_guess) take_guess(I, 0, n, I->o.bound_guess, 0.0);
  if (!evaluate_point(I, I->w, &I->f, I->g) || !evaluate_slopes(I)) return NOT_A_NUMBER;
  for (long r = 0; r < m; ++r) {
    if (I->equality[r] >= 0) I->w[n + r] = I->L[n + r], I->L[n + r] = -INFINITY, I->U[n + r] = INFINITY;
    else I->w[n + r] = inside(I->g[r], I->L[n + r], I->U[n + r], I->o.push);
  }
  const double most = I->o.row_guess ? INFINITY : 1.0;
  if (I->o.row_guess) take_guess(I, n, I->N, I->o.row_guess, ROOM);
  for (long i = 0; i < I->N; ++i) {
    I->zl[i] = isfinite(I->L[i]) ? fmin(most, I->mu / (I->w[i] - I->L[i])) : 0.0;
    I->zu[i] = isfinite(I->U[i]) ? fmin(most, I->mu / (I->U[i] - I->w[i])) : 0.0;
  }
  for (long r = 0; r < m && I->o.row_guess; ++r)
    I->y[r] = I->equality[r] >= 0 ? I->scale * I->o.row_guess[r] / I->row_scale[r] : I->zu[n + r] - I->zl[n + r];
  const double theta = infeasibility(I, I->w, I->g);
  I->theta_least = 1e-4 * fmax(1.0, theta), I->theta_most = 1e4 * fmax(1.0, theta);
  I->first_f = I->steady_f = I->f;
  return finished(I);
}

void eo_interior_free(Interior *I) {
  if (!I) return;
  skyline_free(&I->k), free(I->memory), free(I);
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
  I->p = *p, I->o = *o, I->n = n, I->m = m, I->N = N, I->scale = o->scale;
  I->mu = o->barrier, I->first_mu = o->warm ? INFINITY : o->barrier;
  const long reals = (19 + 3) * N + (11 + 2) * m + 2 * n + 2 * nj + nh + 2, integers = 2 * m + 2 + nj;
  I->memory = calloc(1, reals * sizeof(double) + integers * sizeof(long) + nj * sizeof(int));
  if (!I->memory) { free(I); return 0; }
  double *at = I->memory;
  double **of_N[] = {&I->L, &I->U, &I->w, &I->zl, &I->zu, &I->dw, &I->dzl, &I->dzu, &I->trial,
                     &I->rw, &I->e_w, &I->e_dw, &I->sigma, &I->soc, &I->sol, &I->bare, &I->metric, &I->target_l, &I->target_u};
  double **of_m[] = {&I->y, &I->g, &I->dy, &I->trial_g, &I->lambda, &I->rc, &I->rs_y, &I->rs_w, &I->e_c, &I->e_dy, &I->row_scale};
  for (unsigned k = 0; k < sizeof of_N / sizeof *of_N; ++k) *of_N[k] = carve(&at, N);
  for (unsigned k = 0; k < sizeof of_m / sizeof *of_m; ++k) *of_m[k] = carve(&at, m);
  I->df = carve(&at, n), I->J = carve(&at, nj), I->H = carve(&at, nh);
  I->kept = carve(&at, 3 * N + 2 * m + n + nj + 2);
  I->equality = (long *)(I->memory) + reals;
  I->row_start = I->equality + m, I->row_entry = I->row_start + m + 1, I->row_column = (int *)(I->row_entry + nj);
  memcpy(I->L, p->lower, n * sizeof(double)), memcpy(I->U, p->upper, n * sizeof(double));
  for (long r = 0; r < m; ++r) {
    I->L[n + r] = p->row_lower[r], I->U[n + r] = p->row_upper[r], I->row_scale[r] = 1.0;
    I->equality[r] = p->row_lower[r] == p->row_upper[r] ? I->equalities++ : -1;
  }
  find_rows(I);
  if (!find_skyline(I)) { eo_interior_free(I); return 0; }
  if (I->status == RUNNING) I->status = start(I, x0);
  return I;
}

enum { OBJECTIVE, ERROR, VIOLATION, BARRIER, STEP, SHIFT, ITERATIONS, STATES, GRADIENTS, JACOBIANS, HESSIANS };

/* the present point, the multipliers of the rows and of the bounds, and numbers as above */
void eo_interior_read(Interior *I, double *x, double *y, double *z, double *numbers) {
  if (!I) return;
  memcpy(x, I->w, I->n * sizeof(double));
  for (long i = 0; i < I->n; ++i) z[i] = (I->zu[i] - I->zl[i]) / I->scale;
  for (long r = 0; r < I->m; ++r) y[r] = I->y[r] * I->row_scale[r] / I->scale;
  numbers[ERROR] = optimality_error(I, 0.0, &numbers[VIOLATION]);
  numbers[OBJECTIVE] = I->f / I->scale, numbers[BARRIER] = I->mu, numbers[STEP] = I->alpha, numbers[SHIFT] = I->delta;
  numbers[ITERATIONS] = I->iteration, numbers[STATES] = I->states;
  numbers[GRADIENTS] = numbers[JACOBIANS] = I->gradients, numbers[HESSIANS] = I->hessians;
}
