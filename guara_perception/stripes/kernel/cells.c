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
// on `span` cells hold all samples. work: (5, span). sums: (5, n), and receives, side by side for the cells that samples fall
// into: sum of heights, number, sum of variances, lowest and highest. cells: (n,) receives them. ends: (swaths,) receives where
// those of each swath end.
void sum_cells(const int32_t *cell, const double *height, const double *variance, int64_t n, const int64_t *runs, int64_t number,
    int64_t swaths, int64_t first, int64_t span, double *work, double *sums, int32_t *cells, int64_t *ends) {
    double *total = work, *count = total + span, *doubt = count + span, *low = doubt + span, *high = low + span;
    int64_t used = 0;
    for (int64_t swath = 0; swath < swaths; ends[swath++] = used) {
        // Of the cells, a swath fills few.
        int64_t begin = span, end = 0;
        for (int64_t run = 0, i = 0; run < number; i += runs[number + run++])
            for (int64_t k = i; runs[run] == swath && k < i + runs[number + run]; k++)
                begin = MIN(begin, cell[k] - first), end = MAX(end, cell[k] - first + 1);
        for (int64_t i = begin; i < end; i++) total[i] = count[i] = doubt[i] = 0, low[i] = INFINITY, high[i] = -INFINITY;
        for (int is_sum = 0; is_sum < 2; is_sum++)
            for (int64_t run = 0, i = 0; run < number; i += runs[number + run++])
                for (int64_t k = i; runs[run] == swath && k < i + runs[number + run]; k++) {
                    const int64_t at = cell[k] - first;
                    const double own = height[k];
                    if (!is_sum) low[at] = own < low[at] ? own : low[at], high[at] = own > high[at] ? own : high[at];
                    else if (own > high[at] - TOP_LAYER_M) total[at] += own, count[at]++, doubt[at] += variance[k];
                }
        for (int64_t i = begin; i < end; i++) {
            if (!(high[i] >= low[i])) continue;
            cells[used] = (int32_t)(i + first);
            for (int64_t k = 0; k < 5; k++) sums[k * n + used] = work[k * span + i];
            used++;
        }
    }
}
