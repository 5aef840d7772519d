// Sums of the samples of a surface in the cells of a grid.
#include "kernel.h"

// Samples this far below the highest of a cell belong to another surface; a foot touches the top one [m].
#define TOP_LAYER_M 0.004

// Cells (n,) of samples (3, n), as column * (rows + 2) + row. Columns and rows are counted from 1; samples of unknown height or
// outside the grid fall into the ring around it. offset: column and row of the origin of the frame. ends: receives the first and
// the last column.
void cells_of_samples(const double *points, int64_t n, double per_cell, const double *offset, int64_t columns, int64_t rows,
    int32_t *restrict cell, int64_t *ends) {
    int32_t first = INT32_MAX, last = -1;
    const double from_x = offset[0], from_y = offset[1], most_x = (double)(columns + 1), most_y = (double)(rows + 1);
    const int32_t per_column = (int32_t)rows + 2;
    for (int64_t i = 0; i < n; i++) {
        double x = points[i] * per_cell + from_x, y = points[n + i] * per_cell + from_y;
        // NaN fails the comparison and falls into the ring.
        x = x > 0 ? x : 0, y = y > 0 ? y : 0;
        x = x < most_x ? x : most_x, y = y < most_y ? y : most_y;
        y = isnan(points[2 * n + i]) ? 0 : y;
        const int32_t column = (int32_t)x, row = (int32_t)y;
        cell[i] = column * per_column + row;
        first = MIN(first, column), last = MAX(last, column);
    }
    ends[0] = n ? first : INT64_MAX, ends[1] = last;
}

// Sum the samples of each of several swaths per cell. runs: (2, number) swath and length of each run of successive samples. The
// `span` cells from `first` on contain all samples. work: (5, span). sums: (5, n), receives for each cell with samples: sum of the
// heights, number and sum of the variances of its top layer, lowest and highest height. cells: (n,) receives these cells. ends:
// (swaths,) receives the end of each swath in both.
void sum_cells(const int32_t *cell, const double *height, const double *variance, int64_t n, const int64_t *runs, int64_t number,
    int64_t swaths, int64_t first, int64_t span, double *work, double *sums, int32_t *cells, int64_t *ends) {
    double *total = work, *count = total + span, *doubt = count + span, *low = doubt + span, *high = low + span;
    int64_t used = 0;
    for (int64_t swath = 0; swath < swaths; ends[swath++] = used) {
        // A swath fills only a few of the cells.
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

// Merge sums of cells (n,) from `sum_cells` into the heights of part of a grid (rows, columns), which begins at column `first`.
// Cells are numbered as in `cells_of_samples`; those in other columns are ignored. total, number, doubt, low, high: (n,) sums as
// in `sum_cells`. work: (3, cells) and ends: (2, cells), for these columns and one more on each side. raster: (4, rows, columns)
// receives mean height and variance of the top layer, lowest and highest height, NaN where there are no samples.
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
