// Samples of a surface, summed in the cells of a grid.
#include "kernel.h"

// Samples this far below the highest of a cell belong to another surface; a foot meets the top one [m].
#define TOP_LAYER_M 0.004

// Cells (n,) of samples (3, n): column and row counted from 1, those of unknown and outside ones in the ring around the
// grid; column * (rows + 2) + row. offset: origin of the frame in columns and rows. Gives the first and the last column.
void cells_of_samples(const double *points, int64_t n, double per_cell, const double *offset, int64_t columns, int64_t rows,
    int32_t *cell, int64_t *ends) {
    ends[0] = INT64_MAX, ends[1] = -1;
    for (int64_t i = 0; i < n; i++) {
        const double x = points[i] * per_cell + offset[0], y = points[n + i] * per_cell + offset[1];
        const int is_known = !isnan(points[2 * n + i]);
        // NaN is none of the two, and so in the ring.
        const int64_t column = x >= (double)(columns + 1) ? columns + 1 : x > 0 ? (int64_t)x : 0;
        const int64_t row = !is_known ? 0 : y >= (double)(rows + 1) ? rows + 1 : y > 0 ? (int64_t)y : 0;
        cell[i] = (int32_t)(column * (rows + 2) + row);
        ends[0] = MIN(ends[0], column), ends[1] = MAX(ends[1], column);
    }
}

// Sum the samples of each of several swaths, which come in runs (2, number) of swath and length. first: cell from which
// on each swath has `span` cells. sums: (5, swaths * span), and receives, side by side for the cells that samples fall
// into: sum of heights, number, sum of variances, lowest and highest. cells: receives them. ends: (swaths,) receives where
// those of each swath end.
void sum_cells(const int32_t *cell, const double *height, const double *variance, const int64_t *runs, int64_t number,
    int64_t swaths, int64_t first, int64_t span, double *sums, int32_t *cells, int64_t *ends) {
    const int64_t size = swaths * span;
    double *total = sums, *count = total + size, *doubt = count + size, *low = doubt + size, *high = low + size;
    memset(sums, 0, 3 * (size_t)size * sizeof *sums);
    for (int64_t i = 0; i < size; i++) low[i] = INFINITY, high[i] = -INFINITY;
    for (int is_sum = 0; is_sum < 2; is_sum++)
        for (int64_t run = 0, i = 0; run < number; run++) {
            const int64_t shift = runs[run] * span - first;
            for (const int64_t end = i + runs[number + run]; i < end; i++) {
                const int64_t at = cell[i] + shift;
                const double own = height[i];
                if (!is_sum) low[at] = own < low[at] ? own : low[at], high[at] = own > high[at] ? own : high[at];
                else if (own > high[at] - TOP_LAYER_M) total[at] += own, count[at]++, doubt[at] += variance[i];
            }
        }
    int64_t used = 0;
    for (int64_t swath = 0; swath < swaths; ends[swath++] = used)
        for (int64_t i = swath * span; i < (swath + 1) * span; i++) {
            if (!(high[i] >= low[i])) continue;
            cells[used] = (int32_t)(i - swath * span + first);
            total[used] = total[i], count[used] = count[i], doubt[used] = doubt[i], low[used] = low[i], high[used] = high[i];
            used++;
        }
}
