/* The program of samples.c with its duration as a last unknown, T = T0 exp(theta), for motions between rests.

   Derivatives of order o of the motion, and rows of them, are exp(-o theta) of what the program says, its quadrature weights
   exp(theta), torque rates exp(-theta): its arrays are rewritten. See transcription/stretch.py for the formulas. */

typedef struct {
  Program *program;
  const double *basis, *weight, *row_value, *row_offset, *entry_scale; /* those of theta = 0 */
  double *now_basis, *now_weight, *now_row_value, *now_row_offset, *now_entry_scale, *now_jac_constant; /* the program's own */
  const int *row_order, *entry_rate, *jac_linear;
  double *scratch, *lagged; /* work: unknowns; samples x NZ */
} Stretched;

static long unknowns(const Program *P) { return P->blocks * NV; }

void eo_stretched_state(Stretched *S, const double *x) {
  Program *P = S->program;
  const double theta = x[unknowns(P)];
  double power[4];
  for (long o = 0; o < 4; ++o) power[o] = exp(-o * theta);
  for (long k = 0; k < P->samples; ++k) {
    S->now_weight[k] = S->weight[k] / power[1];
    for (long o = 0; o < 3; ++o)
      for (long l = 0; l < P->local; ++l) {
        const long m = (k * 3 + o) * P->local + l;
        S->now_basis[m] = S->basis[m] * power[o];
      }
  }
  for (long r = 0; r < P->linear_rows; ++r) {
    S->now_row_offset[r] = S->row_offset[r] * power[S->row_order[r]];
    for (int e = P->row_start[r]; e < P->row_start[r + 1]; ++e) {
      S->now_row_value[e] = S->row_value[e] * power[S->row_order[r]];
      S->now_jac_constant[S->jac_linear[e]] = S->now_row_value[e];
    }
  }
  for (long e = 0; e < P->entries; ++e) S->now_entry_scale[e] = S->entry_scale[e] * (S->entry_rate[e] ? power[1] : 1.0);
  eo_program_state(P, x);
}

double eo_stretched_objective(const Stretched *S) { return eo_program_objective(S->program); }

void eo_stretched_constraints(const Stretched *S, const double *x, double *g) { eo_program_constraints(S->program, x, g); }

/* dz/dtheta of one sample, times factor: order o of the state by -o */
static double along(const double *g, const double *z) {
  double sum = 0.0;
  for (long i = 0; i < NV; ++i) sum -= g[NV + i] * z[NV + i] + 2.0 * g[2 * NV + i] * z[2 * NV + i];
  return sum;
}

void eo_stretched_gradient(const Stretched *S, double *gradient) {
  const Program *P = S->program;
  eo_program_gradient(P, gradient);
  double slope = eo_program_objective(P);
  for (long k = 0; k < P->samples; ++k) slope += along(P->gradient + k * NZ, P->state + k * NZ);
  gradient[unknowns(P)] = slope;
}

static double linear_row(const Program *P, const double *x, long r) {
  double sum = P->row_offset[r];
  for (int e = P->row_start[r]; e < P->row_start[r + 1]; ++e) sum += P->row_value[e] * x[P->row_column[e]];
  return sum;
}

/* the unknowns at which the program was evaluated last, from its coefficients */
static void read_unknowns(const Program *P, double *x) {
  for (long j = 0; j < P->coefficients; ++j)
    for (long i = 0; i < NV && P->block[j] >= 0; ++i) x[P->block[j] * NV + i] = P->coefficient[j * NV + i] - P->offset[j * NV + i];
}

void eo_stretched_jacobian(const Stretched *S, double *values) {
  const Program *P = S->program;
  double *column = values + P->jac_nonzeros;
  eo_program_jacobian(P, values);
  read_unknowns(P, S->scratch);
  for (long r = 0; r < P->linear_rows; ++r) column[r] = -S->row_order[r] * linear_row(P, S->scratch, r);
  for (long r = 0; r < P->torque_rows; ++r) column[P->linear_rows + r] = 0.0;
  for (long e = 0; e < P->entries; ++e) {
    const double *Jt = P->jacobian + P->entry_demand[e] * NV * NZ + P->entry_joint[e];
    const double *z = P->state + P->entry_sample[e] * NZ;
    double rise = S->entry_rate[e] ? -P->torque[P->entry_sample[e] * NV + P->entry_joint[e]] : 0.0;
    for (long i = 0; i < NV; ++i) rise -= Jt[(NV + i) * NV] * z[NV + i] + 2.0 * Jt[(2 * NV + i) * NV] * z[2 * NV + i];
    column[P->entry_row[e]] += P->entry_scale[e] * rise;
  }
}

/* The border: lagged becomes what every sample gives to d2L/dtheta dx before it is gathered; returns d2L/dtheta2. */
static double samples_border(const Stretched *S, double sigma, const double *lambda) {
  const Program *P = S->program;
  double bend = sigma * eo_program_objective(P);
  for (long k = 0; k < P->samples; ++k)
    for (long o = 0; o < 3; ++o)
      for (long m = o * NV; m < (o + 1) * NV; ++m) {
        const double g = sigma * P->gradient[k * NZ + m], z = P->state[k * NZ + m], turned = P->turned[k * NZ + m];
        S->lagged[k * NZ + m] = turned + (1.0 - o) * g;
        bend += -o * z * turned + o * o * z * g - 2.0 * o * z * g;
      }
  if (P->entries) demanded_jacobians(P);
  for (long e = 0; e < P->entries; ++e) {
    const double *Jt = P->jacobian + P->entry_demand[e] * NV * NZ + P->entry_joint[e];
    const double factor = P->entry_scale[e] * lambda[P->entry_row[e]], rate = S->entry_rate[e];
    const double *z = P->state + P->entry_sample[e] * NZ;
    double *lagged = S->lagged + P->entry_sample[e] * NZ;
    bend += rate * factor * P->torque[P->entry_sample[e] * NV + P->entry_joint[e]];
    for (long o = 0; o < 3; ++o)
      for (long m = o * NV; m < (o + 1) * NV; ++m) {
        const double g = factor * Jt[m * NV];
        lagged[m] -= (o + rate) * g;
        bend += o * o * z[m] * g + 2.0 * rate * o * z[m] * g;
      }
  }
  return bend;
}

void eo_stretched_hessian(const Stretched *S, double sigma, const double *lambda, double *values) {
  Program *P = S->program;
  const long n = unknowns(P);
  double *border = values + P->hess_nonzeros, *speed = S->lagged;
  for (long k = 0; k < P->samples; ++k)
    for (long m = 0; m < NZ; ++m) speed[k * NZ + m] = -(double)(m / NV) * P->state[k * NZ + m];
  eo_program_gradient(P, S->scratch);
  P->direction = speed;
  eo_program_hessian(P, sigma, lambda, values);
  P->direction = 0;
  for (long i = 0; i <= n; ++i) border[i] = 0.0;
  double bend = samples_border(S, sigma, lambda);
  for (long k = 0; k < P->samples; ++k)
    for (long l = 0; l < P->local; ++l) {
      const int b = P->block[P->column[k * P->local + l]];
      for (long o = 0; o < 3 && b >= 0; ++o) {
        const double value = P->basis[(k * 3 + o) * P->local + l];
        for (long i = 0; i < NV; ++i) border[b * NV + i] += value * S->lagged[k * NZ + o * NV + i];
      }
    }
  read_unknowns(P, S->scratch);
  for (long r = 0; r < P->linear_rows; ++r) {
    const double order = S->row_order[r];
    if (order == 0.0) continue;
    for (int e = P->row_start[r]; e < P->row_start[r + 1]; ++e) border[P->row_column[e]] -= order * lambda[r] * P->row_value[e];
    bend += order * order * lambda[r] * linear_row(P, S->scratch, r);
  }
  border[n] = bend;
}
