/* The closed loop of the exported plant and law, one period after the other.
 *
 * loop RATE PERIODS PACED: PERIODS of 1/RATE s; PACED 1 waits for the clock before each.
 * Writes to stdout, for each period, three doubles: ns from the period's beginning (as
 * planned, where it is paced) to its end, ns that the law took of it, ns that the plant
 * took; and last the RMS of F_d - F, of F_d, and 0. */
#define _POSIX_C_SOURCE 200809L
#include "law.h"
#include "plant.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static const double PI = 3.14159265358979323846;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void until(double ns)
{
    struct timespec t;
    t.tv_sec = (time_t)(ns / 1e9);
    t.tv_nsec = (long)(ns - 1e9 * (double)t.tv_sec);
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL)) {
    }
}

int main(int argc, char **argv)
{
    const double rate = argc > 3 ? atof(argv[1]) : 1e3;
    const long periods = argc > 3 ? atol(argv[2]) : 1000;
    const int paced = argc > 3 && atoi(argv[3]);
    const double h = 1.0 / rate, w = 2.0 * PI * 0.7, size = 0.006;
    double (*took)[3] = calloc((size_t)periods + 1, sizeof *took);
    law_parameters of_law = law_rig;
    plant_parameters of_plant = plant_rig;
    law_constants law;
    plant_constants plant;
    law_state law_at;
    plant_state plant_at;
    law_input seen = {0};
    law_output command = {0};
    plant_input drive = {0};
    plant_output read;
    double miss = 0.0, asked = 0.0, begin;
    long i;

    if (!took) {
        return 1;
    }
    of_law.h = of_plant.h = h;
    law_prepare(&law, &of_law);
    plant_prepare(&plant, &of_plant);
    drive.P_s = 14e6;
    drive.P_r = 0.25e6;
    drive.P_a1 = drive.P_a2 = 7e6;
    plant_start(&plant_at, &read, &plant, &drive);
    begin = now() + (paced ? 1e6 : 0.0);
    for (i = 0; i < periods; i++) {
        const double t = (double)i * h, planned = begin + 1e9 * t;
        double start, middle, end;
        if (paced) {
            until(planned);
        }
        start = now();
        seen.P_a1 = read.P_a1;
        seen.P_a2 = read.P_a2;
        seen.F = read.F;
        seen.P_s = drive.P_s;
        seen.x = size * sin(w * t);
        seen.F_d = 250.0 * sin(2.0 * PI * 1.3 * t);
        if (i == 0) {
            law_start(&law_at, &command, &law, &seen);
        }
        law_step(&law_at, &command, &law, &seen);
        middle = now();
        drive.u = command.u;
        drive.x = seen.x;
        drive.v = size * w * cos(w * t);
        drive.a = -size * w * w * sin(w * t);
        drive.t = t;
        plant_step(&plant_at, &read, &plant, &drive);
        end = now();
        took[i][0] = end - (paced ? planned : start);
        took[i][1] = middle - start;
        took[i][2] = end - middle;
        if (t > 0.5) {
            miss += (seen.F_d - seen.F) * (seen.F_d - seen.F);
            asked += seen.F_d * seen.F_d;
        }
    }
    took[periods][0] = sqrt(miss / (double)periods);
    took[periods][1] = sqrt(asked / (double)periods);
    fwrite(took, sizeof *took, (size_t)periods + 1, stdout);
    free(took);
    return 0;
}
