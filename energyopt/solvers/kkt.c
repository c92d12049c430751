/* The linear systems of IPOPT, for programs with bounded rows along a time line, under the calling convention of MA27.

   IPOPT solves, at every iteration,

       [ H   0   J' ] [dx]         H: n x n, banded: unknowns interact only with those near them in time
       [ 0   S  -I  ] [ds]         S: diagonal, one slack for each of the m bounded rows J
       [ J  -I  -D  ] [dy]         D: diagonal, mostly zero

   Slacks and multipliers are eliminated by hand, y_k having the pivot -(D_k + 1/S_k). What is left, H + J' (D + 1/S)^-1 J,
   is factored as L d L' in its own order within its profile (A. George, J. W. Liu, "Computer Solution of Large Sparse
   Positive Definite Systems", 1981, ch. 4). No pivots are exchanged; the signs of all pivots give the inertia by which IPOPT
   corrects H, and IPOPT refines the solutions. Equality rows would need pivoting: programs that have some use MUMPS.

   The structure is found from the pattern at the first factorization after an analysis, and kept in the integer work array from
   then on. That array comes uninitialised; whether it has been written is told by the first number of IKEEP, which IPOPT hands on. */

#include <math.h>
#include <string.h>

enum { ANALYSED, LAID_OUT }; /* ikeep[0] */
enum { ENTRIES, UNKNOWNS, PAIRS, PROFILE, ROW_NONZEROS, HEADER };
/* then: first[n] start[n] row_start[m + 1] row_column[row nonzeros] target[entries] */

typedef struct {
  int n, m, profile, row_nonzeros;
  int *first, *start, *row_start, *row_column, *target;
} Shape;

static Shape shape_in(int *iw) {
  Shape s;
  s.n = iw[UNKNOWNS], s.m = iw[PAIRS];
  s.profile = iw[PROFILE], s.row_nonzeros = iw[ROW_NONZEROS];
  s.first = iw + HEADER;
  s.start = s.first + s.n;
  s.row_start = s.start + s.n;
  s.row_column = s.row_start + s.m + 1;
  s.target = s.row_column + s.row_nonzeros;
  return s;
}

/* Find m: the last y is tied to the last slack, m places before it, and so on downwards. */
static void find_blocks(int size, int nz, const int *row, const int *column, int *degree, int *neighbour, Shape *s) {
  for (int i = 0; i < size; ++i) degree[i] = 0, neighbour[i] = -1;
  for (int e = 0; e < nz; ++e) {
    const int i = row[e] - 1, j = column[e] - 1;
    if (i == j) continue;
    ++degree[i], ++degree[j];
    if (j > neighbour[i]) neighbour[i] = j;
    if (i > neighbour[j]) neighbour[j] = i;
  }
  s->n = size, s->m = 0;
  const int last = size - 1, gap = last - neighbour[last];
  if (neighbour[last] < 0 || gap <= 0) return;
  int m = 0;
  while (last - gap - m >= 0 && m < gap && degree[last - gap - m] == 1 && neighbour[last - gap - m] == last - m) ++m;
  if (m == gap && size > 2 * m) s->m = m, s->n = size - 2 * m;
}

/* Ints needed, or 0 where the pattern is not of the kind above. Writes the whole structure when iw is given. */
static int analyse(int size, int nz, const int *row, const int *column, int *work, int *iw, int *profile) {
  Shape s;
  int *degree = work, *neighbour = work + size, *first = work + 2 * size, *count = work + 3 * size, *lowest = work + 4 * size;
  find_blocks(size, nz, row, column, degree, neighbour, &s);
  const int y0 = s.n + s.m;
  for (int i = 0; i < s.n; ++i) first[i] = i;
  for (int k = 0; k < s.m; ++k) count[k] = 0, lowest[k] = size;
  s.row_nonzeros = 0;
  for (int e = 0; e < nz; ++e) {
    const int low = (row[e] < column[e] ? row[e] : column[e]) - 1, high = (row[e] < column[e] ? column[e] : row[e]) - 1;
    if (high < s.n) {
      if (low < first[high]) first[high] = low;
    } else if (s.m && high >= y0 && low < s.n) {
      ++count[high - y0], ++s.row_nonzeros;
      if (low < lowest[high - y0]) lowest[high - y0] = low;
    } else if (low != high && !(high >= y0 && low == high - s.m)) {
      return 0;
    }
  }
  for (int e = 0; e < nz; ++e) {
    const int low = (row[e] < column[e] ? row[e] : column[e]) - 1, high = (row[e] < column[e] ? column[e] : row[e]) - 1;
    if (s.m && high >= y0 && low < s.n && lowest[high - y0] < first[low]) first[low] = lowest[high - y0];
  }
  s.profile = 0;
  for (int i = 0; i < s.n; ++i) s.profile += i - first[i];
  *profile = s.profile + s.n + s.row_nonzeros + 3 * s.m + s.n;
  const int needed = HEADER + 2 * s.n + s.m + 1 + s.row_nonzeros + nz;
  if (!iw) return needed;
  iw[ENTRIES] = nz, iw[UNKNOWNS] = s.n, iw[PAIRS] = s.m, iw[PROFILE] = s.profile, iw[ROW_NONZEROS] = s.row_nonzeros;
  s = shape_in(iw);
  int at = 0;
  for (int i = 0; i < s.n; ++i) s.first[i] = first[i], s.start[i] = at - first[i], at += i - first[i];
  s.row_start[0] = 0;
  for (int k = 0; k < s.m; ++k) s.row_start[k + 1] = s.row_start[k] + count[k], count[k] = s.row_start[k];
  /* where each entry goes: profile, diagonal, rows, slack pivots, ties of y and s, y pivots */
  const int diagonal = s.profile, rows = diagonal + s.n, slack = rows + s.row_nonzeros, tie = slack + s.m, pivot = tie + s.m;
  for (int e = 0; e < nz; ++e) {
    const int low = (row[e] < column[e] ? row[e] : column[e]) - 1, high = (row[e] < column[e] ? column[e] : row[e]) - 1;
    if (high < s.n) s.target[e] = low == high ? diagonal + low : s.start[high] + low;
    else if (high >= y0 && low < s.n) s.row_column[count[high - y0]] = low, s.target[e] = rows + count[high - y0]++;
    else if (low == high) s.target[e] = low < y0 ? slack + low - s.n : pivot + low - y0;
    else s.target[e] = tie + high - y0;
  }
  return needed;
}

/* L d L' in place: row i holds L(i, first..i-1); returns the number of negative pivots, -1 where one vanishes */
static int factor(const Shape *s, double *values, double *d, double *scaled, double scale) {
  int negative = 0;
  for (int i = 0; i < s->n; ++i) {
    double *restrict row = values + s->start[i];
    const int fi = s->first[i];
    double pivot = d[i];
    for (int j = fi; j < i; ++j) {
      const double *restrict other = values + s->start[j];
      const int from = s->first[j] > fi ? s->first[j] : fi;
      double sum = 0.0;
      for (int k = from; k < j; ++k) sum += scaled[k] * other[k];
      scaled[j] = row[j] - sum; /* L(i,j) d(j) */
    }
    for (int j = fi; j < i; ++j) {
      row[j] = scaled[j] / d[j];
      pivot -= row[j] * scaled[j];
    }
    if (!(fabs(pivot) > 1e-15 * scale)) return -1;
    d[i] = pivot;
    negative += pivot < 0.0;
  }
  return negative;
}

void ma27id_(int *icntl, double *cntl) {
  memset(icntl, 0, 30 * sizeof *icntl);
  memset(cntl, 0, 5 * sizeof *cntl);
}

void ma27ad_(const int *N, const int *NZ, const int *row, const int *column, int *iw, const int *liw, int *ikeep, int *iw1,
             int *steps, const int *flag, const int *icntl, const double *cntl, int *info, double *ops) {
  int work[5 * *N], profile = 0;
  const int needed = analyse(*N, *NZ, row, column, work, 0, &profile);
  (void)iw, (void)liw, (void)iw1, (void)flag, (void)icntl, (void)cntl;
  memset(info, 0, 20 * sizeof *info);
  *steps = 1, *ops = 0.0, ikeep[0] = ANALYSED;
  info[0] = needed ? 0 : -1;
  info[4] = *NZ + profile, info[5] = needed;
}

void ma27bd_(const int *N, const int *NZ, const int *row, const int *column, double *a, const int *la, int *iw, const int *liw,
             int *ikeep, int *steps, int *front, int *iw1, const int *icntl, const double *cntl, int *info) {
  (void)steps, (void)iw1, (void)icntl, (void)cntl;
  memset(info, 0, 20 * sizeof *info);
  *front = *N;
  if (ikeep[0] != LAID_OUT) {
    int work[5 * *N], profile = 0;
    const int needed = analyse(*N, *NZ, row, column, work, 0, &profile);
    if (needed > *liw) { info[0] = -3, info[1] = needed; return; }
    if (*NZ + profile > *la) { info[0] = -4, info[1] = *NZ + profile; return; }
    analyse(*N, *NZ, row, column, work, iw, &profile);
    ikeep[0] = LAID_OUT;
  }
  const Shape s = shape_in(iw);
  double *values = a + *NZ, *d = values + s.profile, *rows = d + s.n;
  double *slack = rows + s.row_nonzeros, *tie = slack + s.m, *pivot = tie + s.m, *scaled = pivot + s.m;
  memset(values, 0, (s.profile + s.n + s.row_nonzeros + 3 * s.m) * sizeof *values);
  for (int e = 0; e < *NZ; ++e) values[s.target[e]] += a[e];
  int negative = 0;
  double scale = 0.0;
  for (int k = 0; k < s.m; ++k) {
    if (slack[k] == 0.0) { info[0] = -5; return; }
    pivot[k] -= tie[k] * tie[k] / slack[k];
    if (pivot[k] == 0.0) { info[0] = -5; return; }
    negative += (slack[k] < 0.0) + (pivot[k] < 0.0);
    for (int p = s.row_start[k]; p < s.row_start[k + 1]; ++p)
      for (int q = s.row_start[k]; q <= p; ++q) {
        const int i = s.row_column[p], j = s.row_column[q];
        const double add = -rows[p] * rows[q] / pivot[k];
        if (i == j) d[i] += p == q ? add : 2.0 * add;
        else values[s.start[i > j ? i : j] + (i > j ? j : i)] += add;
      }
  }
  for (int i = 0; i < s.n; ++i) scale = fabs(d[i]) > scale ? fabs(d[i]) : scale;
  const int more = factor(&s, values, d, scaled, scale);
  if (more < 0) { info[0] = -5; return; }
  info[14] = negative + more;
}

void ma27cd_(const int *N, const double *a, const int *la, int *iw, const int *liw, double *w, const int *front, double *rhs,
             int *iw1, const int *steps, const int *icntl, const double *cntl) {
  (void)N, (void)la, (void)liw, (void)w, (void)front, (void)iw1, (void)steps, (void)icntl, (void)cntl;
  const Shape s = shape_in(iw);
  const double *values = a + iw[ENTRIES], *d = values + s.profile, *rows = d + s.n;
  const double *slack = rows + s.row_nonzeros, *tie = slack + s.m, *pivot = tie + s.m;
  double *x = rhs, *xs = rhs + s.n, *xy = xs + s.m;
  for (int k = 0; k < s.m; ++k) {
    xy[k] -= tie[k] / slack[k] * xs[k];
    for (int p = s.row_start[k]; p < s.row_start[k + 1]; ++p) x[s.row_column[p]] -= rows[p] * xy[k] / pivot[k];
  }
  for (int i = 0; i < s.n; ++i) {
    const double *row = values + s.start[i];
    double sum = 0.0;
    for (int j = s.first[i]; j < i; ++j) sum += row[j] * x[j];
    x[i] -= sum;
  }
  for (int i = 0; i < s.n; ++i) x[i] /= d[i];
  for (int i = s.n - 1; i >= 0; --i) {
    const double *row = values + s.start[i], xi = x[i];
    for (int j = s.first[i]; j < i; ++j) x[j] -= row[j] * xi;
  }
  for (int k = 0; k < s.m; ++k) {
    double sum = xy[k];
    for (int p = s.row_start[k]; p < s.row_start[k + 1]; ++p) sum -= rows[p] * x[s.row_column[p]];
    xy[k] = sum / pivot[k];
    xs[k] = (xs[k] - tie[k] * xy[k]) / slack[k];
  }
}
