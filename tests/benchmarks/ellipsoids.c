/* Rays through four ellipsoids in cells, as one would write it in C: arrays in, arrays out. See c_kernel.py.

   The arithmetic and the conditions are those of clacad/tracing/compiled/straight_path.py and launch.py for lattices of squares and
   lenses that stand alone: blocks in the first-level cache, two loops a face, two roots and two divisions, a launch without
   rounding. Rays that fail a condition are marked UNDECIDED and not traced further. */

#include <math.h>
#include <stdint.h>

enum { BLOCK = 256, UNDECIDED = 255 };

typedef struct {
    double cx, cy, kappa, side, vx, vy, vz, climb, before, after; /* apex from the cell's centre and the body's level */
    double high, mid_x, mid_y, inner_x, inner_y, square;          /* end of the lens; where the body is for certain */
} Face;

typedef struct {
    double pitch_x, pitch_y, n1, n2, margin;
    double level[2], low[2]; /* of the bodies: reference plane, and where each begins above it */
} Sheet;

typedef struct {
    double x[BLOCK], y[BLOCK], z[BLOCK], u[BLOCK], v[BLOCK], w[BLOCK];
    double root[BLOCK], path[BLOCK], good[BLOCK], ci[BLOCK], cj[BLOCK], i0[BLOCK], j0[BLOCK];
} Block;

static inline double least(double a, double b) { return b < a ? b : a; }

static void cross(const Face *f, const Sheet *s, Block *k, long m, double ox, double oy, double oz) {
    const double mu = f->before / f->after;
    const double weight = (f->after - f->before) / f->after * ((f->after + f->before) / f->after);
    const double hx = 0.5 * s->pitch_x - s->margin, hy = 0.5 * s->pitch_y - s->margin;
    const double sx = -f->side * f->cx, sy = -f->side * f->cy, sk = f->side * f->kappa;
    ox -= f->vx, oy -= f->vy, oz -= f->vz;
#pragma GCC ivdep
    for (long i = 0; i < m; i++) {
        const double u = k->u[i], v = k->v[i], w = k->w[i], down = k->z[i] + oz;
        const double px = w * (k->x[i] + ox) - down * u, py = w * (k->y[i] + oy) - down * v;
        const double a = f->cx * u * u + f->cy * v * v + f->kappa * w * w;
        const double b = f->cx * px * u + f->cy * py * v - f->side * w * w;
        const double c = f->cx * px * px + f->cy * py * py;
        const double r = sqrt(b * b - a * c), q = f->side * r - b, inverse = 1.0 / (w * q);
        k->x[i] = (px * q + c * u) * inverse;
        k->y[i] = (py * q + c * v) * inverse;
        k->z[i] = c * w * inverse;
        k->root[i] = r * q * inverse;
        k->path[i] += f->before * ((c - down * q) * inverse);
    }
#pragma GCC ivdep
    for (long i = 0; i < m; i++) {
        const double gx = sx * k->x[i], gy = sy * k->y[i], gz = 1.0 - sk * k->z[i], incident = mu * k->root[i];
        const double g = weight / (sqrt((gx * gx + gy * gy + gz * gz) * weight + incident * incident) + incident);
        const double up = mu * k->w[i] + g * gz;
        k->u[i] = mu * k->u[i] + g * gx;
        k->v[i] = mu * k->v[i] + g * gy;
        k->w[i] = up;
        const double inside = least(hx - fabs(k->x[i] + f->vx), hy - fabs(k->y[i] + f->vy));
        k->good[i] = least(least(k->good[i], inside), least(gz, up - f->climb));
    }
    const double end = f->high - f->vz, across = s->n1 - 1.0, along = s->n2 - 1.0;
#pragma GCC ivdep
    for (long i = 0; i < m; i++) {
        const double w = k->w[i], rise = end - k->z[i], x = k->x[i] + f->vx, y = k->y[i] + f->vy;
        const double e = hx * w - fabs(x * w + rise * k->u[i]), g = hy * w - fabs(y * w + rise * k->v[i]);
        const double p = (2.0 * k->ci[i] - across) * (0.5 * s->pitch_x) + x - f->mid_x;
        const double q = (2.0 * k->cj[i] - along) * (0.5 * s->pitch_y) + y - f->mid_y;
        const double over = least(least(f->inner_x - fabs(p), f->inner_y - fabs(q)), f->square - (p * p + q * q));
        k->good[i] = least(least(k->good[i], least(e, g)), over);
    }
}

static void arrive(const Face *f, const Sheet *s, Block *k, long m) {
    const double n1 = s->n1 - 0.5, n2 = s->n2 - 0.5, hx = 0.5 * s->pitch_x, hy = 0.5 * s->pitch_y;
#pragma GCC ivdep
    for (long i = 0; i < m; i++) {
        const double held = least(least(k->ci[i] + 0.5, n1 - k->ci[i]), least(k->cj[i] + 0.5, n2 - k->cj[i]));
        const double local = least(hx - fabs(k->x[i]), hy - fabs(k->y[i]));
        k->good[i] = least(least(k->good[i], k->w[i] - f->climb), least(held, local));
    }
}

static void carry(const Sheet *s, Block *k, long m, double ox, double oy, double rise, double level) {
    const double per_x = 1.0 / s->pitch_x, per_y = 1.0 / s->pitch_y;
#pragma GCC ivdep
    for (long i = 0; i < m; i++) {
        const double t = (rise - k->z[i]) / k->w[i];
        const double x = k->x[i] + ox + t * k->u[i], y = k->y[i] + oy + t * k->v[i];
        const double a = floor(x * per_x + 0.5), b = floor(y * per_y + 0.5);
        k->x[i] = x - a * s->pitch_x, k->y[i] = y - b * s->pitch_y, k->z[i] = level;
        k->ci[i] += a, k->cj[i] += b, k->path[i] += t;
    }
}

static inline double two_sum(double a, double b, double *rest) {
    const double s = a + b, t = s - a;
    *rest = (a - (s - t)) + (b - t);
    return s;
}

static void launch(const Sheet *s, Block *k, long m) {
    const double per_x = 1.0 / s->pitch_x, per_y = 1.0 / s->pitch_y, plane = s->level[0] + s->low[0];
    const double hx = 0.5 * s->pitch_x, hy = 0.5 * s->pitch_y;
#pragma GCC ivdep
    for (long i = 0; i < m; i++) {
        const double u = k->u[i], v = k->v[i], w = k->w[i], square = u * u + v * v + w * w, per = 1.0 / w;
        double under, low_x, low_y;
        const double top = two_sum(plane, -k->z[i], &under), step = top * per;
        const double rest = (fma(-step, w, top) + under) * per;
        double h = step * u;
        const double x = two_sum(h, k->x[i], &low_x);
        low_x += fma(step, u, -h) + rest * u;
        h = step * v;
        const double y = two_sum(h, k->y[i], &low_y);
        low_y += fma(step, v, -h) + rest * v;
        const double a = floor(x * per_x + 0.5 * s->n1), b = floor(y * per_y + 0.5 * s->n2);
        k->x[i] = fma(s->n1 - 1.0 - 2.0 * a, hx, x) + low_x, k->y[i] = fma(s->n2 - 1.0 - 2.0 * b, hy, y) + low_y;
        k->z[i] = s->low[0], k->ci[i] = k->i0[i] = a, k->cj[i] = k->j0[i] = b, k->path[i] = step;
        k->good[i] = least(w, 1e-15 - fabs(square - 1.0)); /* directions come with length 1 */
    }
}

void trace(const Face *faces, const Sheet *sheet, long n, const double *position, const double *direction, double *out_position,
           double *out_direction, uint8_t *fate, double *path, int32_t *cell, int32_t *order, int32_t *surface) {
    Block k;
    for (long first = 0; first < n; first += BLOCK) {
        const long m = n - first < BLOCK ? n - first : BLOCK;
        const double *p = position + 3 * first, *d = direction + 3 * first;
        for (long i = 0; i < m; i++) {
            k.x[i] = p[3 * i], k.y[i] = p[3 * i + 1], k.z[i] = p[3 * i + 2];
            k.u[i] = d[3 * i], k.v[i] = d[3 * i + 1], k.w[i] = d[3 * i + 2];
        }
        launch(sheet, &k, m);
        arrive(faces, sheet, &k, m);
        cross(faces, sheet, &k, m, 0.0, 0.0, 0.0);
        for (long i = 0; i < m; i++) k.good[i] = least(k.good[i], k.path[i]);
        cross(faces + 1, sheet, &k, m, faces[0].vx, faces[0].vy, faces[0].vz);
        const double fall = sheet->level[0] - sheet->level[1] + faces[1].vz;
        carry(sheet, &k, m, faces[1].vx, faces[1].vy, sheet->low[1] - fall, sheet->low[1]);
        arrive(faces + 2, sheet, &k, m);
        cross(faces + 2, sheet, &k, m, 0.0, 0.0, 0.0);
        cross(faces + 3, sheet, &k, m, faces[2].vx, faces[2].vy, faces[2].vz);
        const double top = sheet->level[1] + faces[3].vz;
        double *q = out_position + 3 * first, *e = out_direction + 3 * first;
        for (long i = 0; i < m; i++) {
            q[3 * i] = (k.ci[i] - 0.5 * (sheet->n1 - 1.0)) * sheet->pitch_x + k.x[i] + faces[3].vx;
            q[3 * i + 1] = (k.cj[i] - 0.5 * (sheet->n2 - 1.0)) * sheet->pitch_y + k.y[i] + faces[3].vy;
            q[3 * i + 2] = k.z[i] + top;
            e[3 * i] = k.u[i], e[3 * i + 1] = k.v[i], e[3 * i + 2] = k.w[i];
        }
        for (long i = 0; i < m; i++) {
            const int32_t a = (int32_t)k.i0[i], b = (int32_t)k.j0[i];
            const int32_t over = (int32_t)k.ci[i] - a, up = (int32_t)k.cj[i] - b;
            path[first + i] = k.path[i], surface[first + i] = 3;
            cell[2 * (first + i)] = a, cell[2 * (first + i) + 1] = b;
            order[2 * (first + i)] = over, order[2 * (first + i) + 1] = up;
            fate[first + i] = k.good[i] > 0.0 ? (over == 0 && up == 0 ? 0 : 1) : UNDECIDED;
        }
    }
}
