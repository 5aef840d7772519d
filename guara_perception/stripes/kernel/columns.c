// The best path through evidence that lies column by column, "no stripe here" included; the same as in follow.c.
#include "any_light.h"

// ---- follow_stripe: from both ends at once until the two runs meet ---------------------------------------------------------
#define PRICE_OF_ROW 0.7
#define PRICE_OF_JUMP 6.0
#define PRICE_OF_END 4.0
enum { ELSEWHERE, WITHOUT, TOP };

static float highest_of(const float *v, int n) {
    float lanes[16];
    int i = 16;
    if (n < 16) { float m = v[0]; for (i = 1; i < n; i++) m = MAX(m, v[i]); return m; }
    memcpy(lanes, v, sizeof lanes);
    for (; i + 16 <= n; i += 16) for (int k = 0; k < 16; k++) lanes[k] = MAX(lanes[k], v[i + k]);
    for (; i < n; i++) lanes[0] = MAX(lanes[0], v[i]);
    for (int k = 1; k < 16; k++) lanes[0] = MAX(lanes[0], lanes[k]);
    return lanes[0];
}

// Scores of the best paths up to every pixel of `count` columns: (count, rows), and of the ends (count, 3).
static void best_paths(const float *evidence, int64_t step, int count, int rows, float *best, float *ends) {
    float start_of[MOST_ROWS + 8], near_of[MOST_ROWS + 8], *start = start_of + 4, *near = near_of + 4;
    for (int i = 1; i <= 4; i++) start[-i] = start[rows + i - 1] = near[-i] = near[rows + i - 1] = -INFINITY;
    const float one = (float)PRICE_OF_ROW, two = (float)(2 * PRICE_OF_ROW), end = (float)PRICE_OF_END, jump = (float)PRICE_OF_JUMP;
    for (int r = 0; r < rows; r++) best[r] = evidence[r] - end;
    ends[ELSEWHERE] = ends[WITHOUT] = 0;
    for (int column = 1; column < count; column++) {
        const float *restrict own = evidence + column * step, *restrict before = best + (int64_t)(column - 1) * rows;
        float *restrict now = best + (int64_t)column * rows, *here = ends + 3 * column, *last = here - 3;
        last[TOP] = highest_of(before, rows);
        const float a = last[WITHOUT] - end, b = last[TOP] - jump, c = last[TOP] - end;
        here[ELSEWHERE] = MAX(a, b), here[WITHOUT] = MAX(last[WITHOUT], c);
        const float elsewhere = here[ELSEWHERE];
        for (int r = 0; r < rows; r++) start[r] = MAX(before[r], elsewhere);
        for (int r = 0; r < rows; r++) {
            const float beside_it = MAX(start[r - 1], start[r + 1]) - one;
            near[r] = MAX(start[r], beside_it);
        }
        for (int r = 0; r < rows; r++) {
            const float beside_it = MAX(near[r - 2], near[r + 2]) - two;
            now[r] = MAX(near[r], beside_it) + own[r];
        }
    }
}

static int argmax(const float *v, int n) {
    const float high = highest_of(v, n);
    int i = 0;
    while (v[i] != high) i++;
    return i;
}

// Follows the best path back from a row, or NONE, of column `last` to the first column.
static void trace(const float *best, const float *ends, int rows, int last, int row, int32_t *path, int step) {
    path[0] = row;
    for (int column = last - 1; column >= 0; column--) {
        const float *scores = best + (int64_t)column * rows;
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
                *path = row += move;
                continue;
            }
            extra = PRICE_OF_JUMP - PRICE_OF_END;
        }
        const int is_stripe = (double)ends[3 * column + TOP] - extra > (double)ends[3 * column + WITHOUT];
        *path = row = is_stripe ? argmax(scores, rows) : NONE;
    }
}

// The stripe's path, and the evidence along it minus its costs.
double follow_columns(const float *evidence, int columns, int rows, float *work, Paths *of, Path *found) {
    const int centre = columns / 2, met = columns - 1 - centre;
    const int64_t size = (int64_t)(centre + 1) * rows;
    float *first = work, *second = work + size, through[MOST_ROWS];
    best_paths(evidence, rows, centre + 1, rows, first, of->ends[0]);
    best_paths(evidence + (int64_t)(columns - 1) * rows, -rows, MIN(centre + 1, columns), rows, second, of->ends[1]);
    const float *a = first + (int64_t)centre * rows, *b = second + (int64_t)met * rows, *own = evidence + (int64_t)centre * rows;
    for (int r = 0; r < rows; r++) through[r] = a[r] + b[r] - own[r];
    const int row = argmax(through, rows);
    const float without = of->ends[0][3 * centre + WITHOUT] + of->ends[1][3 * met + WITHOUT];
    const int start = through[row] > without ? row : NONE;
    trace(first, of->ends[0], rows, centre, start, found->row + centre, -1);
    trace(second, of->ends[1], rows, met, start, found->row + centre, 1);
    // Rows of the nearest columns with a stripe where there is none.
    int known[MOST_COLUMNS], n = 0;
    for (int c = 0; c < columns; c++) {
        found->is_stripe[c] = found->row[c] != NONE;
        if (found->is_stripe[c]) known[n++] = c;
    }
    if (!n) memset(found->row, 0, sizeof *found->row * (size_t)columns);
    for (int c = 0; n && c < known[0]; c++) found->row[c] = found->row[known[0]];
    for (int i = 0; i + 1 < n; i++) {
        const double slope = 1.0 / (known[i + 1] - known[i]);
        for (int c = known[i] + 1; c < known[i + 1]; c++)
            found->row[c] = found->row[known[(int)rint(slope * (c - known[i]) + i)]];
    }
    for (int c = n ? known[n - 1] + 1 : columns; c < columns; c++) found->row[c] = found->row[known[n - 1]];
    return (double)MAX(through[row], without);
}

