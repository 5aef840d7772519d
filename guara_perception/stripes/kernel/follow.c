// The best path of a stripe through the columns of a picture: the Viterbi algorithm (Forney: The Viterbi algorithm,
// Proc. IEEE 61, 1973), run from both ends until the two runs meet: the sum of the best paths up to a pixel from
// either side is the best path through it.
#include "kernel.h"

// In units of evidence: a path pays for every row that it moves by from one column to the next, but never more than
// for a jump, and for every end.
#define COST_PER_ROW 0.7
#define COST_OF_JUMP 6.0f
#define COST_OF_END 4.0f
// Rows that a path may move by from one column to the next without jumping.
#define REACH 3
// Instead of a row: there is no stripe.
#define NONE (-1)

// Of the paths up to a column: the best that comes from elsewhere, the best without and the best with a stripe there.
typedef struct { float elsewhere, none, top; } Ends;

static float highest(const float *restrict values, int64_t n) {
    float lanes[LANES], most = -INFINITY;
    int64_t i = 0;
    for (int k = 0; k < LANES; k++) lanes[k] = -INFINITY;
    for (; i + LANES <= n; i += LANES) for (int k = 0; k < LANES; k++) lanes[k] = MAX(lanes[k], values[i + k]);
    for (; i < n; i++) most = MAX(most, values[i]);
    for (int k = 0; k < LANES; k++) most = MAX(most, lanes[k]);
    return most;
}

// Scores (columns, rows + 2 REACH) of the best paths up to every pixel; from one column of `seen` to the next it is
// `step` numbers. `here` and `near` hold one column each.
static void sweep(const float *seen, int64_t step, int64_t columns, int64_t rows, float *best, Ends *ends,
    float *restrict here, float *restrict near) {
    const int64_t length = rows + 2 * REACH;
    const float one = (float)COST_PER_ROW, two = (float)(2 * COST_PER_ROW);
    for (int64_t i = 0; i < length; i++) best[i] = here[i] = near[i] = -INFINITY;
    for (int64_t r = REACH; r < rows + REACH; r++) best[r] = seen[r] - COST_OF_END;
    ends[0] = (Ends){0, 0, 0};
    for (int64_t c = 1; c < columns; c++) {
        const float *restrict before = best + (c - 1) * length, *restrict own = seen + c * step;
        float *restrict now = best + c * length;
        const Ends last = ends[c - 1];
        const float top = ends[c - 1].top = highest(before + REACH, rows);
        const float elsewhere = MAX(last.none - COST_OF_END, top - COST_OF_JUMP);
        ends[c] = (Ends){elsewhere, MAX(last.none, top - COST_OF_END), 0};
        // Moves by one row, and after these by two, are all up to REACH, each at its price.
        for (int64_t r = REACH; r < rows + REACH; r++) here[r] = MAX(before[r], elsewhere);
        for (int64_t r = REACH; r < rows + REACH; r++) near[r] = MAX(here[r], MAX(here[r - 1], here[r + 1]) - one);
        near[REACH - 1] = here[REACH] - one, near[rows + REACH] = here[rows + REACH - 1] - one;
        for (int64_t r = REACH; r < rows + REACH; r++)
            now[r] = MAX(near[r], MAX(near[r - 2], near[r + 2]) - two) + own[r];
        for (int64_t r = 0; r < REACH; r++) now[r] = now[rows + REACH + r] = -INFINITY;
    }
}

// Follows the best path back from a row (or NONE) of column `last`; `path` is that of this column, of the one before
// `path + step`.
static void trace(const float *best, const Ends *ends, int64_t rows, int64_t last, int32_t row, int32_t *path,
    int64_t step) {
    *path = row;
    for (int64_t c = last - 1; c >= 0; c--) {
        const float *scores = best + c * (rows + 2 * REACH) + REACH;
        double extra = COST_OF_END;
        path += step;
        if (row != NONE) {
            double most = -INFINITY;
            int32_t move = 0;
            for (int32_t m = -REACH; m <= REACH; m++) {
                const double score = (double)scores[row + m] - COST_PER_ROW * abs(m);
                if (score > most) most = score, move = m;
            }
            if (most >= (double)ends[c + 1].elsewhere) {
                *path = row += move;
                continue;
            }
            extra = (double)COST_OF_JUMP - COST_OF_END;
        }
        row = NONE;
        if ((double)ends[c].top - extra > (double)ends[c].none)
            for (row = 0; row < rows - 1 && scores[row] < ends[c].top;) row++;
        *path = row;
    }
}

// evidence: (rows, columns) of the stripe at each pixel, negative where none is likely. path: (columns,) rows, NONE
// where there is no stripe. work: (2 columns + 4, rows + 2 REACH) and (columns + 1, 3)
// float. Returns the evidence
// of the whole path minus its costs.
double follow(const float *evidence, int64_t rows, int64_t columns, float *work, int32_t *path) {
    const int64_t length = rows + 2 * REACH, centre = columns / 2, met = columns - 1 - centre;
    float *seen = work, *first = seen + columns * length, *second = first + (centre + 1) * length;
    float *here = second + (met + 1) * length, *near = here + length;
    Ends *ends = (Ends *)(near + length), *ends_2 = ends + centre + 1;
    for (int64_t begin = 0; begin < columns; begin += LANES) {
        const int64_t end = MIN(begin + LANES, columns);
        for (int64_t r = 0; r < rows; r++)
            for (int64_t c = begin; c < end; c++) seen[c * length + REACH + r] = evidence[r * columns + c];
    }
    sweep(seen, length, centre + 1, rows, first, ends, here, near);
    sweep(seen + (columns - 1) * length, -length, met + 1, rows, second, ends_2, here, near);
    const float *a = first + centre * length + REACH, *b = second + met * length + REACH;
    const float *own = seen + centre * length + REACH, without = ends[centre].none + ends_2[met].none;
    float most = -INFINITY;
    int32_t row = 0;
    for (int64_t r = 0; r < rows; r++) {
        const float through = a[r] + b[r] - own[r];
        if (through > most) most = through, row = (int32_t)r;
    }
    if (!(most > without)) row = NONE;
    trace(first, ends, rows, centre, row, path + centre, -1);
    trace(second, ends_2, rows, met, row, path + centre, 1);
    return (double)MAX(most, without);
}
