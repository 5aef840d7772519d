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

// Merge sums of cells (n,) as of `sum_cells` into the heights of a grid (rows, columns). They are numbered from the ring around
// the grid on: column * (rows + 2) + row. sums: total of heights, number, total of variances, lowest and highest. work: (3, cells),
// ends: (2, cells). raster: (4, rows, columns) receives mean height and variance of the top layer, lowest and highest, NaN where
// there is nothing.
void merge_cells(const int64_t *cell, const double *total, const float *number, const float *doubt, const float *low,
    const float *high, int64_t n, int64_t rows, int64_t columns, double *work, float *ends, double *raster) {
    const int64_t cells = (rows + 2) * (columns + 2), size = rows * columns;
    double *sum = work, *count = sum + cells, *variance = count + cells;
    float *lowest = ends, *highest = lowest + cells;
    for (int64_t i = 0; i < cells; i++) sum[i] = count[i] = variance[i] = 0, lowest[i] = INFINITY, highest[i] = -INFINITY;
    for (int64_t i = 0; i < n; i++) {
        float *least = lowest + cell[i], *most = highest + cell[i];
        *least = low[i] < *least ? low[i] : *least, *most = high[i] > *most ? high[i] : *most;
    }
    for (int64_t i = 0; i < n; i++)
        if (high[i] > highest[cell[i]] - (float)TOP_LAYER_M)
            sum[cell[i]] += total[i], count[cell[i]] += (double)number[i], variance[cell[i]] += (double)doubt[i];
    for (int64_t r = 0; r < rows; r++)
        for (int64_t c = 0; c < columns; c++) {
            const int64_t at = (c + 1) * (rows + 2) + r + 1;
            const double nan = count[at] > 0 ? 0 : NAN, safe = count[at] > 0 ? count[at] : 1;
            double *out = raster + r * columns + c;
            out[0] = sum[at] / safe + nan, out[size] = variance[at] / safe + nan;
            out[2 * size] = (double)lowest[at] + nan, out[3 * size] = (double)highest[at] + nan;
        }
}
