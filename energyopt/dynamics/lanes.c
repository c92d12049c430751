/* Functions of a vector of LANES doubles.

   Sine and cosine are what a kernel spends most on where they are taken lane by lane. Here x = n π/2 + r with π/2 in three parts
   (W. J. Cody, W. Waite, "Software Manual for the Elementary Functions", 1980), and polynomials in r on [-π/4, π/4]; parts and
   coefficients are those of fdlibm (Sun Microsystems, k_sin.c, k_cos.c, e_rem_pio2.c). The error is below 3 units in the last place. */

typedef long long Mask __attribute__((vector_size(8 * LANES)));

#define ROUNDER 6755399441055744.0 /* 1.5 * 2^52: what is added to it is rounded to an integer, in its lowest bits */
#define FARTHEST 1e5               /* beyond, n times the first part of π/2 would not be exact */

static inline V lanes(double x) {
  V r;
  for (int l = 0; l < LANES; ++l) r[l] = x;
  return r;
}

#define LANEWISE(f, name) \
  static inline V name(V x) { \
    for (int l = 0; l < LANES; ++l) x[l] = f(x[l]); \
    return x; \
  }
LANEWISE(tanh, lanes_tanh) LANEWISE(sqrt, lanes_sqrt) LANEWISE(exp, lanes_exp) LANEWISE(log, lanes_log) LANEWISE(fabs, lanes_fabs)
LANEWISE(sin, each_sin) LANEWISE(cos, each_cos)

static inline V chosen(Mask which, V yes, V no) { return (V)(((Mask)yes & which) | ((Mask)no & ~which)); }

/* whether all are within FARTHEST; false for what is not a number */
static inline int moderate(V x) {
  int all = 1;
  for (int l = 0; l < LANES; ++l) all &= x[l] < FARTHEST && x[l] > -FARTHEST;
  return all;
}

/* sin(x + quarters π/2) */
static inline V shifted_sin(V x, long long quarters) {
  const V counted = x * 6.36619772367581382433e-01 + ROUNDER, n = counted - ROUNDER;
  const V r = ((x - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
  const V z = r * r;
  const V sine = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
               + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  const V cosine = 1.0 - (0.5 * z - z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
                 + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
                 - z * 1.13596475577881948265e-11))))));
  const Mask quadrant = (Mask)counted + quarters;
  return (V)((Mask)chosen((quadrant & 1) != 0, cosine, sine) ^ ((quadrant & 2) << 62));
}

static inline V lanes_sin(V x) { return moderate(x) ? shifted_sin(x, 0) : each_sin(x); }
static inline V lanes_cos(V x) { return moderate(x) ? shifted_sin(x, 1) : each_cos(x); }
