/* Which links of a robot, covered by balls, come near obstacles and near one another, at many configurations.

   For every configuration: the placements of the joints; a ball around each link against each obstacle and each other
   link; only where these overlap, the balls that cover the link, until one overlaps. The structure is filled in by
   overlaps.py; lengths in metres, matrices row by row, poses as rotation (9) and position (3).

   Why not the distances of collision.c: that answers how far, for the optimiser, and has to look at every ball; a search asks
   only whether, thousands of times, and an answer here, which stops at the first ball that is near, takes a third of the time. */

#include <math.h>
#include <stdint.h>

typedef struct {
    int64_t joints, links, obstacles, link_pairs;
    /* joints: parent, kind (0 turns, 1 slides), column of q, rotation and position in the parent, axis */
    const int64_t *parent, *slides, *column;
    const double *placement, *axis;
    /* links: joint, ball around all of it, first ball that covers it (links + 1 entries); balls: centre, radius */
    const int64_t *joint, *first;
    const double *around, *ball;
    /* obstacles: kind, four sizes, first plane (obstacles + 1 entries); planes: normal, offset */
    const int64_t *kind, *first_plane;
    const double *size, *plane;
    /* pairs of links */
    const int64_t *pair;
    int64_t columns;
} Scene;

enum { BALL, CAPSULE, BOX, CYLINDER, HALF_SPACE, HULL };

#define MOST 256

/* fmax is a library call where values might be NaN. */
static inline double larger(double a, double b) { return a > b ? a : b; }

static double corner(double a, double b, double c)
{
    double x = a > 0 ? a : 0, y = b > 0 ? b : 0, z = c > 0 ? c : 0;
    double inside = larger(a, larger(b, c));
    return inside < 0 ? inside : sqrt(x * x + y * y + z * z);
}

/* Signed distance of a point to an obstacle; of a hull, the largest of the distances to its planes, which is no more. */
static double distance(const Scene *s, int64_t o, const double *pose, const double *p)
{
    double w[3] = {p[0] - pose[9], p[1] - pose[10], p[2] - pose[11]}, y[3];
    for (int i = 0; i < 3; i++)
        y[i] = pose[i] * w[0] + pose[3 + i] * w[1] + pose[6 + i] * w[2];
    const double *size = s->size + 4 * o;
    switch (s->kind[o]) {
    case BALL:
        return sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]) - size[0];
    case CAPSULE: {
        double along = larger(fabs(y[2]) - size[1], 0);
        return sqrt(y[0] * y[0] + y[1] * y[1] + along * along) - size[0];
    }
    case BOX:
        return corner(fabs(y[0]) - size[0], fabs(y[1]) - size[1], fabs(y[2]) - size[2]);
    case CYLINDER: {
        double radial = sqrt(y[0] * y[0] + y[1] * y[1]) - size[0], along = fabs(y[2]) - size[1];
        return corner(radial, along, -INFINITY);
    }
    case HALF_SPACE:
        return y[0] * size[0] + y[1] * size[1] + y[2] * size[2] - size[3];
    default: {
        double most = -INFINITY;
        for (int64_t f = s->first_plane[o]; f < s->first_plane[o + 1]; f++) {
            const double *n = s->plane + 4 * f;
            most = larger(most, n[0] * y[0] + n[1] * y[1] + n[2] * y[2] - n[3]);
        }
        return most;
    }
    }
}

static void moved(const double *pose, const double *c, double *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = pose[3 * i] * c[0] + pose[3 * i + 1] * c[1] + pose[3 * i + 2] * c[2] + pose[9 + i];
}

/* R of a turn by an angle about a unit axis (Rodrigues). */
static void turn(const double *u, double angle, double *r)
{
    double c = cos(angle), s = sin(angle), v = 1 - c;
    r[0] = c + v * u[0] * u[0], r[1] = v * u[0] * u[1] - s * u[2], r[2] = v * u[0] * u[2] + s * u[1];
    r[3] = v * u[0] * u[1] + s * u[2], r[4] = c + v * u[1] * u[1], r[5] = v * u[1] * u[2] - s * u[0];
    r[6] = v * u[0] * u[2] - s * u[1], r[7] = v * u[1] * u[2] + s * u[0], r[8] = c + v * u[2] * u[2];
}

static void product(const double *a, const double *b, double *out)
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            out[3 * i + k] = a[3 * i] * b[k] + a[3 * i + 1] * b[3 + k] + a[3 * i + 2] * b[6 + k];
}

static void place_joints(const Scene *s, const double *q, double (*pose)[12])
{
    for (int i = 0; i < 12; i++)
        pose[0][i] = i == 0 || i == 4 || i == 8;
    for (int64_t j = 1; j < s->joints; j++) {
        const double *up = pose[s->parent[j]], *place = s->placement + 12 * j, *axis = s->axis + 3 * j;
        double angle = q[s->column[j]], r[9];
        moved(up, place + 9, pose[j] + 9);
        if (s->slides[j]) {
            product(up, place, pose[j]);
            for (int i = 0; i < 3; i++)
                pose[j][9 + i] += angle * (pose[j][3 * i] * axis[0] + pose[j][3 * i + 1] * axis[1] + pose[j][3 * i + 2] * axis[2]);
        } else {
            double still[9];
            product(up, place, still);
            turn(axis, angle, r);
            product(still, r, pose[j]);
        }
    }
}

static double apart(const double *a, const double *b)
{
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

/* flags[n, k] = 1 where the balls of column k are nearer than the margin: links against obstacles, link by link, then pairs.
   poses: of the obstacles, one set a configuration where they move (stride 12 · obstacles), else one for all (stride 0).
   work: room for the centres of all balls. At most MOST joints and links. */
void overlaps(const Scene *s, int64_t count, const double *q, int64_t nv, const double *poses, int64_t stride, double margin,
             double *work, uint8_t *flags)
{
    double pose[MOST][12], around[MOST][3];
    uint8_t ready[MOST];
    for (int64_t n = 0; n < count; n++) {
        uint8_t *flag = flags + n * s->columns;
        const double *obstacle = poses + n * stride;
        place_joints(s, q + n * nv, pose);
        for (int64_t l = 0; l < s->links; l++) {
            moved(pose[s->joint[l]], s->around + 4 * l, around[l]);
            ready[l] = 0;
        }
#define CENTRES(l)                                                                              \
    if (!ready[l]) {                                                                            \
        for (int64_t b = s->first[l]; b < s->first[(l) + 1]; b++)                               \
            moved(pose[s->joint[l]], s->ball + 4 * b, work + 3 * b);                            \
        ready[l] = 1;                                                                           \
    }
        for (int64_t l = 0; l < s->links; l++)
            for (int64_t o = 0; o < s->obstacles; o++, flag++) {
                *flag = 0;
                if (s->joint[l] == 0 || distance(s, o, obstacle + 12 * o, around[l]) > s->around[4 * l + 3] + margin)
                    continue;
                CENTRES(l)
                for (int64_t b = s->first[l]; b < s->first[l + 1] && !*flag; b++)
                    *flag = distance(s, o, obstacle + 12 * o, work + 3 * b) <= s->ball[4 * b + 3] + margin;
            }
        for (int64_t k = 0; k < s->link_pairs; k++, flag++) {
            int64_t i = s->pair[2 * k], j = s->pair[2 * k + 1];
            double reach = s->around[4 * i + 3] + s->around[4 * j + 3] + margin;
            *flag = 0;
            if (apart(around[i], around[j]) > reach * reach)
                continue;
            CENTRES(i)
            CENTRES(j)
            for (int64_t a = s->first[i]; a < s->first[i + 1] && !*flag; a++)
                for (int64_t b = s->first[j]; b < s->first[j + 1] && !*flag; b++) {
                    double r = s->ball[4 * a + 3] + s->ball[4 * b + 3] + margin;
                    *flag = apart(work + 3 * a, work + 3 * b) <= r * r;
                }
        }
    }
}
