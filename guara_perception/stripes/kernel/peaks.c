// Smoothed light of a band, its highest peaks, and the width of the stripe.
#include "find.h"

// Bounds of the sigma of a stripe [px]; no lens images a line sharper than the first.
#define LEAST_SIGMA_PX 1.0
#define LARGEST_SIGMA_PX 8.0
#define FWHM_PER_SIGMA 2.3548

// smooth_: sums over three columns and three rows of the whole band, and the highest of every block of rows; light is mirrored
// at the borders. work->values receives samples of the sums over columns, whose number is returned. bins_: sums over BIN_ROWS
// rows. peaks_: highest peak of each column, and highest light outside its block and the two blocks beside it.
#define SMOOTHING(NAME, TYPE)                                                                                          \
    static void columns_##NAME(Light *light, int64_t row, Work *work, TYPE *restrict sums) {                           \
        const int64_t n = light->columns, inner = n > 1;                                                               \
        TYPE *restrict x = (TYPE *)work->light;                                                                        \
        light_of_row(light, row, work->lines, x + 1);                                                                  \
        x[0] = x[1 + inner], x[n + 1] = x[n - inner];                                                                  \
        for (int64_t c = 0; c < n; c++) sums[c] = (TYPE)(x[c] + x[c + 1] + x[c + 2]);                                  \
    }                                                                                                                  \
    static int64_t smooth_##NAME(Light *light, Work *work, TYPE *smooth) {                                             \
        const int64_t rows = light->rows, n = light->columns;                                                          \
        TYPE *ring = (TYPE *)work->ring;                                                                               \
        int64_t samples = 0;                                                                                           \
        for (int64_t r = 0; r <= rows; r++) {                                                                          \
            TYPE *now = ring + r % 3 * n;                                                                              \
            if (r < rows) {                                                                                            \
                columns_##NAME(light, r, work, now);                                                                   \
                if (r % SAMPLE_ROWS == 0)                                                                              \
                    for (int64_t c = 1; c + 1 < n; c += SAMPLE_COLUMNS) work->values[samples++] = (float)now[c];       \
            }                                                                                                          \
            if (r == 0) continue;                                                                                      \
            const TYPE *restrict here = ring + (r - 1) % 3 * n, *before = r > 1 ? ring + (r - 2) % 3 * n : NULL;       \
            const TYPE *after = r < rows ? now : NULL;                                                                 \
            const TYPE *restrict up = before ? before : after ? after : here;                                          \
            const TYPE *restrict low = after ? after : before ? before : here;                                         \
            TYPE *restrict out = smooth + (r - 1) * n;                                                                 \
            TYPE *restrict block = (TYPE *)work->blocks + (r - 1) / BLOCK_ROWS * n;                                    \
            if ((r - 1) % BLOCK_ROWS == 0)                                                                             \
                for (int64_t c = 0; c < n; c++) block[c] = out[c] = (TYPE)(up[c] + here[c] + low[c]);                  \
            else for (int64_t c = 0; c < n; c++) {                                                                     \
                const TYPE sum = (TYPE)(up[c] + here[c] + low[c]);                                                     \
                out[c] = sum, block[c] = MAX(block[c], sum);                                                           \
            }                                                                                                          \
        }                                                                                                              \
        return samples;                                                                                                \
    }                                                                                                                  \
    static void bins_##NAME(const Light *light, const TYPE *smooth, int64_t bins, float *restrict out) {               \
        const int64_t n = light->columns;                                                                              \
        for (int64_t b = 0; b < bins; b++, out += n) {                                                                 \
            const TYPE *restrict x[BIN_ROWS];                                                                          \
            for (int64_t i = 0; i < BIN_ROWS; i++) x[i] = smooth + within(BIN_ROWS * b + i, light->rows) * n;          \
            for (int64_t c = 0; c < n; c++) out[c] = (float)x[0][c] + (float)x[1][c] + (float)x[2][c] + (float)x[3][c];\
        }                                                                                                              \
    }                                                                                                                  \
    static void peaks_##NAME(const Light *light, Work *work, const TYPE *searched, int64_t *restrict top,              \
        float *restrict height, float *restrict second) {                                                              \
        const int64_t rows = light->rows, n = light->columns, blocks = (rows + BLOCK_ROWS - 1) / BLOCK_ROWS;           \
        for (int64_t begin = 0; begin < n; begin += CHUNK) {                                                           \
            const TYPE *restrict all = (TYPE *)work->blocks + begin;                                                   \
            TYPE most[CHUNK], other[CHUNK] = {0}, best[CHUNK] = {0};                                                   \
            const int64_t own = MIN(CHUNK, n - begin);                                                                 \
            for (int64_t c = 0; c < CHUNK; c++) most[c] = all[MIN(c, own - 1)];                                        \
            for (int64_t b = 1; b < blocks; b++) {                                                                     \
                TYPE v[CHUNK] = {0};                                                                                   \
                memcpy(v, all + b * n, (size_t)own * sizeof *v);                                                       \
                for (int c = 0; c < CHUNK; c++) best[c] = v[c] > most[c] ? (TYPE)b : best[c], most[c] = MAX(v[c], most[c]); \
            }                                                                                                          \
            TYPE within_block[CHUNK] = {0};                                                                            \
            for (int64_t b = 0; b < blocks; b++) {                                                                     \
                TYPE v[CHUNK] = {0}, is_best[CHUNK], any = 0;                                                          \
                memcpy(v, all + b * n, (size_t)own * sizeof *v);                                                       \
                for (int c = 0; c < CHUNK; c++) {                                                                      \
                    const TYPE apart = (TYPE)(best[c] - (TYPE)b), far = apart > 1 || apart < -1 ? v[c] : 0;            \
                    other[c] = MAX(other[c], far), is_best[c] = apart == 0, any = MAX(any, is_best[c]);                \
                }                                                                                                      \
                if (!any) continue;                                                                                    \
                /* The first row of the block with this height, all columns at once. */                                \
                for (int64_t r = MIN((b + 1) * BLOCK_ROWS, rows) - 1; r >= b * BLOCK_ROWS; r--) {                      \
                    const TYPE number = (TYPE)(r - b * BLOCK_ROWS);                                                    \
                    memcpy(v, searched + r * n + begin, (size_t)own * sizeof *v);                                      \
                    for (int c = 0; c < CHUNK; c++)                                                                    \
                        within_block[c] = is_best[c] != 0 && v[c] == most[c] ? number : within_block[c];               \
                }                                                                                                      \
            }                                                                                                          \
            for (int64_t i = 0, c = begin; i < own; i++, c++) {                                                        \
                top[c] = (int64_t)best[i] * BLOCK_ROWS + (int64_t)within_block[i];                                     \
                height[c] = (float)most[i], second[c] = (float)MIN(other[i], most[i]);                                 \
            }                                                                                                          \
        }                                                                                                              \
    }
SMOOTHING(int16, int16_t)
SMOOTHING(float, float)

int64_t smooth_light(Light *light, Work *work, void *smooth) {
    return light->is_float ? smooth_float(light, work, smooth) : smooth_int16(light, work, smooth);
}

void find_peaks(const Light *light, Work *work, const void *searched, int64_t *top, float *height, float *second) {
    if (light->is_float) peaks_float(light, work, searched, top, height, second);
    else peaks_int16(light, work, searched, top, height, second);
}

// Light in which a wide stripe is searched for: means of BIN_ROWS rows, smoothed to its width, in work->wide.
void wide_light(const Light *light, Work *work, const void *smooth, double sigma, Light *wide) {
    const int64_t n = light->columns, bins = (light->rows + BIN_ROWS - 1) / BIN_ROWS;
    const double width = sqrt(sigma * sigma - ROW_SMOOTHING_VARIANCE - (BIN_ROWS * BIN_ROWS - 1) / 12.0) / BIN_ROWS;
    const int64_t reach = MIN((int64_t)ceil(2 * width), MOST_BINS);
    float taps[MOST_BINS + 1];
    double all = 1;
    for (int64_t t = 1; t <= reach; t++) all += 2 * exp(-0.5 * (double)(t * t) / (width * width));
    for (int64_t t = 0; t <= reach; t++) taps[t] = (float)(exp(-0.5 * (double)(t * t) / (width * width)) / all / BIN_ROWS);
    if (light->is_float) bins_float(light, smooth, bins, work->bins);
    else bins_int16(light, smooth, bins, work->bins);
    *wide = *light, wide->rows = bins, wide->is_float = 1, wide->step = BIN_ROWS;
    for (int64_t b = 0; b < bins; b++) {
        const float *restrict here = work->bins + b * n;
        float *restrict out = work->wide + b * n, *restrict block = (float *)work->blocks + b / BLOCK_ROWS * n;
        for (int64_t c = 0; c < n; c++) out[c] = taps[0] * here[c];
        for (int64_t t = 1; t <= reach; t++) {
            const float *restrict up = work->bins + within(b - t, bins) * n, *restrict low = work->bins + within(b + t, bins) * n;
            for (int64_t c = 0; c < n; c++) out[c] += taps[t] * (up[c] + low[c]);
        }
        for (int64_t c = 0; c < n; c++) block[c] = b % BLOCK_ROWS ? MAX(block[c], out[c]) : out[c];
    }
}

// Second peak of each column: highest light at which, going away from the top of a wide stripe, the light has risen again by more
// than `rise`; 0 if there is none.
void find_rises(const Light *light, Work *work, const int64_t *top, float rise, float *restrict second) {
    const int64_t n = light->columns;
    float *restrict lowest = (float *)work->light;
    for (int64_t c = 0; c < n; c++) second[c] = 0;
    for (int64_t is_up = 0; is_up < 2; is_up++)
        for (int64_t i = 0; i < light->rows; i++) {
            const int64_t r = is_up ? light->rows - 1 - i : i;
            const float *restrict x = work->wide + r * n;
            for (int64_t c = 0; c < n; c++) {
                const float low = (is_up ? r < top[c] : r > top[c]) ? MIN(lowest[c], x[c]) : x[c];
                const float other = x[c] - low > rise ? x[c] : 0;
                lowest[c] = low, second[c] = MAX(second[c], other);
            }
        }
}

// Typical width of a stripe as the sigma of a Gaussian [px], from the number of rows brighter than half the peak: only the
// unbroken run around the top counts, not a second stripe elsewhere. smoothed: variance added by the smoothing over rows [px^2].
// some, top, height: (n,) examined columns, row and height of their peaks. work: (n,).
double stripe_sigma(const void *smooth, int64_t is_float, int64_t rows, int64_t columns, const int64_t *top,
    const float *height, const int64_t *some, int64_t n, double smoothed, float *work) {
    const int64_t reach = (int64_t)ceil(FWHM_PER_SIGMA * LARGEST_SIGMA_PX);
    for (int64_t i = 0; i < n; i++) {
        const float half = 0.5f * height[i];
        int64_t low = 0, up = 0;
        const int64_t below = MIN(reach, rows - top[i]), above = MIN(reach, top[i] + 1);
        while (low < below && value(smooth, is_float, (top[i] + low) * columns + some[i]) > half) low++;
        while (up < above && value(smooth, is_float, (top[i] - up) * columns + some[i]) > half) up++;
        work[i] = (float)(low + up - 1);
    }
    const double width = n ? (double)upper_median(work, n) / FWHM_PER_SIGMA : 0;
    return MIN(MAX(sqrt(MAX(width * width - smoothed, 0)), LEAST_SIGMA_PX), LARGEST_SIGMA_PX);
}

// Responses (shifts, columns) of filters (shifts, taps) about the top of each column of light (rows, columns).
void responses(const void *light, int64_t is_float, int64_t rows, int64_t columns, const int64_t *top,
    const float *filters, int64_t taps, float *out) {
    for (int64_t begin = 0; begin < columns; begin += CHUNK) {
        const int64_t n = MIN(CHUNK, columns - begin);
        float sums[SHIFTS][CHUNK] = {0}, seen[CHUNK] = {0};
        for (int64_t t = 0; t < taps; t++) {
            if (is_float) for (int64_t i = 0; i < n; i++)
                seen[i] = ((const float *)light)[within(top[begin + i] - taps / 2 + t, rows) * columns + begin + i];
            else for (int64_t i = 0; i < n; i++)
                seen[i] = ((const int16_t *)light)[within(top[begin + i] - taps / 2 + t, rows) * columns + begin + i];
            for (int s = 0; s < SHIFTS; s++)
                for (int i = 0; i < CHUNK; i++) sums[s][i] += filters[s * taps + t] * seen[i];
        }
        for (int s = 0; s < SHIFTS; s++) memcpy(out + s * columns + begin, sums[s], (size_t)n * sizeof(float));
    }
}

