// The highest peak of every column.
#include "kernel.h"

#define BLOCK_ROWS 8

// light: (rows, columns). top, height: (columns,) first row of the highest value, and that value. second: (columns,)
// highest value at least one block of rows away from the peak's block, neither below 0 nor above the peak.
// work: (rows / BLOCK_ROWS + 1, LANES).
#define HIGHEST_PEAKS(NAME, TYPE)                                                                                      \
    void NAME(const TYPE *light, int64_t rows, int64_t columns, int64_t *top, float *height, float *second,            \
        TYPE *work) {                                                                                                  \
        const int64_t blocks = (rows + BLOCK_ROWS - 1) / BLOCK_ROWS;                                                   \
        for (int64_t begin = 0; begin < columns; begin += LANES) {                                                     \
            /* The last columns are taken together with some before, so that there are always as many. */             \
            const int64_t first = MAX(MIN(begin, columns - LANES), 0), n = MIN(columns, LANES);                        \
            for (int64_t b = 0; b < blocks; b++) {                                                                     \
                const int64_t end = MIN((b + 1) * BLOCK_ROWS, rows);                                                   \
                TYPE most[LANES];                                                                                      \
                memcpy(most, light + b * BLOCK_ROWS * columns + first, (size_t)n * sizeof *most);                      \
                for (int64_t r = b * BLOCK_ROWS + 1; r < end; r++) {                                                   \
                    const TYPE *restrict x = light + r * columns + first;                                              \
                    if (n == LANES) for (int k = 0; k < LANES; k++) most[k] = MAX(x[k], most[k]);                      \
                    else for (int k = 0; k < n; k++) most[k] = MAX(x[k], most[k]);                                     \
                }                                                                                                      \
                memcpy(work + b * LANES, most, (size_t)n * sizeof *most);                                              \
            }                                                                                                          \
            for (int64_t k = 0; k < n; k++) {                                                                          \
                int64_t best = 0;                                                                                      \
                TYPE other = 0;                                                                                        \
                for (int64_t b = 1; b < blocks; b++) best = work[b * LANES + k] > work[best * LANES + k] ? b : best;   \
                for (int64_t b = 0; b < blocks; b++)                                                                   \
                    if (b < best - 1 || b > best + 1) other = MAX(work[b * LANES + k], other);                         \
                const TYPE highest = work[best * LANES + k];                                                           \
                int64_t row = best * BLOCK_ROWS;                                                                       \
                while (row < rows - 1 && light[row * columns + first + k] != highest) row++;                           \
                top[first + k] = row, height[first + k] = (float)highest;                                              \
                second[first + k] = (float)MIN(other, highest);                                                        \
            }                                                                                                          \
        }                                                                                                              \
    }
HIGHEST_PEAKS(highest_peaks_int16, int16_t)
HIGHEST_PEAKS(highest_peaks_float, float)
