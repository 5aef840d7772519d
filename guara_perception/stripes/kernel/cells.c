// Samples of a surface, summed in the cells of a grid.
#include "kernel.h"

// Samples this far below the highest of a cell belong to another surface; a foot meets the top one [m].
#define TOP_LAYER_M 0.004

// Cells (n,) of samples (3, n): column and row counted from 1, those of unknown and outside ones in the ring around the
// grid; column * (rows + 2) + row. offset: origin of the frame in columns and rows. Gives the first and the last column.
void cells_of_samples(const double *points, int64_t n, double per_cell, const double *offset, int64_t columns, int64_t rows,
    int32_t *restrict cell, int64_t *ends) {
    int32_t first = INT32_MAX, last = -1;
    const double from_x = offset[0], from_y = offset[1], most_x = (double)(columns + 1), most_y = (double)(rows + 1);
    const int32_t per_column = (int32_t)rows + 2;
    for (int64_t i = 0; i < n; i++) {
        double x = points[i] * per_cell + from_x, y = points[n + i] * per_cell + from_y;
        // NaN is not above 0, and so in the ring.
        x = x > 0 ? x : 0, y = y > 0 ? y : 0;
        x = x < most_x ? x : most_x, y = y < most_y ? y : most_y;
        y = isnan(points[2 * n + i]) ? 0 : y;
        const int32_t column = (int32_t)x, row = (int32_t)y;
        cell[i] = column * per_column + row;
        first = MIN(first, column), last = MAX(last, column);
    }
    ends[0] = n ? first : INT64_MAX, ends[1] = last;
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
                for (int64_t k = i, end_of_run = runs[run] == swath ? i + runs[number + run] : i; k < end_of_run;) {
                    // Neighbouring samples often fall into one cell, whose sums then stay in registers.
                    const int64_t own = cell[k], at = own - first;
                    double least = low[at], most = high[at], sum = total[at], samples = count[at], doubts = doubt[at];
                    if (!is_sum)
                        for (; k < end_of_run && cell[k] == own; k++) least = MIN(height[k], least), most = MAX(height[k], most);
                    else for (const double from = most - TOP_LAYER_M; k < end_of_run && cell[k] == own; k++)
                        if (height[k] > from) sum += height[k], samples++, doubts += variance[k];
                    low[at] = least, high[at] = most, total[at] = sum, count[at] = samples, doubt[at] = doubts;
                }
        for (int64_t i = begin; i < end; i++) {
            if (!(high[i] >= low[i])) continue;
            cells[used] = (int32_t)(i + first);
            for (int64_t k = 0; k < 5; k++) sums[k * n + used] = work[k * span + i];
            used++;
        }
    }
}

// Merge sums of cells (n,) as of `sum_cells` into the heights of columns of a grid, from `first` on (rows, columns). They are
// numbered from the ring around the grid on: column * (rows + 2) + row; those of other columns are left out. sums: total of
// heights, number, total of variances, lowest and highest. work: (3, cells), ends: (2, cells) of these columns and of one more on
// each side. raster: (4, rows, columns) receives mean height and variance of the top layer, lowest and highest, NaN where there is
// nothing.
void merge_cells(const int32_t *cell, const double *total, const float *number, const float *doubt, const float *low,
    const float *high, int64_t n, int64_t first, int64_t rows, int64_t columns, double *work, float *ends, double *raster) {
    const int64_t cells = (rows + 2) * (columns + 2), size = rows * columns, before = first * (rows + 2);
    double *sum = work, *count = sum + cells, *variance = count + cells;
    float *lowest = ends, *highest = lowest + cells;
    for (int64_t i = 0; i < cells; i++) sum[i] = count[i] = variance[i] = 0, lowest[i] = INFINITY, highest[i] = -INFINITY;
    for (int64_t i = 0; i < n; i++) {
        const int64_t at = cell[i] - before;
        if (at < 0 || at >= cells) continue;
        lowest[at] = low[i] < lowest[at] ? low[i] : lowest[at], highest[at] = high[i] > highest[at] ? high[i] : highest[at];
    }
    for (int64_t i = 0; i < n; i++) {
        const int64_t at = cell[i] - before;
        if (at >= 0 && at < cells && high[i] > highest[at] - (float)TOP_LAYER_M)
            sum[at] += total[i], count[at] += (double)number[i], variance[at] += (double)doubt[i];
    }
    for (int64_t r = 0; r < rows; r++)
        for (int64_t c = 0; c < columns; c++) {
            const int64_t at = (c + 1) * (rows + 2) + r + 1;
            const double nan = count[at] > 0 ? 0 : NAN, safe = count[at] > 0 ? count[at] : 1;
            double *out = raster + r * columns + c;
            out[0] = sum[at] / safe + nan, out[size] = variance[at] / safe + nan;
            out[2 * size] = (double)lowest[at] + nan, out[3 * size] = (double)highest[at] + nan;
        }
}
