/* Symmetric matrices that are narrow but for some last rows, factored as L d L' within their profile.

   Row i is kept from its first nonzero column to the diagonal (A. George, J. W. Liu, "Computer Solution of Large Sparse
   Positive Definite Systems", 1981, ch. 4). Nothing is exchanged: the order is the caller's, dense rows stand last. The signs
   of d are those of the eigenvalues (Sylvester). */

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
  long n, profile;
  long *first;    /* first column of row i */
  long *start;    /* row i, column j stands at values[start[i] + j], j < i */
  double *values; /* below the diagonal; after factoring, L */
  double *d;      /* diagonal; after factoring, the pivots */
  double *work;   /* n */
} Skyline;

/* where the entry (i, j) stands; the diagonal is apart */
static inline double *entry(const Skyline *s, long i, long j) {
  return i == j ? s->d + i : i > j ? s->values + s->start[i] + j : s->values + s->start[j] + i;
}

/* allocate for `first`, which the structure then owns; 0 where there is no memory */
static int skyline_make(Skyline *s, long n, long *first) {
  long at = 0;
  s->n = n, s->first = first;
  s->start = malloc((n + 1) * sizeof *s->start);
  if (!s->start) return 0;
  for (long i = 0; i < n; ++i) s->start[i] = at - first[i], at += i - first[i];
  s->profile = at;
  s->values = malloc((at + 2 * n + 1) * sizeof *s->values);
  if (!s->values) return 0;
  s->d = s->values + at, s->work = s->d + n;
  return 1;
}

static void skyline_free(Skyline *s) { free(s->first), free(s->start), free(s->values); }

static void skyline_zero(Skyline *s) { memset(s->values, 0, (s->profile + s->n) * sizeof *s->values); }

/* Factor in place. Returns the number of negative pivots; -1 where one vanishes; more than `most` may mean that it stopped. */
static long skyline_factor(Skyline *s, long most) {
  long negative = 0;
  double *restrict scaled = s->work;
  for (long i = 0; i < s->n; ++i) {
    double *restrict row = s->values + s->start[i];
    const long fi = s->first[i];
    double pivot = s->d[i];
    for (long j = fi; j < i; ++j) {
      const double *restrict other = s->values + s->start[j];
      double sum = 0.0;
      for (long k = s->first[j] > fi ? s->first[j] : fi; k < j; ++k) sum += scaled[k] * other[k];
      scaled[j] = row[j] - sum; /* L(i,j) d(j) */
    }
    for (long j = fi; j < i; ++j) {
      row[j] = scaled[j] / s->d[j];
      pivot -= row[j] * scaled[j];
    }
    if (!(fabs(pivot) > 0.0)) return -1; /* also where it is no number; how small it may be, other rows do not tell */
    s->d[i] = pivot;
    if (pivot < 0.0 && ++negative > most) return negative;
  }
  return negative;
}

/* x := A^-1 x */
static void skyline_solve(const Skyline *s, double *restrict x) {
  for (long i = 0; i < s->n; ++i) {
    const double *restrict row = s->values + s->start[i];
    double sum = 0.0;
    for (long j = s->first[i]; j < i; ++j) sum += row[j] * x[j];
    x[i] -= sum;
  }
  for (long i = 0; i < s->n; ++i) x[i] /= s->d[i];
  for (long i = s->n - 1; i >= 0; --i) {
    const double *restrict row = s->values + s->start[i];
    const double xi = x[i];
    for (long j = s->first[i]; j < i; ++j) x[j] -= row[j] * xi;
  }
}
