/* Measures of a point and steps from it, for `interior.c`. */

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

/* of the barrier function */
static void barrier_gradient(const Interior *I, double mu, double *out) {
  for (long i = 0; i < I->N; ++i) {
    double sum = i < I->n ? I->df[i] : 0.0;
    if (isfinite(I->L[i])) sum -= mu / (I->w[i] - I->L[i]);
    if (isfinite(I->U[i])) sum += mu / (I->U[i] - I->w[i]);
    out[i] = sum;
  }
}

/* by how much a row breaks its limits, in the program's own unit */
static double broken(const Interior *I, long r) {
  return fmax(I->p.row_lower[r] - I->g[r] / I->row_scale[r], I->g[r] / I->row_scale[r] - I->p.row_upper[r]);
}

/* The scaled optimality error (WB 5); mu = 0 for the program itself. The violation is that of the rows' limits: by how much rows
   miss their slacks is rounding in the end, of large terms where spans are short, and part of the error. */
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
    primal = fmax(primal, fabs(I->g[r] - I->w[I->n + r])), *violation = fmax(*violation, broken(I, r)), sum_y += fabs(I->y[r]);
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

static void set_targets(Interior *I, double mu) {
  for (long i = 0; i < I->N; ++i) I->target_l[i] = I->target_u[i] = mu;
}

/* dw and dy for which the products of gaps and multipliers become the targets, and the residuals rc of the rows vanish */
static void direction(Interior *I, const double *rc, double *dw, double *dy) {
  for (long i = 0; i < I->N; ++i) {
    I->rw[i] = i < I->n ? I->df[i] : -I->y[i - I->n];
    if (isfinite(I->L[i])) I->rw[i] -= I->target_l[i] / (I->w[i] - I->L[i]);
    if (isfinite(I->U[i])) I->rw[i] += I->target_u[i] / (I->U[i] - I->w[i]);
  }
  add_transposed(I, I->y, I->rw);
  solve_system(I, I->rw, rc, dw, dy);
}

static void dual_direction(Interior *I, const double *dw) {
  for (long i = 0; i < I->N; ++i) {
    I->dzl[i] = I->dzu[i] = 0.0;
    if (isfinite(I->L[i])) I->dzl[i] = (I->target_l[i] - I->zl[i] * dw[i]) / (I->w[i] - I->L[i]) - I->zl[i];
    if (isfinite(I->U[i])) I->dzu[i] = (I->target_u[i] + I->zu[i] * dw[i]) / (I->U[i] - I->w[i]) - I->zu[i];
  }
}

/* ---- filter line search (WB, section 2.3) ---- */

static const double eta = 1e-8, margin_theta = 1e-5, margin_phi = 1e-8, s_phi = 2.3, s_theta = 1.1;

static int not_above(double a, double b, double size) { return a - b <= 10.0 * DBL_EPSILON * fabs(size); }

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
    direction(I, rc, dw, I->rs_w);
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
    if (!verdict && first && new_theta >= theta && new_theta > I->o.violation) verdict = correct(I, alpha, tau, slope, theta, phi, &f);
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
