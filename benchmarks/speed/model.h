/* The model's pieces on one lane: a scalar body that is vectorised over lanes.
 *
 * Compiled with -DREAL=double or float and -DLANES=1 (scalar), 8, 16 ...: every state
 * and every number is an array of LANES, and each function below is one lane of it. */
#ifndef MODEL_H
#define MODEL_H

#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))
#define STRING(x) #x ","
#define LANE(x) REAL x[LANES];
#define COUNT(x) +1

#if LANES > 1
#define OVER_LANES(k) _Pragma("omp simd") for (int k = 0; k < LANES; k++)
#else
#define OVER_LANES(k) for (int k = 0; k < 1; k++)
#endif

#define IS_DOUBLE (sizeof(REAL) == 8)

/* `d_` are the valve constants over the area that they fill, 1/s of it. */
#define PLANT(X) \
    X(d_p1) X(d_n1) X(d_p2) X(d_n2) X(act_1) X(act_2) X(half_1) X(half_2) X(beta) \
    X(k_cp) X(k_cn) X(k_0) X(k_vp) X(k_vn) X(k_fp) X(k_fn) X(z_ss) X(per_z_ss) \
    X(delta) X(L_slope)

INLINE REAL absolute(REAL a) { return a < 0 ? -a : a; }
INLINE REAL most(REAL a, REAL b) { return a > b ? a : b; }
INLINE REAL least(REAL a, REAL b) { return a < b ? a : b; }
INLINE REAL within(REAL a, REAL lower, REAL upper) { return most(least(a, upper), lower); }

INLINE REAL root(REAL a) {
    return IS_DOUBLE ? (REAL)__builtin_sqrt(a) : (REAL)__builtin_sqrtf((float)a);
}

/* exp(x) for x <= 0: 2^n times a Taylor series about 0 on |r| <= ln(2)/2; the sum with
 * 1.5 * 2^52 rounds, and leaves n in the lowest bits. */
INLINE double exp_double(double x) {
    x = x < -700.0 ? -700.0 : x;
    double shifted = x * 1.4426950408889634 + 0x1.8p52;
    double n = shifted - 0x1.8p52;
    double r = (x - n * 0x1.62e42fefa39efp-1) - n * 0x1.abc9e3b39803fp-56;
    double a = 1.0 / 6227020800.0;
    a = a * r + 1.0 / 479001600.0;
    a = a * r + 1.0 / 39916800.0;
    a = a * r + 1.0 / 3628800.0;
    a = a * r + 1.0 / 362880.0;
    a = a * r + 1.0 / 40320.0;
    a = a * r + 1.0 / 5040.0;
    a = a * r + 1.0 / 720.0;
    a = a * r + 1.0 / 120.0;
    a = a * r + 1.0 / 24.0;
    a = a * r + 1.0 / 6.0;
    a = a * r + 0.5;
    a = a * r + 1.0;
    a = a * r + 1.0;
    int64_t bits, power;
    memcpy(&bits, &a, 8);
    memcpy(&power, &shifted, 8);
    bits += (int64_t)((uint64_t)power << 52);
    memcpy(&a, &bits, 8);
    return a;
}

INLINE float exp_float(float x) {
    x = x < -80.0f ? -80.0f : x;
    float shifted = x * 1.44269504f + 0x1.8p23f;
    float n = shifted - 0x1.8p23f;
    float r = (x - n * 0x1.62e4p-1f) - n * 0x1.7f7d1cp-20f;
    float a = 1.0f / 5040.0f;
    a = a * r + 1.0f / 720.0f;
    a = a * r + 1.0f / 120.0f;
    a = a * r + 1.0f / 24.0f;
    a = a * r + 1.0f / 6.0f;
    a = a * r + 0.5f;
    a = a * r + 1.0f;
    a = a * r + 1.0f;
    int32_t bits, power;
    memcpy(&bits, &a, 4);
    memcpy(&power, &shifted, 4);
    bits += (int32_t)((uint32_t)power << 23);
    memcpy(&a, &bits, 4);
    return a;
}

INLINE REAL exponential(REAL x) {
    return IS_DOUBLE ? (REAL)exp_double((double)x) : (REAL)exp_float((float)x);
}

INLINE REAL nearest(REAL x) {
    return IS_DOUBLE ? (REAL)__builtin_rint((double)x) : (REAL)__builtin_rintf((float)x);
}

/* a^(-1/4) for a > 0: a guess from the exponent, 3 % off, then the series of
 * (1 - t)^(-1/4) twice, with t what is left of 1 - a y^4. Vectors divide and take roots
 * one after the other; this they do beside them. A scalar is quicker with two roots. */
INLINE double quarter_double(double a) {
    uint64_t bits;
    memcpy(&bits, &a, 8);
    bits = 0x4feb000000000000u - (bits >> 2);
    double y;
    memcpy(&y, &bits, 8);
    double t = 1.0 - a * ((y * y) * (y * y));
    double more = 663.0 / 8192.0;
    more = more * t + 195.0 / 2048.0;
    more = more * t + 15.0 / 128.0;
    more = more * t + 5.0 / 32.0;
    more = more * t + 0.25;
    y = y + y * (t * more);
    t = 1.0 - a * ((y * y) * (y * y));
    return y + y * (t * (t * (5.0 / 32.0) + 0.25));
}

INLINE float quarter_float(float a) {
    uint32_t bits;
    memcpy(&bits, &a, 4);
    bits = 0x4f581000u - (bits >> 2);
    float y;
    memcpy(&y, &bits, 4);
    float t = 1.0f - a * ((y * y) * (y * y));
    float more = 195.0f / 2048.0f;
    more = more * t + 15.0f / 128.0f;
    more = more * t + 5.0f / 32.0f;
    more = more * t + 0.25f;
    y = y + y * (t * more);
    t = 1.0f - a * ((y * y) * (y * y));
    return y + y * (t * 0.25f);
}

/* d / (d^2 + core^2)^(1/4), core 2 kPa */
INLINE REAL root_flow(REAL drop) {
    REAL a = drop * drop + (REAL)4e6;
    if (LANES == 1) return drop / root(root(a));
    return IS_DOUBLE ? (REAL)(drop * quarter_double((double)a))
                     : (REAL)(drop * quarter_float((float)a));
}

/* The derivative of `root_flow`. */
INLINE REAL root_slope(REAL drop) {
    REAL a = drop * drop + (REAL)4e6, y;
    if (LANES == 1) y = 1 / root(root(a));
    else y = IS_DOUBLE ? (REAL)quarter_double((double)a) : (REAL)quarter_float((float)a);
    return y * ((REAL)0.5 + (REAL)2e6 * (y * y) * (y * y));
}

/* (1 - e^-z) / z, of third order: the share of a slope that is run along it. */
INLINE REAL relaxed(REAL z) {
    REAL beyond = z * ((REAL)0.5 + z * (REAL)(1.0 / 6));
    return (1 + beyond) / (1 + z * (1 + beyond));
}

/* The bristle after a displacement. */
INLINE REAL bristle(REAL z, REAL dx, REAL z_ss, REAL per_z_ss) {
    REAL keep = exponential(-absolute(dx) * per_z_ss);
    REAL sign = (REAL)((dx > 0) - (dx < 0));
    return keep * z + sign * z_ss * (1 - keep);
}

INLINE REAL switched(REAL speed, REAL slope) {
    REAL s = slope * speed;
    return 1 / (1 + s * s * s);
}

/* F of (22): the admissible root of the quadratic. */
INLINE REAL output_force(REAL P, REAL f_c, REAL L, REAL k_fp, REAL k_fn, REAL delta) {
    REAL drive = P - (1 - L) * f_c;
    REAL size = absolute(drive);
    REAL b = 1 + L * (drive > 0 ? k_fp : k_fn) - delta * size;
    REAL disc = root(b * b + 4 * delta * size);
    REAL F = (b > 0 ? 2 * size : disc - b) / (b > 0 ? b + disc : 2 * delta);
    return drive < 0 ? -F : F;
}

#endif
