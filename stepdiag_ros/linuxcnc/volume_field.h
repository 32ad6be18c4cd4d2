/* SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-or-later
 *
 * The error of a three-axis machine's tool point from its 21 geometric errors, and its compensation.
 *
 * Plain C without HAL: the kinematics module includes it, and a test compiles it alone and holds it against
 * the project's own rigid-body model (stepdiag_ros/model/machine.py), whose formulas these are.
 *
 *   joints q -> tool point relative to the tool vector:  forward(q) = q + s e(q)        (exact)
 *   axes x  -> joints:                                   q = x - s e(q), fixed point
 *
 * e is limited to `limit` in each coordinate and its slope to SLOPE, so that the fixed point contracts by
 * a factor below SLOPE * 3 in each turn.
 */
#ifndef STEPDIAG_VOLUME_FIELD_H
#define STEPDIAG_VOLUME_FIELD_H

#include <math.h>
#include <stdio.h>
#include <string.h>

#define FIELD_KNOTS 200          /* most knots an axis */
#define FIELD_LIMIT 1.0          /* [mm] no file may ask for more */
#define FIELD_SLOPE 0.01         /* steepest change of the error with position that is accepted */
#define FIELD_TURNS 30           /* of the fixed point; 6 are usual */
#define FIELD_EPSILON 1.0e-13    /* [mm] at which the fixed point has arrived */

typedef struct {
    int known;                             /* 0: no field, everything is zero */
    char chain[5];                         /* e.g. FXYZ, from the workpiece to the tool */
    double origin[3];                      /* machine coordinates of the volume's lower corner */
    double tool[3];                        /* tool vector for which the file was made */
    double square[3];                      /* EC0Y EB0Z EA0Z [rad] */
    double limit;                          /* largest correction in a coordinate */
    int count[3];                          /* knots of X, Y, Z */
    double place[3][FIELD_KNOTS];          /* from the origin, rising */
    double value[3][FIELD_KNOTS][6];       /* EXa EYa EZa, EAa EBa ECa */
    double largest;                        /* largest error at the knots, any coordinate */
} field_t;

/* Where an axis is in the volume; from outside the nearest place inside counts. */
static double field_inside(const field_t *f, int axis, double joint)
{
    const double place = joint - f->origin[axis], last = f->place[axis][f->count[axis] - 1];

    return place < f->place[axis][0] ? f->place[axis][0] : place > last ? last : place;
}

/* Errors of one axis at a place inside. */
static void field_motions(const field_t *f, int axis, double place, double shift[3], double turn[3])
{
    const int n = f->count[axis];
    const double *at = f->place[axis];
    int low = 0, high = n - 1, k;
    double share;

    if (place <= at[0]) { high = 0; share = 0.0; }
    else if (place >= at[n - 1]) { low = high = n - 1; share = 0.0; }
    else {
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            if (at[middle] <= place) low = middle; else high = middle;
        }
        share = (place - at[low]) / (at[high] - at[low]);
    }
    for (k = 0; k < 3; k++) {
        const double *a = f->value[axis][low], *b = f->value[axis][high];
        shift[k] = a[k] + share * (b[k] - a[k]);
        turn[k] = a[k + 3] + share * (b[k + 3] - a[k + 3]);
    }
    if (axis == 1) shift[0] -= f->square[0] * place;          /* EC0Y */
    if (axis == 2) {
        shift[0] += f->square[1] * place;                     /* EB0Z */
        shift[1] -= f->square[2] * place;                     /* EA0Z */
    }
}

/* q + angles x q, to first order as the model has it. */
static void field_turned(const double turn[3], const double q[3], double result[3])
{
    result[0] = q[0] - turn[2] * q[1] + turn[1] * q[2];
    result[1] = turn[2] * q[0] + q[1] - turn[0] * q[2];
    result[2] = -turn[1] * q[0] + turn[0] * q[1] + q[2];
}

/* Error of the tool point at joints q (machine coordinates) with a tool vector: not limited. */
static void field_raw(const field_t *f, const double q[3], const double tool[3], double error[3])
{
    double point[3] = {tool[0], tool[1], tool[2]}, moved[3], shift[3], turn[3], place;
    const int frame = (int)(strchr(f->chain, 'F') - f->chain);
    int i, k;

    for (i = 3; i >= 0; i--) {
        if (f->chain[i] == 'F') continue;
        const int axis = f->chain[i] - 'X';
        place = field_inside(f, axis, q[axis]);
        field_motions(f, axis, place, shift, turn);
        shift[axis] += place;
        if (i < frame) {                   /* the axis carries the workpiece */
            for (k = 0; k < 3; k++) moved[k] = shift[k] + point[k];
            field_turned(turn, moved, point);
        } else {
            field_turned(turn, point, moved);
            for (k = 0; k < 3; k++) point[k] = shift[k] + moved[k];
        }
    }
    for (k = 0; k < 3; k++) error[k] = point[k] - field_inside(f, k, q[k]) - tool[k];
}

/* The error times a scale 0..1, limited in each coordinate; zero where it is not a number. */
static void field_error(const field_t *f, const double q[3], const double tool[3], double scale,
                        double error[3])
{
    int k;

    error[0] = error[1] = error[2] = 0.0;
    if (!f->known || scale <= 0.0) return;
    field_raw(f, q, tool, error);
    for (k = 0; k < 3; k++) {
        error[k] *= scale;
        if (!(error[k] > -f->limit)) error[k] = isnan(error[k]) ? 0.0 : -f->limit;
        if (error[k] > f->limit) error[k] = f->limit;
    }
}

static void field_forward(const field_t *f, const double q[3], const double tool[3], double scale,
                          double x[3])
{
    double error[3];
    int k;

    field_error(f, q, tool, scale, error);
    for (k = 0; k < 3; k++) x[k] = q[k] + error[k];
}

/* Joints for axes x; returns the turns that the fixed point took. */
static int field_inverse(const field_t *f, const double x[3], const double tool[3], double scale,
                         double q[3])
{
    double error[3], next, change;
    int turn, k;

    for (k = 0; k < 3; k++) q[k] = x[k];
    for (turn = 1; turn <= FIELD_TURNS; turn++) {
        field_error(f, q, tool, scale, error);
        change = 0.0;
        for (k = 0; k < 3; k++) {
            next = x[k] - error[k];
            if (fabs(next - q[k]) > change) change = fabs(next - q[k]);
            q[k] = next;
        }
        if (change <= FIELD_EPSILON * (1.0 + fabs(x[0]) + fabs(x[1]) + fabs(x[2])) * 1e-2 + FIELD_EPSILON)
            return turn;
    }
    return turn;
}

static unsigned long field_sum(unsigned long sum, const char *text)
{
    for (; *text; text++) sum = ((sum ^ (unsigned char)*text) * 16777619UL) & 0xFFFFFFFFUL;   /* FNV-1a */
    return sum;
}

/* Largest error and steepest slope over all knots; 0, or why the field cannot be used. */
static const char *field_check(field_t *f)
{
    double q[3], error[3], before[3];
    int i[3], axis, k;

    if (strlen(f->chain) != 4 || strspn(f->chain, "FXYZ") != 4 || !strchr(f->chain, 'F')
        || !strchr(f->chain, 'X') || !strchr(f->chain, 'Y') || !strchr(f->chain, 'Z')) return "chain";
    if (!(f->limit > 0.0 && f->limit <= FIELD_LIMIT)) return "limit";
    for (axis = 0; axis < 3; axis++) {
        if (f->count[axis] < 1) return "an axis without knots";
        for (k = 1; k < f->count[axis]; k++)
            if (!(f->place[axis][k] > f->place[axis][k - 1])) return "positions that do not rise";
    }
    f->largest = 0.0;
    for (i[0] = 0; i[0] < f->count[0]; i[0]++)
        for (i[1] = 0; i[1] < f->count[1]; i[1]++)
            for (i[2] = 0; i[2] < f->count[2]; i[2]++) {
                for (axis = 0; axis < 3; axis++) q[axis] = f->origin[axis] + f->place[axis][i[axis]];
                field_raw(f, q, f->tool, error);
                for (k = 0; k < 3; k++) {
                    if (!isfinite(error[k])) return "a number that is not finite";
                    if (fabs(error[k]) > f->limit) return "an error beyond its limit";
                    if (fabs(error[k]) > f->largest) f->largest = fabs(error[k]);
                }
                for (axis = 0; axis < 3; axis++) {
                    if (i[axis] == 0) continue;
                    const double step = f->place[axis][i[axis]] - f->place[axis][i[axis] - 1];
                    q[axis] -= step;
                    field_raw(f, q, f->tool, before);
                    q[axis] += step;
                    for (k = 0; k < 3; k++)
                        if (fabs(error[k] - before[k]) > FIELD_SLOPE * step) return "too steep a slope";
                }
            }
    return NULL;
}

/* Read a solution file; NULL when it can be used, else what is wrong with it (and the field is zero). */
static const char *field_read(field_t *f, const char *path)
{
    char line[512], *newline;
    unsigned long sum = 2166136261UL, given;
    int axis = -1, row = 0, ended = 0;
    const char *wrong = NULL;
    FILE *file;

    memset(f, 0, sizeof *f);
    file = fopen(path, "r");
    if (!file) return "a file that cannot be read";
    if (!fgets(line, sizeof line, file) || strcmp(line, "stepdiag-volume 1\n")) wrong = "its first line";
    else sum = field_sum(sum, line);
    while (!wrong && !ended && fgets(line, sizeof line, file)) {
        newline = strchr(line, '\n');
        if (!newline) { wrong = "a line that does not end"; break; }
        if (sscanf(line, "end %lx", &given) == 1) {
            ended = 1;
            if (given != sum) wrong = "its check sum";
            continue;
        }
        sum = field_sum(sum, line);
        if (line[0] == '#') continue;
        if (axis >= 0 && row < f->count[axis]) {
            double *v = f->value[axis][row];
            if (sscanf(line, "%lf %lf %lf %lf %lf %lf %lf", &f->place[axis][row], v, v + 1, v + 2, v + 3,
                       v + 4, v + 5) != 7) wrong = "a row of an axis";
            row++;
        } else if (!strncmp(line, "chain ", 6)) {
            if (sscanf(line, "chain %4s", f->chain) != 1) wrong = "chain";
        } else if (!strncmp(line, "origin ", 7)) {
            if (sscanf(line, "origin %lf %lf %lf", f->origin, f->origin + 1, f->origin + 2) != 3) wrong = "origin";
        } else if (!strncmp(line, "tool ", 5)) {
            if (sscanf(line, "tool %lf %lf %lf", f->tool, f->tool + 1, f->tool + 2) != 3) wrong = "tool";
        } else if (!strncmp(line, "square ", 7)) {
            if (sscanf(line, "square %lf %lf %lf", f->square, f->square + 1, f->square + 2) != 3) wrong = "square";
        } else if (!strncmp(line, "limit ", 6)) {
            if (sscanf(line, "limit %lf", &f->limit) != 1) wrong = "limit";
        } else if (!strncmp(line, "axis ", 5)) {
            char letter;
            int count;
            if (sscanf(line, "axis %c %d", &letter, &count) != 2 || letter < 'X' || letter > 'Z'
                || count < 1 || count > FIELD_KNOTS) wrong = "axis";
            else { axis = letter - 'X'; f->count[axis] = count; row = 0; }
        } else wrong = "a line that is not known";
    }
    fclose(file);
    if (!wrong && !ended) wrong = "its end, which is missing";
    if (!wrong && (axis < 0 || row < f->count[axis])) wrong = "rows that are missing";
    if (!wrong) wrong = field_check(f);
    if (wrong) memset(f, 0, sizeof *f);
    else f->known = 1;
    return wrong;
}

#endif
