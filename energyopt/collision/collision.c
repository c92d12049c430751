/* Distances between the spheres of an arm and obstacles, and between its own spheres, with derivatives in q.

Nothing here depends on the arm or the scene: both come as numbers, so one library serves all of them. `Arm` and `Scene` mirror
the structures of kernels.py. A pair is (a, b): sphere a and, for b >= 0, obstacle b, else sphere -1 - b. With c the centre of a
sphere, n the gradient and H the curvature of a distance in c,

    dd/dq = n' J,    d2d/dq2 = J' H J + sum_c n_c d2c/dq2,    d2c/dq_i dq_j = z_i x J_j   (i turns, j at or beyond i; 0 where i slides)

z_i being the axis of joint i and J_j = z_j x (c - p_j) where j turns, z_j where it slides. */

#include <math.h>
#include <string.h>

#define MOST_JOINTS 64
#define TINY 1e-12
#define SAME 1e-10

typedef struct {
    long joints, nv, spheres, links, self_pairs;
    const long *parent, *kind, *column;                  /* a joint each; kind 0: the world, 1 turns, 2 slides */
    const double *placement, *axis;                      /* (joints, 12) rotation by rows, then position; (joints, 3) */
    const long *sphere_joint, *link_start, *link_joint;  /* spheres of a link stand together */
    const double *center, *radius, *link_center, *link_radius;
    const long *self_pair;                               /* (self_pairs, 2) links */
} Arm;

typedef struct {
    long obstacles, samples;
    const long *kind, *face_start;                       /* 0 sphere, 1 capsule, 2 box, 3 cylinder, 4 half-space, 5 mesh */
    const double *size, *reach, *face;                   /* (obstacles, 4), (obstacles), (faces, 13): normal, offset, corners */
    const unsigned char *watched;                        /* (links, obstacles) */
    const double *pose;                                  /* (samples, obstacles, 12) */
    const double *required, *required_self;              /* (spheres, obstacles), (spheres, spheres) */
    double margin;                                       /* the largest requirement */
    double band, stiffness, gain, safe, least;           /* of the penalty; gain 0: no potential */
} Scene;

typedef struct {
    double *center, *link_center, *axis, *origin;        /* (samples, spheres, 3), (samples, links, 3), (samples, joints, 3) twice */
} Placed;

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void turned(const double *R, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}

static void turned_back(const double *R, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

/* ------------------------------------------------------------------ where everything is */

static void rotate_about(const double *axis, double angle, double *R) {
    double s = sin(angle), c = 1.0 - cos(angle), x = axis[0], y = axis[1], z = axis[2];
    double T[9] = {1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y,
                   c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x,
                   c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)};
    double old[9];
    memcpy(old, R, sizeof old);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) R[3 * i + j] = old[3 * i] * T[j] + old[3 * i + 1] * T[3 + j] + old[3 * i + 2] * T[6 + j];
}

void eo_clearance_place(const Arm *arm, long samples, const double *q, const Placed *out) {
    double R[MOST_JOINTS][9], p[MOST_JOINTS][3];
    static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    memcpy(R[0], unit, sizeof unit);
    memset(p[0], 0, sizeof p[0]);
    for (long k = 0; k < samples; k++, q += arm->nv) {
        double *axis = out->axis + 3 * k * arm->joints, *origin = out->origin + 3 * k * arm->joints;
        for (long j = 1; j < arm->joints; j++) {
            const double *P = arm->placement + 12 * j, *parent = R[arm->parent[j]];
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    R[j][3 * a + b] = parent[3 * a] * P[b] + parent[3 * a + 1] * P[3 + b] + parent[3 * a + 2] * P[6 + b];
            turned(parent, P + 9, p[j]);
            for (int a = 0; a < 3; a++) p[j][a] += p[arm->parent[j]][a];
            turned(R[j], arm->axis + 3 * j, axis + 3 * j);
            double value = q[arm->column[j]];
            if (arm->kind[j] == 2)
                for (int a = 0; a < 3; a++) p[j][a] += value * axis[3 * j + a];
            else
                rotate_about(arm->axis + 3 * j, value, R[j]);
            memcpy(origin + 3 * j, p[j], sizeof p[j]);
        }
        for (long s = 0; s < arm->spheres; s++) {
            double *c = out->center + 3 * (k * arm->spheres + s);
            long j = arm->sphere_joint[s];
            turned(R[j], arm->center + 3 * s, c);
            for (int a = 0; a < 3; a++) c[a] += p[j][a];
        }
        for (long l = 0; l < arm->links; l++) {
            double *c = out->link_center + 3 * (k * arm->links + l);
            long j = arm->link_joint[l];
            turned(R[j], arm->link_center + 3 * l, c);
            for (int a = 0; a < 3; a++) c[a] += p[j][a];
        }
    }
}

/* ------------------------------------------------------------------ signed distances in a shape's own axes */

typedef struct {
    double d, n[3], H[9];
} Distance;

static void flat(Distance *out, double d, const double *n) {
    out->d = d;
    memcpy(out->n, n, sizeof out->n);
    memset(out->H, 0, sizeof out->H);
}

/* |v| - r, where only the given directions count. */
static void round_off(Distance *out, const double *v, double r, const int *counts) {
    double length = sqrt(dot(v, v));
    memset(out->H, 0, sizeof out->H);
    out->d = length - r;
    for (int i = 0; i < 3; i++) out->n[i] = v[i] / length;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            if (counts[i] && counts[j]) out->H[3 * i + j] = ((i == j) - out->n[i] * out->n[j]) / length;
}

static void sphere_distance(const double *y, double r, Distance *out) {
    static const int all[3] = {1, 1, 1};
    static const double up[3] = {0, 0, 1};
    if (dot(y, y) > TINY * TINY) round_off(out, y, r, all);
    else flat(out, sqrt(dot(y, y)) - r, up);
}

static void capsule_distance(const double *y, double r, double length, Distance *out) {
    double half = 0.5 * length, z = y[2] > half ? y[2] - half : y[2] < -half ? y[2] + half : 0.0;
    double v[3] = {y[0], y[1], z};
    int beside = fabs(y[2]) < half, counts[3] = {1, 1, !beside};
    double size = sqrt(dot(v, v));
    double out_of_axis[3] = {0, beside && size == 0.0, !(beside && size == 0.0)};
    if (size > TINY) round_off(out, v, r, counts);
    else flat(out, size - r, out_of_axis);
}

static void box_distance(const double *y, const double *size, Distance *out) {
    double q[3], above[3], n[3] = {0, 0, 0}, most = -INFINITY;
    int counts[3], face = 0;
    for (int i = 0; i < 3; i++) {
        q[i] = fabs(y[i]) - 0.5 * size[i];
        counts[i] = q[i] > 0;
        above[i] = counts[i] ? (y[i] < 0 ? -q[i] : q[i]) : 0.0;
        if (q[i] > most) most = q[i], face = i;
    }
    if (dot(above, above) > TINY * TINY) {
        round_off(out, above, 0.0, counts);
        return;
    }
    n[face] = y[face] < 0 ? -1.0 : 1.0;
    flat(out, most, n);
}

static void cylinder_distance(const double *y, double r, double length, Distance *out) {
    double rho = sqrt(y[0] * y[0] + y[1] * y[1]), u[3] = {0, 1, 0}, e[3] = {0, 0, y[2] < 0 ? -1.0 : 1.0};
    double q1 = rho - r, q2 = fabs(y[2]) - 0.5 * length, f1, f2, bend = 0.0;
    if (rho > TINY) u[0] = y[0] / rho, u[1] = y[1] / rho;
    double a1 = q1 > 0 ? q1 : 0.0, a2 = q2 > 0 ? q2 : 0.0, far = sqrt(a1 * a1 + a2 * a2);
    if (far > TINY) {
        f1 = a1 / far, f2 = a2 / far;
        if (a1 > 0 && a2 > 0) bend = 1.0 / far;
        out->d = far;
    } else {
        f1 = q1 >= q2, f2 = !(q1 >= q2);
        out->d = q1 >= q2 ? q1 : q2;
    }
    double t[3] = {-u[1], u[0], 0}, m[3], turn = rho > TINY ? f1 / rho : 0.0;
    for (int i = 0; i < 3; i++) out->n[i] = f1 * u[i] + f2 * e[i], m[i] = f2 * u[i] - f1 * e[i];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) out->H[3 * i + j] = turn * t[i] * t[j] + bend * m[i] * m[j];
}

/* Barycentric weights of the point of a triangle that is nearest to y. */
static void nearest_on_triangle(const double *y, const double *A, double *w) {
    double ab[3], ac[3], ay[3];
    for (int i = 0; i < 3; i++) ab[i] = A[3 + i] - A[i], ac[i] = A[6 + i] - A[i], ay[i] = y[i] - A[i];
    double aa = dot(ab, ab), bb = dot(ac, ac), cc = dot(ab, ac), d1 = dot(ab, ay), d2 = dot(ac, ay);
    double det = aa * bb - cc * cc;
    if (det < 1e-300) det = 1e-300;
    w[1] = (bb * d1 - cc * d2) / det, w[2] = (aa * d2 - cc * d1) / det, w[0] = 1.0 - w[1] - w[2];
    if (w[0] >= 0 && w[1] >= 0 && w[2] >= 0) return;
    double best = INFINITY;
    for (int edge = 0; edge < 3; edge++) {
        const double *S = A + 3 * edge, *E = A + 3 * ((edge + 1) % 3);
        double along[3], away[3];
        for (int i = 0; i < 3; i++) along[i] = E[i] - S[i], away[i] = y[i] - S[i];
        double length = dot(along, along), s = dot(away, along) / (length > 1e-300 ? length : 1e-300);
        s = s < 0 ? 0 : s > 1 ? 1 : s;
        for (int i = 0; i < 3; i++) away[i] -= s * along[i];
        double gap = dot(away, away);
        if (gap < best) {
            best = gap;
            w[0] = w[1] = w[2] = 0.0;
            w[edge] = 1.0 - s, w[(edge + 1) % 3] = s;
        }
    }
}

static void mesh_distance(const double *y, const double *face, long faces, Distance *out) {
    double most = -INFINITY, nearest = INFINITY, weights[3] = {1, 1, 1};
    const double *best = face;
    for (long f = 0; f < faces; f++) {
        double height = dot(face + 13 * f, y) - face[13 * f + 3];
        if (height > most) most = height, best = face + 13 * f;
    }
    if (most <= 0) {
        flat(out, most, best);
        return;
    }
    double away[3] = {0, 0, 0};
    for (long f = 0; f < faces; f++) {
        const double *F = face + 13 * f;
        double height = dot(F, y) - F[3], w[3], v[3];
        if (height <= 0 || height * height > nearest) continue;
        nearest_on_triangle(y, F + 4, w);
        for (int i = 0; i < 3; i++) v[i] = y[i] - w[0] * F[4 + i] - w[1] * F[7 + i] - w[2] * F[10 + i];
        double gap = dot(v, v);
        if (gap < nearest) {
            nearest = gap, best = F;
            memcpy(away, v, sizeof away);
            memcpy(weights, w, sizeof weights);
        }
    }
    double d = sqrt(nearest);
    if (d <= SAME) {
        flat(out, d, best);
        return;
    }
    double n[3] = {away[0] / d, away[1] / d, away[2] / d}, edge[3] = {0, 0, 0};
    int gone = weights[1] < weights[0], zeros = (weights[0] <= SAME) + (weights[1] <= SAME) + (weights[2] <= SAME);
    if (weights[2] < weights[gone]) gone = 2;
    flat(out, d, n);
    if (!zeros) return;
    if (zeros == 1) {
        const double *S = best + 4 + 3 * ((gone + 1) % 3), *E = best + 4 + 3 * ((gone + 2) % 3);
        for (int i = 0; i < 3; i++) edge[i] = E[i] - S[i];
        double length = sqrt(dot(edge, edge));
        for (int i = 0; i < 3; i++) edge[i] /= length;
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) out->H[3 * i + j] = ((i == j) - n[i] * n[j] - edge[i] * edge[j]) / d;
}

/* Distance of a point from an obstacle at a sample; derivatives only where `bent` asks for them. */
static void obstacle_distance(const Scene *scene, long k, long o, const double *point, int bent, Distance *out) {
    const double *pose = scene->pose + 12 * (k * scene->obstacles + o), *size = scene->size + 4 * o;
    double away[3] = {point[0] - pose[9], point[1] - pose[10], point[2] - pose[11]}, y[3];
    turned_back(pose, away, y);
    switch (scene->kind[o]) {
        case 0: sphere_distance(y, size[0], out); break;
        case 1: capsule_distance(y, size[0], size[1], out); break;
        case 2: box_distance(y, size, out); break;
        case 3: cylinder_distance(y, size[0], size[1], out); break;
        case 4: flat(out, dot(size, y) - size[3], size); break;
        default: mesh_distance(y, scene->face + 13 * scene->face_start[o], scene->face_start[o + 1] - scene->face_start[o], out);
    }
    if (!bent) return;
    double n[3], half[9], H[9];
    turned(pose, out->n, n);
    memcpy(out->n, n, sizeof n);
    memcpy(H, out->H, sizeof H);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) half[3 * i + j] = pose[3 * i] * H[j] + pose[3 * i + 1] * H[3 + j] + pose[3 * i + 2] * H[6 + j];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out->H[3 * i + j] = half[3 * i] * pose[3 * j] + half[3 * i + 1] * pose[3 * j + 1] + half[3 * i + 2] * pose[3 * j + 2];
}

/* Whether a ball about a point is surely farther than `reach` from an obstacle. */
static int surely_far(const Scene *scene, long k, long o, const double *point, double reach) {
    const double *x = scene->pose + 12 * (k * scene->obstacles + o) + 9;
    double away[3] = {point[0] - x[0], point[1] - x[1], point[2] - x[2]}, sum = scene->reach[o] + reach;
    return dot(away, away) >= sum * sum && sum > 0;
}

/* Distance of the surfaces of two spheres; derivatives in c_a - c_b. */
static void sphere_pair(const Arm *arm, const double *center, long a, long b, Distance *out) {
    double away[3];
    for (int i = 0; i < 3; i++) away[i] = center[3 * a + i] - center[3 * b + i];
    sphere_distance(away, arm->radius[a] + arm->radius[b], out);
}

static void pair_distance(const Arm *arm, const Scene *scene, const Placed *at, long k, long a, long b, Distance *out) {
    const double *center = at->center + 3 * k * arm->spheres;
    if (b < 0) {
        sphere_pair(arm, center, a, -1 - b, out);
        return;
    }
    obstacle_distance(scene, k, b, center + 3 * a, 1, out);
    out->d -= arm->radius[a];
}

/* ------------------------------------------------------------------ derivatives in q */

/* Columns of J of a sphere, from its joint up to the world; returns their number, their joints in `chain`. */
static int columns_of(const Arm *arm, const Placed *at, long k, long s, long *chain, double (*J)[3]) {
    const double *c = at->center + 3 * (k * arm->spheres + s);
    int count = 0;
    for (long j = arm->sphere_joint[s]; j > 0; j = arm->parent[j]) {
        const double *z = at->axis + 3 * (k * arm->joints + j), *p = at->origin + 3 * (k * arm->joints + j);
        double arm_of[3] = {c[0] - p[0], c[1] - p[1], c[2] - p[2]};
        if (arm->kind[j] == 2) memcpy(J[count], z, sizeof J[count]);
        else cross(z, arm_of, J[count]);
        chain[count++] = j;
    }
    return count;
}

static void add_slope(const Arm *arm, const Placed *at, long k, long s, const double *f, double *gradient) {
    long chain[MOST_JOINTS];
    double J[MOST_JOINTS][3];
    int count = columns_of(arm, at, k, s, chain, J);
    for (int a = 0; a < count; a++) gradient[arm->column[chain[a]]] += dot(f, J[a]);
}

/* Adds J' G J and the force times the bend of the sphere's path to H (nv, nv). */
static void add_bend(const Arm *arm, const Placed *at, long k, long s, const double *f, const double *G, double *H) {
    long chain[MOST_JOINTS];
    double J[MOST_JOINTS][3], GJ[3], bend[3];
    int count = columns_of(arm, at, k, s, chain, J);
    for (int b = 0; b < count; b++) {
        turned(G, J[b], GJ);
        long column = arm->column[chain[b]];
        for (int a = b; a < count; a++) { /* chain[a] is at or before chain[b] */
            long j = chain[a];
            double value = dot(J[a], GJ);
            if (arm->kind[j] == 1) {
                cross(at->axis + 3 * (k * arm->joints + j), J[b], bend);
                value += dot(f, bend);
            }
            H[arm->column[j] * arm->nv + column] += value;
            if (a != b) H[column * arm->nv + arm->column[j]] += value;
        }
    }
}

/* Adds J_r' G J_r of the relative motion of two spheres. */
static void add_relative(const Arm *arm, const Placed *at, long k, long a, long b, const double *G, double *H) {
    long chain[MOST_JOINTS], joint[MOST_JOINTS];
    double J[MOST_JOINTS][3], R[MOST_JOINTS][3], GR[3];
    int count = 0, place[MOST_JOINTS];
    memset(place, -1, sizeof place);
    for (int side = 0; side < 2; side++) {
        int found = columns_of(arm, at, k, side ? b : a, chain, J);
        for (int i = 0; i < found; i++) {
            long j = chain[i];
            if (place[j] < 0) {
                place[j] = count, joint[count] = j;
                memset(R[count++], 0, sizeof R[0]);
            }
            for (int x = 0; x < 3; x++) R[place[j]][x] += side ? -J[i][x] : J[i][x];
        }
    }
    for (int i = 0; i < count; i++) {
        turned(G, R[i], GR);
        for (int j = 0; j < count; j++) H[arm->column[joint[j]] * arm->nv + arm->column[joint[i]]] += dot(R[j], GR);
    }
}

/* first (dE/dd) and second (d2E/dd2) of a function of one pair's distance, put into forces and curvatures. */
static void act(const Arm *arm, const Placed *at, long k, long a, long b, const Distance *x, double first, double second,
                double *gradient, double *hessian) {
    double f[3], back[3], G[9], none[9] = {0};
    for (int i = 0; i < 3; i++) f[i] = first * x->n[i], back[i] = -f[i];
    if (gradient) {
        add_slope(arm, at, k, a, f, gradient);
        if (b < 0) add_slope(arm, at, k, -1 - b, back, gradient);
    }
    if (!hessian) return;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) G[3 * i + j] = first * x->H[3 * i + j] + second * x->n[i] * x->n[j];
    if (b >= 0) {
        add_bend(arm, at, k, a, f, G, hessian);
        return;
    }
    add_bend(arm, at, k, a, f, none, hessian);
    add_bend(arm, at, k, -1 - b, back, none, hessian);
    add_relative(arm, at, k, a, -1 - b, G, hessian);
}

/* What acts on a rigid link, collected over its spheres: force F, moment matrix T = sum f c', and the stiffness against a twist
(velocity of the point at the origin, turning rate), since a point c of the link moves by v + w x c. */
typedef struct {
    double F[3], T[9], K[36];
} Load;

/* K += X_a' G X_b with X = [I, -[c]x], the motion of a point in terms of the twist of its link. */
static void add_stiffness(const double *a, const double *b, const double *G, double sign, double *K) {
    double GX[3][6];
    for (int i = 0; i < 3; i++) {
        const double *g = G + 3 * i;
        for (int j = 0; j < 3; j++) GX[i][j] = sign * g[j];
        GX[i][3] = sign * (g[2] * b[1] - g[1] * b[2]); /* -g [b]x */
        GX[i][4] = sign * (g[0] * b[2] - g[2] * b[0]);
        GX[i][5] = sign * (g[1] * b[0] - g[0] * b[1]);
    }
    for (int j = 0; j < 6; j++) {
        double x = GX[0][j], y = GX[1][j], z = GX[2][j];
        K[j] += x, K[6 + j] += y, K[12 + j] += z;
        K[18 + j] += a[1] * z - a[2] * y; /* [a]x GX */
        K[24 + j] += a[2] * x - a[0] * z;
        K[30 + j] += a[0] * y - a[1] * x;
    }
}

static void add_force(const double *c, const double *f, Load *load) {
    for (int i = 0; i < 3; i++) {
        load->F[i] += f[i];
        for (int j = 0; j < 3; j++) load->T[3 * i + j] += f[i] * c[j];
    }
}

/* Twists of the joints a link moves with, (w, v at the origin) as (v, w); returns their number. */
static int twists_of(const Arm *arm, const Placed *at, long k, long joint, long *chain, double (*S)[6]) {
    int count = 0;
    for (long j = joint; j > 0; j = arm->parent[j], count++) {
        const double *z = at->axis + 3 * (k * arm->joints + j), *p = at->origin + 3 * (k * arm->joints + j);
        chain[count] = j;
        if (arm->kind[j] == 2) {
            memcpy(S[count], z, 3 * sizeof *z);
            memset(S[count] + 3, 0, 3 * sizeof *z);
        } else {
            cross(p, z, S[count]);
            memcpy(S[count] + 3, z, 3 * sizeof *z);
        }
    }
    return count;
}

/* The load on a link put into the derivatives in q. */
static void settle(const Arm *arm, const Placed *at, long k, long joint, const Load *load, double *g, double *H) {
    long chain[MOST_JOINTS], nv = arm->nv;
    double S[MOST_JOINTS][6], KS[6], bend[3];
    int count = twists_of(arm, at, k, joint, chain, S);
    double trace = load->T[0] + load->T[4] + load->T[8];
    double moment[3] = {load->T[7] - load->T[5], load->T[2] - load->T[6], load->T[3] - load->T[1]}; /* sum c x f */
    for (int b = 0; b < count; b++) {
        const double *v = S[b], *w = S[b] + 3;
        long column = arm->column[chain[b]];
        g[column] += dot(load->F, v) + dot(moment, w);
        for (int i = 0; i < 6; i++) {
            KS[i] = 0;
            for (int j = 0; j < 6; j++) KS[i] += load->K[6 * i + j] * S[b][j];
        }
        for (int a = b; a < count; a++) { /* chain[a] is at or before chain[b] */
            long row = arm->column[chain[a]];
            double value = 0;
            for (int i = 0; i < 6; i++) value += S[a][i] * KS[i];
            if (arm->kind[chain[a]] == 1) { /* f . z x (v + w x c) = f . (z x v) + (w . f)(z . c) - (z . w)(f . c) */
                const double *z = S[a] + 3;
                double Tz[3];
                cross(z, v, bend);
                turned(load->T, z, Tz);
                value += dot(load->F, bend) + dot(w, Tz) - dot(z, w) * trace;
            }
            H[row * nv + column] += value;
            if (a != b) H[column * nv + row] += value;
        }
    }
}

/* The stiffness between two links, S_a' K S_b and its transpose. */
static void settle_between(const Arm *arm, const Placed *at, long k, long first, long second, const double *K, double *H) {
    long chain_a[MOST_JOINTS], chain_b[MOST_JOINTS], nv = arm->nv;
    double A[MOST_JOINTS][6], B[MOST_JOINTS][6], KB[6];
    int count_a = twists_of(arm, at, k, first, chain_a, A), count_b = twists_of(arm, at, k, second, chain_b, B);
    for (int b = 0; b < count_b; b++) {
        for (int i = 0; i < 6; i++) {
            KB[i] = 0;
            for (int j = 0; j < 6; j++) KB[i] += K[6 * i + j] * B[b][j];
        }
        long column = arm->column[chain_b[b]];
        for (int a = 0; a < count_a; a++) {
            double value = 0;
            long row = arm->column[chain_a[a]];
            for (int i = 0; i < 6; i++) value += A[a][i] * KB[i];
            H[row * nv + column] += value;
            H[column * nv + row] += value;
        }
    }
}

static void stiffness_of(const Distance *x, double first, double second, double *f, double *G) {
    for (int i = 0; i < 3; i++) {
        f[i] = first * x->n[i];
        for (int j = 0; j < 3; j++) G[3 * i + j] = first * x->H[3 * i + j] + second * x->n[i] * x->n[j];
    }
}

/* ------------------------------------------------------------------ what is asked for */

/* Distance [m], gradient (nv) of each pair (a, b) at its sample. */
void eo_clearance_pairs(const Arm *arm, const Scene *scene, const Placed *at, long pairs, const long *sample, const long *pair,
                        double *distance, double *gradient) {
    memset(gradient, 0, pairs * arm->nv * sizeof *gradient);
    for (long r = 0; r < pairs; r++) {
        Distance x;
        pair_distance(arm, scene, at, sample[r], pair[2 * r], pair[2 * r + 1], &x);
        distance[r] = x.d;
        act(arm, at, sample[r], pair[2 * r], pair[2 * r + 1], &x, 1.0, 0.0, gradient + r * arm->nv, 0);
    }
}

/* Sum over pairs of multiplier times second derivative, added to (samples, nv, nv). */
void eo_clearance_bends(const Arm *arm, const Scene *scene, const Placed *at, long pairs, const long *sample, const long *pair,
                        const double *multiplier, double *hessian) {
    for (long r = 0; r < pairs; r++) {
        Distance x;
        if (multiplier[r] == 0.0) continue;
        pair_distance(arm, scene, at, sample[r], pair[2 * r], pair[2 * r + 1], &x);
        act(arm, at, sample[r], pair[2 * r], pair[2 * r + 1], &x, multiplier[r], 0.0, 0,
            hessian + sample[r] * arm->nv * arm->nv);
    }
}

/* U(d), U', U'' of the repulsive potential. */
static double potential(const Scene *scene, double d, double *first, double *second) {
    if (scene->gain == 0.0 || d > scene->safe) return *first = *second = 0.0;
    double felt = d < scene->least ? scene->least : d, gap = 1.0 / felt - 1.0 / scene->safe, below = d - felt;
    double slope = -scene->gain * gap / (felt * felt), square = felt * felt;
    *second = scene->gain * (1.0 + 2.0 * felt * gap) / (square * square);
    *first = slope + *second * below;
    return 0.5 * scene->gain * gap * gap + slope * below + 0.5 * *second * below * below;
}

/* A hinge whose second derivative rises from 0 to the stiffness over the band, twice continuously differentiable. */
static double hinge(const Scene *scene, double d, double required, double *first, double *second) {
    double missing = required + scene->band - d, k = scene->stiffness, band = scene->band;
    if (k == 0.0 || missing <= 0) return *first = *second = 0.0;
    if (missing < band) {
        *first = -0.5 * k * missing * missing / band;
        *second = k * missing / band;
        return k * missing * missing * missing / (6.0 * band);
    }
    *first = -k * (missing - 0.5 * band);
    *second = k;
    return k * (0.5 * missing * (missing - band) + band * band / 6.0);
}

/* At every sample: the hinge and the potential summed over all pairs (samples, 2), and where asked for the derivatives of both
together, (samples, nv) and (samples, nv, nv). */
void eo_clearance_penalty(const Arm *arm, const Scene *scene, const Placed *at, double *energy, double *gradient, double *hessian) {
    long nv = arm->nv;
    double most = scene->margin, reach = fmax(most + scene->band, scene->gain > 0 ? scene->safe : 0.0);
    int bent = gradient != 0;
    Load loads[arm->links + 1];
    unsigned char touched[arm->links + 1];
    memset(energy, 0, 2 * scene->samples * sizeof *energy);
    if (bent) {
        memset(gradient, 0, scene->samples * nv * sizeof *gradient);
        memset(hessian, 0, scene->samples * nv * nv * sizeof *hessian);
    }
    for (long k = 0; k < scene->samples; k++) {
        const double *center = at->center + 3 * k * arm->spheres, *middle = at->link_center + 3 * k * arm->links;
        double *e = energy + 2 * k, f1, f2, s1, s2, f[3], G[9], back[3];
        Distance x;
        if (bent) memset(loads, 0, arm->links * sizeof *loads);
        memset(touched, 0, sizeof touched);
        for (long l = 0; l < arm->links; l++)
            for (long o = 0; o < scene->obstacles; o++) {
                if (!scene->watched[l * scene->obstacles + o]) continue;
                if (surely_far(scene, k, o, middle + 3 * l, arm->link_radius[l] + reach)) continue;
                obstacle_distance(scene, k, o, middle + 3 * l, 0, &x);
                if (x.d - arm->link_radius[l] >= reach) continue;
                for (long s = arm->link_start[l]; s < arm->link_start[l + 1]; s++) {
                    const double *c = center + 3 * s;
                    if (surely_far(scene, k, o, c, arm->radius[s] + reach)) continue;
                    obstacle_distance(scene, k, o, c, 0, &x);
                    double d = x.d - arm->radius[s];
                    if (d >= reach) continue;
                    e[0] += hinge(scene, d, scene->required[s * scene->obstacles + o], &f1, &s1);
                    e[1] += potential(scene, d, &f2, &s2);
                    if (!bent || (s1 == 0 && s2 == 0)) continue;
                    obstacle_distance(scene, k, o, c, 1, &x);
                    stiffness_of(&x, f1 + f2, s1 + s2, f, G);
                    add_force(c, f, loads + l);
                    add_stiffness(c, c, G, 1.0, loads[l].K);
                    touched[l] = 1;
                }
            }
        for (long p = 0; p < arm->self_pairs && scene->stiffness > 0; p++) {
            long l = arm->self_pair[2 * p], m = arm->self_pair[2 * p + 1];
            const double *u = middle + 3 * l, *v = middle + 3 * m;
            double away[3] = {u[0] - v[0], u[1] - v[1], u[2] - v[2]}, between[36] = {0};
            double wide = arm->link_radius[l] + arm->link_radius[m] + most + scene->band;
            int any = 0;
            if (dot(away, away) >= wide * wide) continue;
            for (long s = arm->link_start[l]; s < arm->link_start[l + 1]; s++)
                for (long r = arm->link_start[m]; r < arm->link_start[m + 1]; r++) {
                    const double *a = center + 3 * s, *b = center + 3 * r;
                    double need = scene->required_self[s * arm->spheres + r] + scene->band;
                    double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]}, sum = arm->radius[s] + arm->radius[r] + need;
                    if (sum <= 0 || dot(d, d) >= sum * sum) continue;
                    sphere_pair(arm, center, s, r, &x);
                    e[0] += hinge(scene, x.d, need - scene->band, &f1, &s1);
                    if (!bent) continue;
                    stiffness_of(&x, f1, s1, f, G);
                    for (int i = 0; i < 3; i++) back[i] = -f[i];
                    add_force(a, f, loads + l);
                    add_force(b, back, loads + m);
                    add_stiffness(a, a, G, 1.0, loads[l].K);
                    add_stiffness(b, b, G, 1.0, loads[m].K);
                    add_stiffness(a, b, G, -1.0, between);
                    any = 1;
                }
            if (!any) continue;
            touched[l] = touched[m] = 1;
            settle_between(arm, at, k, arm->link_joint[l], arm->link_joint[m], between, hessian + k * nv * nv);
        }
        for (long l = 0; l < arm->links; l++)
            if (bent && touched[l]) settle(arm, at, k, arm->link_joint[l], loads + l, gradient + k * nv, hessian + k * nv * nv);
    }
}

/* For every link and obstacle (samples, links * obstacles), then every pair of links (samples, self_pairs): the least of distance
minus requirement over their spheres, and the pair (a, b) where it is least. Beyond `cutoff` a lower bound, and a = -1. */
void eo_clearance_least(const Arm *arm, const Scene *scene, const Placed *at, double cutoff, double *least, long *pair) {
    double most = scene->margin;
    long width = arm->links * scene->obstacles + arm->self_pairs;
    Distance x;
    for (long k = 0; k < scene->samples; k++) {
        const double *center = at->center + 3 * k * arm->spheres, *middle = at->link_center + 3 * k * arm->links;
        double *out = least + k * width;
        long *which = pair + 2 * k * width;
        for (long l = 0; l < arm->links; l++)
            for (long o = 0; o < scene->obstacles; o++, out++, which += 2) {
                which[0] = -1, which[1] = o, *out = INFINITY;
                if (!scene->watched[l * scene->obstacles + o]) continue;
                obstacle_distance(scene, k, o, middle + 3 * l, 0, &x);
                double bound = x.d - arm->link_radius[l] - most;
                if (bound >= cutoff) {
                    *out = bound;
                    continue;
                }
                for (long s = arm->link_start[l]; s < arm->link_start[l + 1]; s++) {
                    obstacle_distance(scene, k, o, center + 3 * s, 0, &x);
                    double d = x.d - arm->radius[s] - scene->required[s * scene->obstacles + o];
                    if (d < *out) *out = d, which[0] = s;
                }
            }
        for (long p = 0; p < arm->self_pairs; p++, out++, which += 2) {
            long l = arm->self_pair[2 * p], m = arm->self_pair[2 * p + 1];
            double away[3] = {middle[3 * l] - middle[3 * m], middle[3 * l + 1] - middle[3 * m + 1], middle[3 * l + 2] - middle[3 * m + 2]};
            double bound = sqrt(dot(away, away)) - arm->link_radius[l] - arm->link_radius[m] - most;
            which[0] = -1, which[1] = 0, *out = bound >= cutoff ? bound : INFINITY;
            if (bound >= cutoff) continue;
            for (long s = arm->link_start[l]; s < arm->link_start[l + 1]; s++)
                for (long r = arm->link_start[m]; r < arm->link_start[m + 1]; r++) {
                    double v[3];
                    for (int i = 0; i < 3; i++) v[i] = center[3 * s + i] - center[3 * r + i];
                    double rest = arm->radius[s] + arm->radius[r] + scene->required_self[s * arm->spheres + r];
                    double reach = *out + rest;
                    if (reach <= 0 || dot(v, v) >= reach * reach) continue;
                    *out = sqrt(dot(v, v)) - rest, which[0] = s, which[1] = -1 - r;
                }
        }
    }
}
