// What stands out across the columns of a picture: its details, and its ridges of some widths.
#include "kernel.h"

// Columns that are handled at a time, so that all their rows stay in the cache.
#define STRIP (4 * LANES)

// Numbers in a vector register, anywhere in memory.
typedef float Eight __attribute__((vector_size(32), aligned(4), may_alias));

// Means of three pixels beside each other, of weights (side, centre, side), in a strip of numbers of a row (size,) whose
// neighbours are `apart` numbers away; pixels beyond the ends are those at the ends, or mirrored at them.
static void across(const float *restrict row, int64_t size, int64_t apart, int64_t first, float side, float centre,
    int is_mirrored, float *restrict out) {
    if (first >= apart && first + STRIP + apart <= size) {
        const float *restrict x = row + first;
        for (int i = 0; i < STRIP; i++) out[i] = centre * x[i] + side * (x[i - apart] + x[i + apart]);
        return;
    }
    for (int64_t i = first; i < first + STRIP; i++) {
        if (i >= size) { out[i - first] = 0; continue; }
        const int64_t left = i >= apart ? i - apart : is_mirrored && i + apart < size ? i + apart : i;
        const int64_t right = i + apart < size ? i + apart : is_mirrored && i >= apart ? i - apart : i;
        out[i - first] = centre * row[i] + side * (row[left] + row[right]);
    }
}

// Sums over rows of a strip (rows, STRIP), with weights taps[0] of the row and taps[t] of those t rows away. Before and
// after the strip there is room for `reach` rows, which are those at the ends, or mirrored at them.
static void down(float *x, int64_t rows, const float *restrict taps, int64_t reach, int is_mirrored, float *restrict out) {
    for (int64_t t = 1; t <= reach; t++) {
        const int64_t first = is_mirrored ? within(t, rows) : 0, last = is_mirrored ? within(rows - 1 - t, rows) : rows - 1;
        memcpy(x - t * STRIP, x + first * STRIP, STRIP * sizeof *x);
        memcpy(x + (rows - 1 + t) * STRIP, x + last * STRIP, STRIP * sizeof *x);
    }
    for (int64_t i = 0; i < rows * STRIP; i += 8) {
        Eight sum = taps[0] * *(const Eight *)(x + i);
        for (int64_t t = 1; t <= reach; t++)
            sum += taps[t] * (*(const Eight *)(x + i - t * STRIP) + *(const Eight *)(x + i + t * STRIP));
        *(Eight *)(out + i) = sum;
    }
}

// The part of each channel of a picture (rows, columns, channels) that changes from row to row within a few pixels:
// smoothed by weights over three columns and some rows, minus the mean of the pixels `side` rows above and below.
// work: (2, rows + reach, 64).
void details(const float *picture, int64_t rows, int64_t columns, int64_t channels, const float *column_taps,
    const float *row_taps, int64_t reach, int64_t side, float *work, float *out) {
    const int64_t size = columns * channels;
    float *mean = work + reach * STRIP, *smooth = mean + (rows + reach) * STRIP;
    for (int64_t first = 0; first < size; first += STRIP) {
        for (int64_t r = 0; r < rows; r++)
            across(picture + r * size, size, channels, first, column_taps[1], column_taps[0], 1, mean + r * STRIP);
        down(mean, rows, row_taps, reach, 1, smooth);
        const int64_t n = MIN(STRIP, size - first);
        for (int64_t r = 0; r < rows; r++) {
            const float *restrict x = smooth + r * STRIP, *restrict u = smooth + within(r - side, rows) * STRIP;
            const float *restrict d = smooth + within(r + side, rows) * STRIP;
            float *restrict to = out + r * size + first;
            for (int64_t i = 0; i < n; i++) to[i] = (u[i] + d[i]) * -0.5f + x[i];
        }
    }
}

// Heights (rows, columns) of ridges of one width: the light, the mean of three columns smoothed over rows by weights,
// above the higher of the pixels `side` rows above and below. work: (2, rows + reach, 64).
void ridges(const float *light, int64_t rows, int64_t columns, const float *taps, int64_t reach, int64_t side,
    float *work, float *heights) {
    const float third = (float)(1.0 / 3);
    float *mean = work + reach * STRIP, *smooth = mean + (rows + reach) * STRIP;
    for (int64_t first = 0; first < columns; first += STRIP) {
        for (int64_t r = 0; r < rows; r++)
            across(light + r * columns, columns, 1, first, third, third, 0, mean + r * STRIP);
        down(mean, rows, taps, reach, 0, smooth);
        const int64_t n = MIN(STRIP, columns - first);
        for (int64_t r = 0; r < rows; r++) {
            const float *restrict x = smooth + r * STRIP, *restrict u = smooth + within(r - side, rows) * STRIP;
            const float *restrict d = smooth + within(r + side, rows) * STRIP;
            float *restrict to = heights + r * columns + first;
            for (int64_t i = 0; i < n; i++) to[i] = x[i] - MAX(u[i], d[i]);
        }
    }
}

// The highest of the ridges of three widths at each of n pixels, over the noise of its width.
void strongest(const float *restrict a, const float *restrict b, const float *restrict c, int64_t n, double noise_a,
    double noise_b, double noise_c, float *restrict strength) {
    const float s = (float)(1 / noise_a), t = (float)(1 / noise_b), u = (float)(1 / noise_c);
    for (int64_t i = 0; i < n; i++) strength[i] = MAX(MAX(a[i] * s, b[i] * t), c[i] * u);
}

// Evidence of n ridges: `zero` less than their strength, and from `linear` on the logarithm grows by `gain`.
void evidence(const float *restrict strength, int64_t n, double zero, double linear, double gain, float *restrict out) {
    const float z = (float)zero, l = (float)linear, g = (float)gain;
    for (int64_t i = 0; i < n; i++) out[i] = MIN(strength[i], l) - z;
    // Few pixels are that strong. In double precision logarithms are the same with every mathematical library.
    for (int64_t i = 0; i < n; i++) if (strength[i] > l) out[i] += g * (float)log((double)(strength[i] / l));
}
