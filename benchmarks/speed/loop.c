/* The closed loop of hydrojax/loop.py: sensors, law, spool, plant, driven load.
 *
 * Groups of LANES instances run side by side, one group to a thread at a time. A spool
 * opens one side or the other, so that of four edges two draw: half the roots. What
 * depends on the motion alone is worked out once for all instances where they agree in
 * the numbers that it takes (a sweep of gains does), and lane by lane where not. */
#include "model.h"
#include <stdlib.h>

#define PARTS 4
#define QUEUE 16 /* commands back: 48 parts of a delay, and the one that is held */
#define KEPT 13
#define NAME(x) #x,

#define NINE(X) X(k_1) X(A_a) X(k_cp) X(k_cn) X(k_0) X(k_vp) X(k_vn) X(k_fp) X(k_fn)

#define LAW_OWN(X) \
    X(n_act_1) X(n_act_2) X(n_half_1) X(n_half_2) X(n_z_ss) X(n_per_z_ss) \
    X(n_delta) X(n_L_slope) X(n_keep) X(chi_1) X(chi_2) X(up_1) X(up_2) \
    X(down_1) X(down_2) X(k_p) X(k_f) X(u_max) X(tau_d) X(tau_v) X(P_return) X(P_start) \
    X(noise_P_a1) X(noise_P_a2) X(noise_P_s) X(noise_F) X(noise_step)
#define ADAPTED(X) \
    X(rate_k_1) X(rate_A_a) X(rate_k_cp) X(rate_k_cn) X(rate_k_0) X(rate_k_vp) \
    X(rate_k_vn) X(rate_k_fp) X(rate_k_fn) \
    X(lower_k_1) X(lower_A_a) X(lower_k_cp) X(lower_k_cn) X(lower_k_0) X(lower_k_vp) \
    X(lower_k_vn) X(lower_k_fp) X(lower_k_fn) \
    X(upper_k_1) X(upper_A_a) X(upper_k_cp) X(upper_k_cn) X(upper_k_0) X(upper_k_vp) \
    X(upper_k_vn) X(upper_k_fp) X(upper_k_fn)
#define SPOOL(X) X(yy) X(yr) X(ry) X(rr) X(m_y) X(m_r) X(keep)
#define OF_MOTION(X) \
    X(half_1) X(half_2) X(beta) X(z_ss) X(per_z_ss) X(L_slope) X(keep) X(n_half_1) \
    X(n_half_2) X(n_z_ss) X(n_per_z_ss) X(n_L_slope) X(n_keep) X(chi_1) X(chi_2) \
    X(tau_v) X(noise_step)
#define NUMBERS(X) PLANT(X) SPOOL(X) LAW_OWN(X) ADAPTED(X)
#define STATE(X) \
    X(P_1) X(P_2) X(z) X(speed) X(y) X(rate) X(F) \
    X(seen_x) X(seen_v) X(seen_z) X(seen_speed) X(P_d) X(P_d_rate) X(u) X(error) \
    NINE(X)

typedef struct { NUMBERS(LANE) } __attribute__((aligned(64))) Numbers;
typedef struct { STATE(LANE) } __attribute__((aligned(64))) State;
typedef REAL Queue[QUEUE][LANES];
enum { COUNT_NUMBERS = 0 NUMBERS(COUNT) };

/* What all instances are given, by value: a pointer could point at their state, and
 * nothing would be vectorised. */
typedef struct { REAL h, F_d, x, noise[4], P_s; } Sample;
typedef struct { REAL h, v, dx, x[2], P_s[2], P_r[2]; } Part; /* at start and middle */

/* What the motion alone decides: what the law makes of the position, what it does to a
 * part (beta over the chambers' lengths, at start and middle), and to the force. */
typedef struct { REAL x_1, x_2, v, g, L, swept; } Seen; /* 1/x_1, 1/x_2 */
typedef struct { REAL stiff_1[2], stiff_2[2]; } Stiff;
typedef struct { REAL turn, L, v; } Felt;

const char *loop_numbers(void) { return NUMBERS(STRING); }

/* P_d of (24)(25) and the row of (26); returns P_d. Conditions that all lanes share are
 * factors: a branch would keep them from being vectors. */
INLINE REAL desired(const Numbers *n, const State *s, int k, Seen m, REAL F, REAL *row) {
    REAL slide = 1 - m.L, stick = m.L * F / (1 + n->n_delta[k] * absolute(F));
    REAL pull = F > 0;
    row[0] = slide * most(m.g, 0);
    row[1] = slide * least(m.g, 0);
    row[2] = slide;
    row[3] = -slide * most(m.v, 0);
    row[4] = -slide * least(m.v, 0);
    row[5] = pull * stick;
    row[6] = (1 - pull) * stick;
    return F + row[0] * s->k_cp[k] + row[1] * s->k_cn[k] + row[2] * s->k_0[k]
         + row[3] * s->k_vp[k] + row[4] * s->k_vn[k] + row[5] * s->k_fp[k]
         + row[6] * s->k_fn[k];
}

INLINE REAL quantised(REAL x, REAL step) {
    REAL size = step > 0 ? step : 1;
    REAL rounded = nearest(x / size) * size;
    return step > 0 ? rounded : x;
}

/* At rest at the first sample, with the desired force on the output. */
INLINE void begin(const Numbers *n, State *s, int k, Sample t, REAL v) {
    REAL F = t.F_d, row[7];
    REAL k_f = F > 0 ? n->k_fp[k] : n->k_fn[k];
    REAL P = F + k_f * F / (1 + n->delta[k] * absolute(F));
    s->P_1[k] = n->P_start[k];
    s->P_2[k] = (P + n->act_1[k] * n->P_start[k]) / n->act_2[k];
    s->z[k] = s->speed[k] = s->y[k] = s->rate[k] = s->error[k] = s->u[k] = 0;
    REAL f_c = n->k_0[k] - (v > 0 ? n->k_vp[k] : n->k_vn[k]) * v;
    P = n->act_2[k] * s->P_2[k] - n->act_1[k] * s->P_1[k];
    s->F[k] = output_force(P, f_c, 1, n->k_fp[k], n->k_fn[k], n->delta[k]);
    s->seen_x[k] = quantised(t.x, n->noise_step[k]);
    s->seen_v[k] = s->seen_z[k] = s->seen_speed[k] = s->P_d_rate[k] = 0;
#define MIDDLE(e) s->e[k] = (n->lower_##e[k] + n->upper_##e[k]) / 2;
    NINE(MIDDLE)
    s->P_d[k] = desired(n, s, k, (Seen){.L = 1}, F, row);
}

/* What the law makes of the position it reads. */
INLINE Seen see(const Numbers *n, State *s, int k, Sample t) {
    REAL x = quantised(t.x, n->noise_step[k]), h = t.h, keep = n->n_keep[k];
    REAL dx = x - s->seen_x[k];
    REAL v = (n->tau_v[k] * s->seen_v[k] + dx) / (n->tau_v[k] + h);
    REAL z = bristle(s->seen_z[k], dx, n->n_z_ss[k], n->n_per_z_ss[k]);
    REAL speed = keep * s->seen_speed[k] + (1 - keep) * absolute(dx) / h;
    REAL x_1 = n->n_half_1[k] - x, x_2 = n->n_half_2[k] + x;
    s->seen_x[k] = x;
    s->seen_v[k] = v;
    s->seen_z[k] = z;
    s->seen_speed[k] = speed;
    return (Seen){1 / x_1, 1 / x_2, v, within(z * n->n_per_z_ss[k], -1, 1),
                  switched(speed, n->n_L_slope[k]),
                  (n->chi_1[k] / x_1 + n->chi_2[k] / x_2) * v};
}

/* The law at one sample: (18), (23)-(30). */
INLINE void decide(const Numbers *n, State *s, int k, Sample t, Seen m) {
    REAL P_a1 = s->P_1[k] + n->noise_P_a1[k] * t.noise[0];
    REAL P_a2 = s->P_2[k] + n->noise_P_a2[k] * t.noise[1];
    REAL P_s = t.P_s + n->noise_P_s[k] * t.noise[2];
    REAL lack = t.F_d - (s->F[k] + n->noise_F[k] * t.noise[3]);
    REAL h = t.h, row[7];
    REAL P_d = desired(n, s, k, m, t.F_d, row);
    REAL gone = n->tau_d[k] * s->P_d_rate[k] + P_d - s->P_d[k];
    REAL P_d_rate = gone / (n->tau_d[k] + h);
    REAL P = n->n_act_2[k] * P_a2 - n->n_act_1[k] * P_a1;
    REAL miss = P_d - P;
    REAL virtual = s->k_1[k] * P_d_rate + s->A_a[k] * m.swept + n->k_p[k] * miss
                 + n->k_f[k] * lack;
    s->P_d[k] = P_d;
    s->P_d_rate[k] = P_d_rate;

#define LEARN(e, lead) \
    s->e[k] = within(s->e[k] + h * n->rate_##e[k] * (lead), n->lower_##e[k],    \
                     n->upper_##e[k]);
    LEARN(k_1, miss * P_d_rate)
    LEARN(A_a, miss * m.swept)
    LEARN(k_cp, lack * row[0])
    LEARN(k_cn, lack * row[1])
    LEARN(k_0, lack * row[2])
    LEARN(k_vp, lack * row[3])
    LEARN(k_vn, lack * row[4])
    LEARN(k_fp, lack * row[5])
    LEARN(k_fn, lack * row[6])

    REAL drop_1 = virtual < 0 ? P_s - P_a1 : P_a1 - n->P_return[k];
    REAL drop_2 = virtual < 0 ? P_a2 - n->P_return[k] : P_s - P_a2;
    REAL c_1 = virtual < 0 ? n->up_1[k] : n->down_1[k];
    REAL c_2 = virtual < 0 ? n->up_2[k] : n->down_2[k];
    REAL gain = c_1 * root(most(drop_1, (REAL)1e4)) * m.x_1
              + c_2 * root(most(drop_2, (REAL)1e4)) * m.x_2;
    s->u[k] = within(-virtual / gain, -n->u_max[k], n->u_max[k]);
}

/* The spool over one part under the command `u`: its mean opening. */
INLINE REAL pass(const Numbers *n, State *s, int k, REAL u) {
    REAL off = s->y[k] - u, rate = s->rate[k];
    REAL off_new = n->yy[k] * off + n->yr[k] * rate;
    REAL rate_new = n->ry[k] * off + n->rr[k] * rate;
    s->y[k] = u + off_new;
    s->rate[k] = rate_new;
    return u + n->m_y[k] * (off - off_new) + n->m_r[k] * (rate - rate_new);
}

/* What one side's opening gives: the two edges that draw. */
typedef struct { REAL up, c_1, c_2; } Edges;

INLINE Edges edges(const Numbers *n, int k, REAL opening) {
    REAL size = absolute(opening), up = opening > 0;
    return (Edges){
        up, size * (up ? n->d_p1[k] : n->d_n1[k]), size * (up ? n->d_n2[k] : n->d_p2[k])};
}

/* Both pressures' rates (12)-(15); flows are over the areas, m/s. */
INLINE void rates(
    Edges e, REAL P_1, REAL P_2, Part t, Stiff f, int at, REAL *rate_1, REAL *rate_2
) {
    REAL q_1 = e.c_1 * root_flow(e.up ? t.P_s[at] - P_1 : t.P_r[at] - P_1);
    REAL q_2 = e.c_2 * root_flow(e.up ? t.P_r[at] - P_2 : t.P_s[at] - P_2);
    *rate_1 = f.stiff_1[at] * (q_1 + t.v);
    *rate_2 = f.stiff_2[at] * (q_2 - t.v);
}

/* Twice the slopes by which both pressures settle, 1/s. */
INLINE void settling(Edges e, REAL P_1, REAL P_2, Part t, Stiff f, REAL *b_1, REAL *b_2) {
    *b_1 = 2 * f.stiff_1[0] * e.c_1 * root_slope((e.up ? t.P_s[0] : t.P_r[0]) - P_1);
    *b_2 = 2 * f.stiff_2[0] * e.c_2 * root_slope((e.up ? t.P_r[0] : t.P_s[0]) - P_2);
}

INLINE Stiff stiffness(const Numbers *n, int k, Part t) {
    Stiff f;
    for (int at = 0; at < 2; at++) {
        REAL x_1 = n->half_1[k] - t.x[at], x_2 = n->half_2[k] + t.x[at];
        REAL both = n->beta[k] / (x_1 * x_2);
        f.stiff_1[at] = both * x_2;
        f.stiff_2[at] = both * x_1;
    }
    return f;
}

/* The pressures over one part of a period, by the exponential midpoint rule. */
INLINE void act(const Numbers *n, State *s, int k, REAL opening, Part t, Stiff f) {
    REAL P_1 = s->P_1[k], P_2 = s->P_2[k], half = t.h / 2, a_1, a_2, b_1, b_2;
    Edges e = edges(n, k, opening);
    rates(e, P_1, P_2, t, f, 0, &a_1, &a_2);
    settling(e, P_1, P_2, t, f, &b_1, &b_2);
    REAL m_1 = half * relaxed(b_1 * half) * a_1, m_2 = half * relaxed(b_2 * half) * a_2;
    rates(e, P_1 + m_1, P_2 + m_2, t, f, 1, &a_1, &a_2);
    s->P_1[k] = P_1 + t.h * relaxed(b_1 * t.h) * (a_1 + b_1 * m_1);
    s->P_2[k] = P_2 + t.h * relaxed(b_2 * t.h) * (a_2 + b_2 * m_2);
}

/* Bristle and filtered speed over one part. */
INLINE void slide(const Numbers *n, State *s, int k, Part t) {
    REAL keep = n->keep[k];
    s->z[k] = bristle(s->z[k], t.dx, n->z_ss[k], n->per_z_ss[k]);
    s->speed[k] = keep * s->speed[k] + (1 - keep) * absolute(t.v);
}

INLINE Felt friction(const Numbers *n, const State *s, int k, REAL v) {
    return (Felt){within(s->z[k] * n->per_z_ss[k], -1, 1),
                  switched(s->speed[k], n->L_slope[k]), v};
}

/* The force at the period's end, where the load cell is read next. */
INLINE void feel(const Numbers *n, State *s, int k, Felt m) {
    REAL f_c = most(m.turn, 0) * n->k_cp[k] + least(m.turn, 0) * n->k_cn[k] + n->k_0[k]
             - most(m.v, 0) * n->k_vp[k] - least(m.v, 0) * n->k_vn[k];
    REAL P = n->act_2[k] * s->P_2[k] - n->act_1[k] * s->P_1[k];
    s->F[k] = output_force(P, f_c, m.L, n->k_fp[k], n->k_fn[k], n->delta[k]);
}

/* What the motion decides at one sample, for all instances alike. */
typedef struct { Seen seen; Stiff stiff[PARTS]; Felt felt; } Moved;

typedef struct {
    int instances, samples, whole, threads;
    REAL share, h;
    const REAL *numbers, *F_d, *noise, *P_s, *P_r, *x, *v;
    REAL *rms, *out; /* [instances]; [instances][samples][KEPT] or NULL */
    Moved *moved;    /* [samples], or NULL where the instances differ in it */
} Run;

static Sample sample(const Run *r, int i) {
    const REAL *w = r->noise + 4 * i;
    return (Sample){r->h, r->F_d[i], r->x[3 * PARTS * i], {w[0], w[1], w[2], w[3]},
                    r->P_s[2 * i]};
}

static Part part(const Run *r, int i, int j) {
    const REAL *x = r->x + 3 * (PARTS * i + j), *s = r->P_s + 2 * i, *b = r->P_r + 2 * i;
    REAL h = r->h / PARTS, at = (REAL)j / PARTS, later = at + (REAL)0.5 / PARTS;
    REAL dx = x[2] - x[0], ds = s[1] - s[0], db = b[1] - b[0];
    return (Part){h, dx / h, dx, {x[0], x[1]}, {s[0] + at * ds, s[0] + later * ds},
                  {b[0] + at * db, b[0] + later * db}};
}

/* Instances beyond the last repeat it, and are not written. */
INLINE int instance(const Run *r, int group, int k) {
    int i = group * LANES + k;
    return i < r->instances ? i : r->instances - 1;
}

static void load(const Run *r, int group, Numbers *n) {
    REAL *lane = (REAL *)n;
    for (int j = 0; j < COUNT_NUMBERS; j++)
        for (int k = 0; k < LANES; k++)
            lane[j * LANES + k] =
                r->numbers[(long)j * r->instances + instance(r, group, k)];
}

static void keep(const Run *r, int group, int sample, const State *s, const State *was) {
    for (int k = 0; k < LANES && group * LANES + k < r->instances; k++) {
        REAL *o = r->out + ((long)(group * LANES + k) * r->samples + sample) * KEPT;
        o[0] = s->u[k], o[1] = s->P_1[k], o[2] = s->P_2[k], o[3] = s->F[k];
        int i = 4;
#define WRITE(e) o[i++] = was->e[k];
        NINE(WRITE)
    }
}

/* Whether all instances agree in what the motion alone decides. */
static int agree(const Run *r) {
    const char *order[] = {NUMBERS(NAME)}, *wanted[] = {OF_MOTION(NAME)};
    for (int w = 0; w < 0 OF_MOTION(COUNT); w++)
        for (int j = 0; j < COUNT_NUMBERS; j++) {
            const REAL *row = r->numbers + (long)j * r->instances;
            if (strcmp(order[j], wanted[w])) continue;
            for (int i = 1; i < r->instances; i++)
                if (row[i] != row[0]) return 0;
        }
    return 1;
}

/* The motion's part of a run, by the numbers of the first instance. */
static void follow_motion(const Run *r) {
    Numbers n;
    State s = {0};
    load(r, 0, &n);
    begin(&n, &s, 0, sample(r, 0), 0);
    for (int i = 0; i < r->samples; i++) {
        Moved *m = r->moved + i;
        m->seen = see(&n, &s, 0, sample(r, i));
        for (int j = 0; j < PARTS; j++) {
            Part p = part(r, i, j);
            m->stiff[j] = stiffness(&n, 0, p);
            slide(&n, &s, 0, p);
        }
        m->felt = friction(&n, &s, 0, r->v[PARTS * i + PARTS - 1]);
    }
}

/* One group from its numbers; `alike` is a constant of each place it is called from. */
INLINE void steps(const Run *r, int group, const Numbers *n, State *s, int alike) {
    State was;
    Queue queue = {{0}};
    for (int i = 0; i < r->samples; i++) {
        if (r->out) was = *s;
        Sample t = sample(r, i);
        Moved all = alike ? r->moved[i] : (Moved){0};
        REAL *now = queue[i % QUEUE];
        OVER_LANES(k) {
            REAL lack = t.F_d - s->F[k];
            s->error[k] += lack * lack;
            decide(n, s, k, t, alike ? all.seen : see(n, s, k, t));
            now[k] = s->u[k];
        }
        if (r->out) keep(r, group, i, s, &was);
        for (int j = 0; j < PARTS; j++) {
            int at = PARTS * (i + QUEUE) + j - r->whole;
            const REAL *newer = queue[at / PARTS % QUEUE];
            const REAL *older = queue[(at - 1) / PARTS % QUEUE];
            REAL share = r->share;
            Part p = part(r, i, j);
            Stiff f = all.stiff[j];
            OVER_LANES(k) {
                REAL u = newer[k] + share * (older[k] - newer[k]);
                act(n, s, k, pass(n, s, k, u), p, alike ? f : stiffness(n, k, p));
                if (!alike) slide(n, s, k, p);
            }
        }
        REAL end = r->v[PARTS * i + PARTS - 1];
        OVER_LANES(k) feel(n, s, k, alike ? all.felt : friction(n, s, k, end));
    }
}

static void run_group(const Run *r, int group) {
    Numbers numbers;
    State state = {0};
    load(r, group, &numbers);
    Sample first = sample(r, 0);
    REAL v = (r->x[1] - r->x[0]) / (r->h / PARTS / 2);
    OVER_LANES(k) begin(&numbers, &state, k, first, v);
    if (r->moved) steps(r, group, &numbers, &state, 1);
    else steps(r, group, &numbers, &state, 0);
    for (int k = 0; k < LANES && group * LANES + k < r->instances; k++)
        r->rms[group * LANES + k] = root(state.error[k] / r->samples);
}

/* The closed loop of every instance along one course. */
void run_loop(const Run *given) {
    Run copy = *given;
    const Run *r = &copy;
    int groups = (r->instances + LANES - 1) / LANES, alike = r->instances > 1 && agree(r);
    copy.moved = alike ? malloc(sizeof(Moved) * (size_t)r->samples) : NULL;
    if (r->moved) follow_motion(r);
    int threads = groups < r->threads ? groups : r->threads;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int g = 0; g < groups; g++) run_group(r, g);
    free(copy.moved);
}
