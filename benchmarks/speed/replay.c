/* The replay of hydrojax/replay.py over windows of a log, and its Jacobian by forward
 * differences. LANES windows run side by side; all arrays of windows are [tick][window],
 * with the number of windows a multiple of LANES. */
#include "model.h"

#define PARTS 4
#define QUARTERS 4
#define ONE(x) REAL x;
#define SPOOL(X) X(yy) X(yr) X(ry) X(rr) X(m_y) X(m_r) X(L_rate)
#define NUMBERS(X) PLANT(X) SPOOL(X)

typedef struct { NUMBERS(ONE) } Numbers;
enum { COUNT_NUMBERS = 0 NUMBERS(COUNT) };

typedef struct {
    int windows, ticks, substeps, before, segments, length, lag, threads;
    const REAL *u, *h, *P_s, *P_r, *v; /* [ticks][windows] */
    const REAL *x;                     /* [ticks - 1][2 substeps + 1][windows] */
    const REAL *earlier;               /* [before][windows] */
    const REAL *P_0;                   /* [2][windows] */
    const REAL *dx, *tick, *speed0;    /* [segments][length - 1][4], [..], [segments] */
    const int *from;                   /* [windows]: first tick in all segments */
    REAL *room;                        /* [2 room_for()]: one to be kept, one to move */
} Log;

/* What one replay needs room for; z and speed are [ticks][windows]. */
typedef struct { REAL *z, *speed, *course_z, *course_speed, *keep, *add; } Room;

enum Stage { READINGS, PRESSURES, FRICTION };

const char *replay_numbers(void) { return NUMBERS(STRING); }

long room_for(const Log *g) {
    return 2L * g->ticks * g->windows + 2L * g->segments * g->length
         + 2L * QUARTERS * g->length;
}

static Room room(const Log *g, int which) {
    long window = (long)g->ticks * g->windows, all = (long)g->segments * g->length;
    REAL *z = g->room + which * room_for(g), *course = z + 2 * window;
    REAL *keep = course + 2 * all;
    return (Room){z, z + window, course, course + all, keep, keep + QUARTERS * g->length};
}

/* Bristle and filtered speed along one segment: what each quarter of a tick keeps and
 * adds in vectors first, then the chain. */
static void segment(const Log *g, const Numbers *n, Room r, int s) {
    int steps = g->length - 1;
    const REAL *dx = g->dx + (size_t)s * steps * QUARTERS;
    const REAL *h = g->tick + (size_t)s * steps;
    REAL *z = r.course_z + (size_t)s * g->length;
    REAL *w = r.course_speed + (size_t)s * g->length;
    REAL per_z_ss = n->per_z_ss, z_ss = n->z_ss, L_rate = n->L_rate;
    REAL *keep = r.keep, *add = r.add, at = 0, speed = g->speed0[s];
#pragma omp simd
    for (int i = 0; i < steps * QUARTERS; i++) {
        REAL fade = exponential(-absolute(dx[i]) * per_z_ss);
        keep[i] = fade;
        add[i] = (dx[i] < 0 ? -z_ss : z_ss) * (1 - fade);
    }
    z[0] = at;
    w[0] = speed;
    for (int i = 0; i < steps; i++) {
        REAL fade = exponential(-L_rate * h[i] / QUARTERS);
        REAL per_quarter = (1 - fade) * QUARTERS / h[i];
        for (int q = QUARTERS * i; q < QUARTERS * (i + 1); q++) {
            at = keep[q] * at + add[q];
            speed = fade * speed + per_quarter * absolute(dx[q]);
        }
        z[i + 1] = at;
        w[i + 1] = speed;
    }
}

/* The same at the windows' ticks, side by side. */
static void friction_memory(const Log *g, const Numbers *n, Room r) {
    for (int s = 0; s < g->segments; s++) segment(g, n, r, s);
    for (int first = 0; first < g->windows; first += LANES)
        for (int i = 0; i < g->ticks; i++)
            for (int k = 0; k < LANES; k++) {
                int from = g->from[first + k] + i;
                r.z[(size_t)i * g->windows + first + k] = r.course_z[from];
                r.speed[(size_t)i * g->windows + first + k] = r.course_speed[from];
            }
}

/* The mean openings toward either side over one tick under a held command. */
INLINE void pass(
    const Numbers *n, int lag, REAL u, REAL *y, REAL *rate, REAL *open_p, REAL *open_n
) {
    if (!lag) {
        *open_p = most(u, 0);
        *open_n = most(-u, 0);
        return;
    }
    REAL sum_p = 0, sum_n = 0;
    for (int part = 0; part < PARTS; part++) {
        REAL off = *y - u, r = *rate;
        REAL off_new = n->yy * off + n->yr * r, rate_new = n->ry * off + n->rr * r;
        REAL mean = u + n->m_y * (off - off_new) + n->m_r * (r - rate_new);
        *y = u + off_new;
        *rate = rate_new;
        sum_p += most(mean, 0);
        sum_n += most(-mean, 0);
    }
    *open_p = sum_p / PARTS;
    *open_n = sum_n / PARTS;
}

/* Both rates; without a spool one side is shut, and half of the roots are not taken. */
INLINE void rates(
    const Numbers *n, int lag, REAL open_p, REAL open_n, REAL P_1, REAL P_2, REAL P_s,
    REAL P_r, REAL x, REAL v, REAL *rate_1, REAL *rate_2
) {
    REAL q_1, q_2;
    if (lag) {
        q_1 = n->d_p1 * open_p * root_flow(P_s - P_1)
            - n->d_n1 * open_n * root_flow(P_1 - P_r);
        q_2 = n->d_p2 * open_n * root_flow(P_s - P_2)
            - n->d_n2 * open_p * root_flow(P_2 - P_r);
    } else {
        int up = open_p > 0;
        REAL size = open_p + open_n;
        q_1 = size * (up ? n->d_p1 : n->d_n1) * root_flow(up ? P_s - P_1 : P_r - P_1);
        q_2 = size * (up ? n->d_n2 : n->d_p2) * root_flow(up ? P_r - P_2 : P_s - P_2);
    }
    REAL x_1 = n->half_1 - x, x_2 = n->half_2 + x, stiff = n->beta / (x_1 * x_2);
    *rate_1 = stiff * x_2 * (q_1 + v);
    *rate_2 = stiff * x_1 * (q_2 - v);
}

/* Twice the slopes by which both settle, 1/s. */
INLINE void settling(
    const Numbers *n, int lag, REAL open_p, REAL open_n, REAL P_1, REAL P_2, REAL P_s,
    REAL P_r, REAL x, REAL *b_1, REAL *b_2
) {
    if (lag) {
        *b_1 = n->d_p1 * open_p * root_slope(P_s - P_1)
             + n->d_n1 * open_n * root_slope(P_1 - P_r);
        *b_2 = n->d_p2 * open_n * root_slope(P_s - P_2)
             + n->d_n2 * open_p * root_slope(P_2 - P_r);
    } else {
        int up = open_p > 0;
        REAL size = open_p + open_n;
        *b_1 = size * (up ? n->d_p1 : n->d_n1) * root_slope((up ? P_s : P_r) - P_1);
        *b_2 = size * (up ? n->d_n2 : n->d_p2) * root_slope((up ? P_r : P_s) - P_2);
    }
    REAL x_1 = n->half_1 - x, x_2 = n->half_2 + x, stiff = 2 * n->beta / (x_1 * x_2);
    *b_1 *= stiff * x_2;
    *b_2 *= stiff * x_1;
}

/* One group of windows: at each tick the spool, then the exponential midpoint rule in
 * substeps. */
INLINE void group(const Log *g, const Numbers *numbers, int lag, int first, REAL *out) {
    const Numbers copy = *numbers, *n = &copy;
    const int W = g->windows, substeps = g->substeps;
    const REAL *before = (g->before ? g->earlier : g->u) + first;
    REAL P_1[LANES], P_2[LANES], y[LANES], rate[LANES], open_p[LANES], open_n[LANES];
    REAL *out_1 = out + first, *out_2 = out + (size_t)g->ticks * W + first;
    OVER_LANES(k) {
        P_1[k] = out_1[k] = g->P_0[first + k];
        P_2[k] = out_2[k] = g->P_0[W + first + k];
        y[k] = before[k];
        rate[k] = 0;
    }
    for (int i = 0; lag && i < g->before; i++, before += W)
        OVER_LANES(k) pass(n, 1, before[k], &y[k], &rate[k], &open_p[k], &open_n[k]);
    for (int i = 0; i < g->ticks - 1; i++) {
        const size_t at = (size_t)i * W + first;
        const REAL *u = g->u + at, *h = g->h + at, *P_s = g->P_s + at, *P_r = g->P_r + at;
        const REAL *x = g->x + (size_t)i * (2 * substeps + 1) * W + first;
        OVER_LANES(k) pass(n, lag, u[k], &y[k], &rate[k], &open_p[k], &open_n[k]);
        for (int sub = 0; sub < substeps; sub++, x += 2 * W) {
            REAL per = (REAL)0.5 / substeps, part = 2 * sub * per;
            OVER_LANES(k) {
                REAL step = h[k] / substeps, v = (x[2 * W + k] - x[k]) / step, a_1, a_2;
                REAL ds = P_s[W + k] - P_s[k], db = P_r[W + k] - P_r[k];
                REAL s = P_s[k] + part * ds, b = P_r[k] + part * db;
                rates(n, lag, open_p[k], open_n[k], P_1[k], P_2[k], s, b, x[k], v,
                      &a_1, &a_2);
                REAL b_1, b_2, half = step / 2;
                settling(n, lag, open_p[k], open_n[k], P_1[k], P_2[k], s, b, x[k], &b_1,
                         &b_2);
                REAL m_1 = half * relaxed(b_1 * half) * a_1;
                REAL m_2 = half * relaxed(b_2 * half) * a_2;
                rates(n, lag, open_p[k], open_n[k], P_1[k] + m_1, P_2[k] + m_2,
                      s + per * ds, b + per * db, x[W + k], v, &a_1, &a_2);
                P_1[k] += step * relaxed(b_1 * step) * (a_1 + b_1 * m_1);
                P_2[k] += step * relaxed(b_2 * step) * (a_2 + b_2 * m_2);
            }
        }
        OVER_LANES(k) {
            out_1[(size_t)(i + 1) * W + k] = P_1[k];
            out_2[(size_t)(i + 1) * W + k] = P_2[k];
        }
    }
}

static void pressures_of(const Log *g, const Numbers *n, int first, REAL *out) {
    if (g->lag) group(g, n, 1, first, out);
    else group(g, n, 0, first, out);
}

static void forces(const Log *g, const Numbers *numbers, Room r, REAL *out) {
    const Numbers n = *numbers;
    size_t size = (size_t)g->ticks * g->windows;
    const REAL *P_1 = out, *P_2 = out + size, *z = r.z, *speed = r.speed, *v = g->v;
    REAL *F = out + 2 * size;
#pragma omp simd
    for (size_t i = 0; i < size; i++) {
        REAL f_c = within(z[i] * n.per_z_ss, -1, 1) * (z[i] > 0 ? n.k_cp : n.k_cn) + n.k_0
                 - (v[i] > 0 ? n.k_vp : n.k_vn) * v[i];
        REAL P = n.act_2 * P_2[i] - n.act_1 * P_1[i], L = switched(speed[i], n.L_slope);
        F[i] = output_force(P, f_c, L, n.k_fp, n.k_fn, n.delta);
    }
}

/* P_a1, P_a2, F, [3][ticks][windows], into `out`. */
void run_replay(const Log *g, const Numbers *n, REAL *out) {
    Room r = room(g, 0);
    friction_memory(g, n, r);
#pragma omp parallel for schedule(static) num_threads(g->threads)
    for (int first = 0; first < g->windows; first += LANES)
        pressures_of(g, n, first, out);
    forces(g, n, r, out);
}

/* (replay at numbers[1 + j] - replay at numbers[0]) / step[j], [count][3][ticks]
 * [windows], into `out`; `stage[j]` says where the parameter first comes in. */
void run_jacobian(
    const Log *g, const Numbers *n, const int *stage, const REAL *step, int count,
    REAL *base, REAL *out
) {
    size_t size = (size_t)g->ticks * g->windows;
    Room at = room(g, 0);
    run_replay(g, n, base);
#pragma omp parallel for schedule(dynamic) num_threads(g->threads)
    for (int j = 0; j < count; j++) {
        REAL *here = out + 3 * size * j;
        Room r = at;
        if (stage[j] == FRICTION) {
            r = room(g, 1); /* one parameter only has this stage */
            friction_memory(g, n + 1 + j, r);
        }
        if (stage[j] == PRESSURES)
            for (int first = 0; first < g->windows; first += LANES)
                pressures_of(g, n + 1 + j, first, here);
        else memcpy(here, base, 2 * size * sizeof(REAL));
        forces(g, n + 1 + j, r, here);
        REAL per = 1 / step[j];
#pragma omp simd
        for (size_t i = 0; i < 3 * size; i++) here[i] = (here[i] - base[i]) * per;
    }
}
