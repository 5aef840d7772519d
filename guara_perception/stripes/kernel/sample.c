// Light of a frame, from a few of its pixels.
#include "kernel.h"

// The background of a column is the median of every USUAL_ROWS_APART-th of the sampled rows. The stripe stands out from it by
// LEAST_LEVEL [grey levels of 255] and by LEAST_SIGMAS median absolute deviations.
enum { USUAL_ROWS_APART = 8 };
// Prefetch distance in sampled rows and in sampled pixels, which are far apart in memory.
enum { AHEAD = 4, AHEAD_PIXELS = 24 };
#define LEAST_LEVEL 12.0f
#define LEAST_SIGMAS 8.0f

// Compile a loop twice: for colour pictures of 8 bits, whose channels and size the compiler then knows, and for all others.
#define FOR_KIND(P, CALL) \
    if ((P)->channels == 3 && (P)->size == 1) CALL(3, 1); else CALL((P)->channels, (P)->size)
#define ALWAYS static inline __attribute__((always_inline))

ALWAYS int32_t brightest_of(const Picture *p, int64_t row, int64_t column, int64_t channels) {
    int32_t most = level(p, row, column, 0);
    for (int64_t k = 1; k < channels; k++) most = MAX(most, level(p, row, column, k));
    return most;
}

// Bytes of `memory` of `levels_of` and of `look_down`.
int64_t levels_size(const Picture *p) { return 8 * (p->size == 1 ? 256 : 65536); }
int64_t look_down_size(int64_t rows, int64_t n) { return 4 * (rows * n + rows / USUAL_ROWS_APART + 1 + 2 * n); }

// Count the levels, of all channels, in every pixels_apart-th pixel of every rows_apart-th row. Returns the number of these
// pixels that are clipped in any channel.
ALWAYS int64_t count_levels(Picture p, int64_t channels, int64_t size, int64_t rows_apart, int64_t pixels_apart, int64_t *counts) {
    const int32_t from = clipped_from(&p);
    int64_t clipped = 0;
    p.size = size;
    for (int64_t r = 0; r < p.rows; r += rows_apart)
        for (int64_t c = 0; c < p.columns; c += pixels_apart) {
            const int64_t soon = c + AHEAD_PIXELS * pixels_apart, row = soon < p.columns ? r : MIN(r + rows_apart, p.rows - 1);
            __builtin_prefetch(p.data + row * p.row_step + soon % p.columns * p.column_step);
            for (int64_t k = 0; k < channels; k++) counts[level(&p, r, c, k)]++;
            clipped += brightest_of(&p, r, c, channels) >= from;
        }
    return clipped;
}

// Mean level of every pixels_apart-th pixel of every rows_apart-th row without the brightest `share` of the samples, and fraction
// of these pixels that are clipped in any channel.
void levels_of(const Picture *p, int64_t rows_apart, int64_t pixels_apart, double share, int64_t *memory, double *found) {
    const int64_t across = (p->columns + pixels_apart - 1) / pixels_apart, pixels = (p->rows + rows_apart - 1) / rows_apart * across;
    int64_t clipped = 0, left = 0, number = 0;
    double sum = 0;
    memset(memory, 0, (size_t)levels_size(p));
#define COUNT(CHANNELS, SIZE) clipped = count_levels(*p, CHANNELS, SIZE, rows_apart, pixels_apart, memory)
    FOR_KIND(p, COUNT);
    number = left = MAX((int64_t)rint((1 - share) * (double)(pixels * p->channels)), 1);
    for (int64_t value = 0; left > 0; value++) {
        const int64_t own = MIN(memory[value], left);
        sum += (double)(own * value), left -= own;
    }
    found[0] = sum / (double)number, found[1] = (double)clipped / (double)pixels;
}

// Light (n, rows) of every apart-th row in some columns (n,): largest difference of a channel from the laser-off picture [grey
// levels of 255]. cores: (n,) receives the number of these rows in which the laser clips a channel.
ALWAYS void light_at(Picture on, Picture off, int is_off, int64_t channels, int64_t size, int64_t apart, const int64_t *columns,
    int64_t n, float *light, float *cores) {
    const int64_t rows = (on.rows + apart - 1) / apart;
    const int32_t from = clipped_from(&on);
    on.size = off.size = size;
    for (int64_t i = 0; i < n; i++) cores[i] = 0;
    for (int64_t r = 0; r < rows; r++)
        for (int64_t i = 0; i < n; i++) {
            const int64_t row = r * apart, c = columns[i], soon = MIN(row + AHEAD * apart, on.rows - 1);
            __builtin_prefetch(on.data + soon * on.row_step + c * on.column_step);
            if (is_off) __builtin_prefetch(off.data + soon * off.row_step + c * off.column_step);
            int32_t most = INT32_MIN;
            for (int64_t k = 0; k < channels; k++)
                most = MAX(most, level(&on, row, c, k) - (is_off ? level(&off, row, c, k) : 0));
            light[i * rows + r] = size == 1 ? (float)most : (float)most / 257.0f;
            if (brightest_of(&on, row, c, channels) < from) continue;
            cores[i] += (float)!(is_off && brightest_of(&off, row, c, channels) >= from);
        }
}

// Brightest of every apart-th row in some columns (n,). off: laser-off picture, which is subtracted, or NULL. brightest: (n,)
// receives the number of that row among the sampled ones, NaN where none stands out. Returns the number of sampled rows that the
// laser clips, as the median over the columns that have any; 0 without any.
double look_down(const Picture *on, const Picture *off, int64_t apart, const int64_t *columns, int64_t n, float *memory,
    double *brightest) {
    const int64_t rows = (on->rows + apart - 1) / apart;
    float *light = memory, *cores = light + rows * n, *some = cores + 2 * n;
    int64_t count = 0;
#define LIGHT(CHANNELS, SIZE) light_at(*on, off ? *off : *on, off != NULL, CHANNELS, SIZE, apart, columns, n, light, cores)
    FOR_KIND(on, LIGHT);
    for (int64_t i = 0; i < n; i++) {
        const float *own = light + i * rows;
        int64_t m = 0, top = 0;
        for (int64_t r = 0; r < rows; r++) {
            if (own[r] > own[top]) top = r;
            if (r % USUAL_ROWS_APART == 0) some[m++] = own[r];
        }
        const float usual = (float)median(some, m), height = own[top] - usual;
        for (int64_t k = 0; k < m; k++) some[k] = fabsf(some[k] - usual);
        brightest[i] = height > MAX(LEAST_LEVEL, LEAST_SIGMAS * (float)median(some, m)) ? (double)top : NAN;
        if (cores[i] > 0) cores[n + count++] = cores[i];
    }
    return count ? median(cores + n, count) : 0;
}
