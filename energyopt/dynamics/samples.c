/* Everything the solver asks for, assembled from the sample kernels above; theta holds the numbers of the arm.

   A motion is z_k = (q, v, a)(t_k) = sum_l basis[k][order][l] c[column[k][l]], the coefficients being
   c_j = offset_j + x[block_j] (block -1: no unknown). Each call takes all samples, LANES at a time.
   Matrices are row-major unless said otherwise; NV joints, NZ = 3 NV. */

#define NZ (3 * NV)

typedef struct {
  long samples, local, coefficients, blocks, linear_rows, torque_rows, entries, demanded, jac_nonzeros, hess_nonzeros;
  const double *basis;         /* samples x 3 x local */
  const int *column;           /* samples x local */
  const int *block;            /* coefficients */
  const double *offset;        /* coefficients x NV */
  const double *weight;        /* samples: quadrature weights */
  const double *torque_weight; /* NV */
  const double *state_weight;  /* NZ: weights of q^2, v^2, a^2 */
  const int *row_start, *row_column;  /* linear rows in x, compressed by row */
  const double *row_value, *row_offset;
  const int *entry_row, *entry_sample, *entry_joint; /* torque rows: sum of scale * tau[sample][joint] */
  const double *entry_scale;
  const int *demand;           /* samples whose torque Jacobian the rows need */
  const int *entry_demand;     /* index of the entry's sample in demand */
  const int *entry_target;     /* entries x local x NV: place in the Jacobian's values, -1 none */
  const double *jac_constant;
  const int *hess_column;      /* blocks * NV: start of each column of the Hessian (upper triangle) */
  const int *hess_place;       /* blocks x blocks: rows of block A before it in the columns of block B, -1 none */
  double *coefficient, *state, *torque; /* work: coefficients x NV, samples x NZ, samples x NV */
  double *multiplier, *power, *jacobian; /* work: samples x NV, samples x NV, max(demanded, LANES) x NV x NZ */
  double *gradient;                      /* work: samples x NZ */
  /* Another cost than squares, sum of phi(v, a, tau); null: squares. All are derivatives of its weighted share at each sample: */
  const double *cost_first;    /* samples x 3 NV: in tau, v, a */
  const double *cost_second;   /* samples x 4 NV: in tau tau, tau v, v v, a a; joints do not mix, ... */
  const double *cost_mixed;    /* samples x (1 + 2 NV): ... but for kappa (alpha, beta)(alpha, beta)' in (tau, v); may be null */
  /* A direction of each sample's state, and where the Hessian of its share in the Lagrangian times it goes; may be null. */
  const double *direction;     /* samples x NZ */
  double *turned;              /* samples x NZ */
  const double *theta;         /* numbers of the arm */
} Program;

static void pack(const double *from, long size, long first, long count, V *to) {
  for (long l = 0; l < LANES; ++l) {
    const double *row = from + (first + (l < count ? l : 0)) * size;
    for (long m = 0; m < size; ++m) to[m][l] = row[m];
  }
}

static void unpack(const V *from, long size, long first, long count, double *to) {
  for (long l = 0; l < count; ++l)
    for (long m = 0; m < size; ++m) to[(first + l) * size + m] = from[m][l];
}

#define FOR_LANES(k, n, N) for (long k = 0, n; k < (N) && (n = (N) - k < LANES ? (N) - k : LANES, 1); k += LANES)

void eo_torque(const double *theta, long N, const double *z, double *tau) {
  V zz[NZ], t[NV];
  FOR_LANES(k, n, N) {
    pack(z, NZ, k, n, zz);
    kernel_torque(zz, theta, t);
    unpack(t, NV, k, n, tau);
  }
}

void eo_adjoint(const double *theta, long N, const double *z, const double *p, const double *mu, double *tau, double *g) {
  V zz[NZ], pp[NV], mm[NV], t[NV], gg[NZ];
  FOR_LANES(k, n, N) {
    pack(z, NZ, k, n, zz);
    pack(p, NV, k, n, pp);
    pack(mu, NV, k, n, mm);
    kernel_adjoint(zz, pp, mm, theta, t, gg);
    unpack(t, NV, k, n, tau);
    unpack(gg, NZ, k, n, g);
  }
}

/* J is written transposed: samples x NZ x NV */
void eo_jacobian(const double *theta, long N, const double *z, double *tau, double *Jt) {
  V zz[NZ], t[NV], jj[NV * NZ];
  FOR_LANES(k, n, N) {
    pack(z, NZ, k, n, zz);
    kernel_jacobian(zz, theta, t, jj);
    unpack(t, NV, k, n, tau);
    unpack(jj, NV * NZ, k, n, Jt);
  }
}

/* one group of lanes: the full symmetric S + J' diag(p) J, and J transposed */
static void hessian_group(
    const double *theta, long k, long n, const double *z, const double *p, const double *mu, V *H, V *jj) {
  V zz[NZ], pp[NV], mm[NV], ss[LOWER];
  pack(z, NZ, k, n, zz);
  pack(p, NV, k, n, pp);
  pack(mu, NV, k, n, mm);
  kernel_hessian(zz, pp, mm, theta, jj, ss);
  for (long b = 0; b < NZ; ++b) {
    V scaled[NV];
    for (long i = 0; i < NV; ++i) scaled[i] = pp[i] * jj[b * NV + i];
    for (long a = b; a < NZ; ++a) {
      V sum = scaled[0] * jj[a * NV];
      for (long i = 1; i < NV; ++i) sum += scaled[i] * jj[a * NV + i];
      H[a * NZ + b] = sum;
    }
  }
  for (long e = 0; e < LOWER; ++e) H[lower_row[e] * NZ + lower_column[e]] += ss[e];
  for (long a = 0; a < NZ; ++a)
    for (long b = 0; b < a; ++b) H[b * NZ + a] = H[a * NZ + b];
}

void eo_hessian(const double *theta, long N, const double *z, const double *p, const double *mu, double *H) {
  V hh[NZ * NZ], jj[NV * NZ];
  FOR_LANES(k, n, N) {
    hessian_group(theta, k, n, z, p, mu, hh, jj);
    unpack(hh, NZ * NZ, k, n, H);
  }
}

/* ---- the nonlinear program ---- */

void eo_program_state(Program *P, const double *x) {
  for (long j = 0; j < P->coefficients; ++j)
    for (long i = 0; i < NV; ++i)
      P->coefficient[j * NV + i] = P->offset[j * NV + i] + (P->block[j] < 0 ? 0.0 : x[P->block[j] * NV + i]);
  for (long k = 0; k < P->samples; ++k) {
    double *z = P->state + k * NZ;
    for (long m = 0; m < NZ; ++m) z[m] = 0.0;
    for (long l = 0; l < P->local; ++l) {
      const double *c = P->coefficient + P->column[k * P->local + l] * NV;
      for (long o = 0; o < 3; ++o) {
        const double b = P->basis[(k * 3 + o) * P->local + l];
        for (long i = 0; i < NV; ++i) z[o * NV + i] += b * c[i];
      }
    }
  }
  eo_torque(P->theta, P->samples, P->state, P->torque);
}

double eo_program_objective(const Program *P) {
  double total = 0.0;
  for (long k = 0; k < P->samples; ++k) {
    const double *z = P->state + k * NZ, *tau = P->torque + k * NV;
    double sum = 0.0;
    for (long i = 0; i < NV; ++i) sum += P->torque_weight[i] * tau[i] * tau[i];
    for (long m = 0; m < NZ; ++m) sum += P->state_weight[m] * z[m] * z[m];
    total += P->weight[k] * sum;
  }
  return total;
}

void eo_program_constraints(const Program *P, const double *x, double *g) {
  for (long r = 0; r < P->linear_rows; ++r) {
    double sum = P->row_offset[r];
    for (int e = P->row_start[r]; e < P->row_start[r + 1]; ++e) sum += P->row_value[e] * x[P->row_column[e]];
    g[r] = sum;
  }
  for (long r = 0; r < P->torque_rows; ++r) g[P->linear_rows + r] = 0.0;
  for (long e = 0; e < P->entries; ++e)
    g[P->entry_row[e]] += P->entry_scale[e] * P->torque[P->entry_sample[e] * NV + P->entry_joint[e]];
}

/* p and mu whose u = p tau + mu is what the objective, times sigma, wants of the torque; p has its curvature */
static void set_objective(const Program *P, double sigma, int curved) {
  for (long k = 0; k < P->samples; ++k)
    for (long i = 0; i < NV; ++i) {
      const long m = k * NV + i;
      if (!P->cost_first) {
        P->power[m] = 2.0 * sigma * P->weight[k] * P->torque_weight[i];
        P->multiplier[m] = 0.0;
      } else {
        P->power[m] = curved ? sigma * P->cost_second[k * 4 * NV + i] : 0.0;
        P->multiplier[m] = sigma * P->cost_first[k * 3 * NV + i] - P->power[m] * P->torque[m];
      }
    }
}

static void add_rows(const Program *P, const double *lambda) {
  for (long e = 0; e < P->entries; ++e)
    P->multiplier[P->entry_sample[e] * NV + P->entry_joint[e]] += P->entry_scale[e] * lambda[P->entry_row[e]];
}

void eo_program_gradient(const Program *P, double *gradient) {
  set_objective(P, 1.0, 0);
  eo_adjoint(P->theta, P->samples, P->state, P->power, P->multiplier, P->torque, P->gradient);
  for (long m = 0; m < P->blocks * NV; ++m) gradient[m] = 0.0;
  for (long k = 0; k < P->samples; ++k) {
    double *g = P->gradient + k * NZ;
    if (P->cost_first)
      for (long m = 0; m < 2 * NV; ++m) g[NV + m] += P->cost_first[k * 3 * NV + NV + m];
    else
      for (long m = 0; m < NZ; ++m) g[m] += 2.0 * P->weight[k] * P->state_weight[m] * P->state[k * NZ + m];
    for (long l = 0; l < P->local; ++l) {
      const int b = P->block[P->column[k * P->local + l]];
      if (b < 0) continue;
      for (long o = 0; o < 3; ++o) {
        const double value = P->basis[(k * 3 + o) * P->local + l];
        for (long i = 0; i < NV; ++i) gradient[b * NV + i] += value * g[o * NV + i];
      }
    }
  }
}

/* dtau/dz of the samples that torque rows speak of, transposed */
static void demanded_jacobians(const Program *P) {
  V zz[NZ], t[NV], jj[NV * NZ];
  FOR_LANES(k, n, P->demanded) {
    for (long l = 0; l < LANES; ++l)
      for (long m = 0; m < NZ; ++m) zz[m][l] = P->state[P->demand[k + (l < n ? l : 0)] * NZ + m];
    kernel_jacobian(zz, P->theta, t, jj);
    unpack(jj, NV * NZ, k, n, P->jacobian);
  }
}

void eo_program_jacobian(const Program *P, double *values) {
  for (long e = 0; e < P->jac_nonzeros; ++e) values[e] = P->jac_constant[e];
  demanded_jacobians(P);
  for (long e = 0; e < P->entries; ++e) {
    const double *Jt = P->jacobian + P->entry_demand[e] * NV * NZ + P->entry_joint[e];
    const double *basis = P->basis + P->entry_sample[e] * 3 * P->local;
    const int *target = P->entry_target + e * P->local * NV;
    for (long l = 0; l < P->local; ++l)
      for (long i = 0; i < NV; ++i) {
        if (target[l * NV + i] < 0) continue;
        double sum = 0.0;
        for (long o = 0; o < 3; ++o) sum += basis[o * P->local + l] * Jt[(o * NV + i) * NV];
        values[target[l * NV + i]] += P->entry_scale[e] * sum;
      }
  }
}

/* whether any lane has an entry for the local pair (la, lb) in the upper triangle of blocks */
static int pair_needed(const int *blocks, long n, long local, long la, long lb) {
  for (long l = 0; l < n; ++l) {
    const int A = blocks[l * local + la], B = blocks[l * local + lb];
    if (A >= 0 && A <= B) return 1;
  }
  return 0;
}

static void add_block(const Program *P, int A, int B, long lane, V block[NV][NV], double *values) {
  const int place = P->hess_place[A * P->blocks + B];
  for (long j = 0; j < NV; ++j) {
    double *to = values + P->hess_column[B * NV + j] + place;
    const long rows = A == B ? j + 1 : NV;
    for (long i = 0; i < rows; ++i) to[i] += block[j][i][lane];
  }
}

/* add basis' H basis of one group of samples: the columns of H are first contracted to one local coefficient */
static void add_group_hessian(const Program *P, long k, long n, const V *H, double *values) {
  const long local = P->local;
  int blocks[LANES * local];
  V basis[3 * local], half[NZ][NV], block[NV][NV];
  pack(P->basis, 3 * local, k, n, basis);
  for (long l = 0; l < n; ++l)
    for (long c = 0; c < local; ++c) blocks[l * local + c] = P->block[P->column[(k + l) * local + c]];
  for (long lb = 0; lb < local; ++lb) {
    const V c0 = basis[lb], c1 = basis[local + lb], c2 = basis[2 * local + lb];
    for (long a = 0; a < NZ; ++a)
      for (long j = 0; j < NV; ++j)
        half[a][j] = c0 * H[a * NZ + j] + c1 * H[a * NZ + NV + j] + c2 * H[a * NZ + 2 * NV + j];
    for (long la = 0; la < local; ++la) {
      if (!pair_needed(blocks, n, local, la, lb)) continue;
      const V b0 = basis[la], b1 = basis[local + la], b2 = basis[2 * local + la];
      for (long i = 0; i < NV; ++i)
        for (long j = 0; j < NV; ++j)
          block[j][i] = b0 * half[i][j] + b1 * half[NV + i][j] + b2 * half[2 * NV + i][j];
      for (long l = 0; l < n; ++l) {
        const int A = blocks[l * local + la], B = blocks[l * local + lb];
        if (A >= 0 && A <= B) add_block(P, A, B, l, block, values);
      }
    }
  }
}

/* add kappa d d', d = J' alpha + (0, beta, 0) */
static void add_mixed(const Program *P, long k, long n, double sigma, const V *jj, V *H) {
  V mixed[1 + 2 * NV], d[NZ];
  pack(P->cost_mixed, 1 + 2 * NV, k, n, mixed);
  for (long a = 0; a < NZ; ++a) {
    d[a] = mixed[1] * jj[a * NV];
    for (long i = 1; i < NV; ++i) d[a] += mixed[1 + i] * jj[a * NV + i];
  }
  for (long i = 0; i < NV; ++i) d[NV + i] += mixed[1 + NV + i];
  for (long a = 0; a < NZ; ++a) {
    const V scaled = mixed[0] * sigma * d[a];
    for (long b = 0; b < NZ; ++b) H[a * NZ + b] += scaled * d[b];
  }
}

/* what the second derivatives of the objective add to J' diag(p) J + S */
static void add_cost_curvature(const Program *P, long k, long n, double sigma, const V *jj, V *H) {
  if (!P->cost_first) {
    V weight[1];
    pack(P->weight, 1, k, n, weight);
    for (long m = 0; m < NZ; ++m) H[m * NZ + m] += weight[0] * (2.0 * sigma * P->state_weight[m]);
    return;
  }
  V second[4 * NV];
  pack(P->cost_second, 4 * NV, k, n, second);
  for (long i = 0; i < NV; ++i) {
    const long v = NV + i, w = 2 * NV + i;
    const V cross = sigma * second[NV + i];
    for (long a = 0; a < NZ; ++a) {
      H[a * NZ + v] += cross * jj[a * NV + i];
      H[v * NZ + a] += cross * jj[a * NV + i];
    }
    H[v * NZ + v] += sigma * second[2 * NV + i];
    H[w * NZ + w] += sigma * second[3 * NV + i];
  }
  if (P->cost_mixed) add_mixed(P, k, n, sigma, jj, H);
}

static void turn(const Program *P, long k, long n, const V *H) {
  V direction[NZ], turned[NZ];
  pack(P->direction, NZ, k, n, direction);
  for (long a = 0; a < NZ; ++a) {
    turned[a] = H[a * NZ] * direction[0];
    for (long b = 1; b < NZ; ++b) turned[a] += H[a * NZ + b] * direction[b];
  }
  unpack(turned, NZ, k, n, P->turned);
}

void eo_program_hessian(const Program *P, double sigma, const double *lambda, double *values) {
  V H[NZ * NZ], jj[NV * NZ];
  set_objective(P, sigma, 1);
  add_rows(P, lambda);
  for (long e = 0; e < P->hess_nonzeros; ++e) values[e] = 0.0;
  FOR_LANES(k, n, P->samples) {
    hessian_group(P->theta, k, n, P->state, P->power, P->multiplier, H, jj);
    add_cost_curvature(P, k, n, sigma, jj, H);
    if (P->direction) turn(P, k, n, H);
    add_group_hessian(P, k, n, H, values);
  }
}
