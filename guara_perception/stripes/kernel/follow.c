// Best path of a stripe, which may have gaps, through the columns of a picture: the Viterbi algorithm (Forney: The Viterbi
// algorithm, Proc. IEEE 61, 1973), run from both ends until the two runs meet. The best paths from both sides to a pixel
// together are the best path through it.
#include "any_light.h"

// Costs in units of evidence: of each row by which a path moves between neighbouring columns, at most that of a jump; and of
// each end of the path.
#define PRICE_OF_ROW 0.7
#define PRICE_OF_JUMP 6.0
#define PRICE_OF_END 4.0
enum { ELSEWHERE, WITHOUT, TOP };

static float highest_of(const float *v, int64_t n) {
    float lanes[16];
    int64_t i = 16;
    if (n < 16) { float m = v[0]; for (i = 1; i < n; i++) m = MAX(m, v[i]); return m; }
    memcpy(lanes, v, sizeof lanes);
    for (; i + 16 <= n; i += 16) for (int k = 0; k < 16; k++) lanes[k] = MAX(lanes[k], v[i + k]);
    for (; i < n; i++) lanes[0] = MAX(lanes[0], v[i]);
    for (int k = 1; k < 16; k++) lanes[0] = MAX(lanes[0], lanes[k]);
    return lanes[0];
}

// Scores of the best paths up to every pixel of `count` columns, best: (count, rows); and of those that reach a column from
// elsewhere (by a jump or a start), have no stripe in it, or end at its best pixel, ends: (count, 3).
static void best_paths(const float *evidence, int64_t step, int64_t count, int64_t rows, float *best, float *ends, float *line) {
    float *start = line + 4, *near = start + rows + 8;
    for (int64_t i = 1; i <= 4; i++) start[-i] = start[rows + i - 1] = near[-i] = near[rows + i - 1] = -INFINITY;
    const float one = (float)PRICE_OF_ROW, two = (float)(2 * PRICE_OF_ROW), end = (float)PRICE_OF_END, jump = (float)PRICE_OF_JUMP;
    for (int64_t r = 0; r < rows; r++) best[r] = evidence[r] - end;
    ends[ELSEWHERE] = ends[WITHOUT] = 0;
    for (int64_t column = 1; column < count; column++) {
        const float *restrict own = evidence + column * step, *restrict before = best + (column - 1) * rows;
        float *restrict now = best + column * rows, *here = ends + 3 * column, *last = here - 3;
        last[TOP] = highest_of(before, rows);
        const float a = last[WITHOUT] - end, b = last[TOP] - jump, c = last[TOP] - end;
        here[ELSEWHERE] = MAX(a, b), here[WITHOUT] = MAX(last[WITHOUT], c);
        const float elsewhere = here[ELSEWHERE];
        for (int64_t r = 0; r < rows; r++) start[r] = MAX(before[r], elsewhere);
        for (int64_t r = 0; r < rows; r++) {
            const float beside_it = MAX(start[r - 1], start[r + 1]) - one;
            near[r] = MAX(start[r], beside_it);
        }
        for (int64_t r = 0; r < rows; r++) {
            const float beside_it = MAX(near[r - 2], near[r + 2]) - two;
            now[r] = MAX(near[r], beside_it) + own[r];
        }
    }
}

static int64_t argmax(const float *v, int64_t n) {
    const float high = highest_of(v, n);
    int64_t i = 0;
    while (v[i] != high) i++;
    return i;
}

// Trace the best path from a row of column `last`, or from NONE, back to the first column.
static void trace(const float *best, const float *ends, int64_t rows, int64_t last, int64_t row, int32_t *path, int step) {
    path[0] = (int32_t)row;
    for (int64_t column = last - 1; column >= 0; column--) {
        const float *scores = best + column * rows;
        double extra = PRICE_OF_END;
        path += step;
        if (row != NONE) {
            double high = -INFINITY;
            int move = -3;
            for (int m = -3; m <= 3; m++) {
                const double v = row + m < 0 || row + m >= rows ? -INFINITY : (double)scores[row + m] - PRICE_OF_ROW * abs(m);
                if (v > high) high = v, move = m;
            }
            if (high >= (double)ends[3 * (column + 1) + ELSEWHERE]) {
                *path = (int32_t)(row += move);
                continue;
            }
            extra = PRICE_OF_JUMP - PRICE_OF_END;
        }
        const int is_stripe = (double)ends[3 * column + TOP] - extra > (double)ends[3 * column + WITHOUT];
        *path = (int32_t)(row = is_stripe ? argmax(scores, rows) : NONE);
    }
}

// Path of the stripe; returns the evidence along it minus its costs. A column without a stripe has the row of the nearest
// column with one.
double follow_columns(const float *evidence, int64_t columns, int64_t rows, Any *w, Path *found) {
    const int64_t centre = columns / 2, met = columns - 1 - centre;
    float *first = w->paths, *second = first + (centre + 1) * rows, *through = w->line;
    best_paths(evidence, rows, centre + 1, rows, first, w->ends[0], w->line);
    best_paths(evidence + (columns - 1) * rows, -rows, met + 1, rows, second, w->ends[1], w->line);
    const float *a = first + centre * rows, *b = second + met * rows, *own = evidence + centre * rows;
    for (int64_t r = 0; r < rows; r++) through[r] = a[r] + b[r] - own[r];
    const int64_t row = argmax(through, rows);
    const float most = through[row], without = w->ends[0][3 * centre + WITHOUT] + w->ends[1][3 * met + WITHOUT];
    const int64_t start = most > without ? row : NONE;
    trace(first, w->ends[0], rows, centre, start, found->row + centre, -1);
    trace(second, w->ends[1], rows, met, start, found->row + centre, 1);
    int64_t before = NONE; // the last column with a stripe
    for (int64_t c = 0; c < columns; c++) {
        found->is_stripe[c] = found->row[c] != NONE;
        if (!found->is_stripe[c]) continue;
        const int64_t middle = before == NONE ? 0 : (before + c) / 2 + 1;
        for (int64_t i = before + 1; i < c; i++) found->row[i] = found->row[i < middle ? before : c];
        before = c;
    }
    for (int64_t i = before + 1; i < columns; i++) found->row[i] = before == NONE ? 0 : found->row[before];
    return (double)MAX(most, without);
}
