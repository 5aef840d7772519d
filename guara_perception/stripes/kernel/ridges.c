// Ridges of several widths: height of the light above the higher of its two sides. An edge between dark and bright, to which a
// second derivative responds as to a line, is no ridge by this definition.
#include "any_light.h"

// Evidence of a ridge of strength s: min(s, LINEAR) - ZERO, plus GAIN_OF_LOG * log(s / LINEAR) above LINEAR.
#define ZERO 3.2f
#define LINEAR 8.0f
#define GAIN_OF_LOG 3.0f
// Noise of fewer grey levels than this cannot be separated from quantisation. Texture counts as noise of
// which TEXTURE_QUANTILE is below TEXTURE_SIGMAS sigmas.
#define LEAST_NOISE 0.15
#define TEXTURE_QUANTILE 0.99
#define TEXTURE_SIGMAS 3.0
// A pair with at least this many columns is sampled in every sixth of them.
#define LEAST_THINNED 160
// Number of parts of equal size into which a scene is divided by brightness, to measure the noise of each.
#define PARTS 8
// Rows of a strip above and below the picture, which repeat its first and last row. A strip stays in the first-level cache.
#define BEYOND 12

// Light of a strip (rows, STRIP) smoothed over rows to one width, then its height above the higher side. The loops have constant
// length and become vector instructions.
#define RIDGE(K, REACH, SIDE)                                                                                          \
    static void ridge##K(const float *restrict strip, float *restrict smooth, int64_t rows, const float *restrict taps, \
        float *restrict out) {                                                                                         \
        strip += BEYOND * STRIP, smooth += BEYOND * STRIP;                                                             \
        for (int64_t i = 0; i < rows * STRIP; i++) {                                                                   \
            float sum = taps[REACH] * strip[i];                                                                        \
            _Pragma("GCC unroll 10") for (int t = 1; t <= REACH; t++)                                                  \
                sum += taps[REACH + t] * (strip[i - t * STRIP] + strip[i + t * STRIP]);                                \
            smooth[i] = sum;                                                                                           \
        }                                                                                                              \
        extend(smooth - BEYOND * STRIP, rows);                                                                         \
        for (int64_t i = 0; i < rows * STRIP; i++)                                                                     \
            out[i] = smooth[i] - MAX(smooth[i - SIDE * STRIP], smooth[i + SIDE * STRIP]);                              \
    }
static void extend(float *strip, int64_t rows) { // strip[0] is row -BEYOND
    for (int64_t i = 0; i < BEYOND; i++) {
        memcpy(strip + i * STRIP, strip + BEYOND * STRIP, STRIP * sizeof *strip);
        memcpy(strip + (BEYOND + rows + i) * STRIP, strip + (BEYOND + rows - 1) * STRIP, STRIP * sizeof *strip);
    }
}
RIDGE(0, 3, 3) RIDGE(1, 5, 6) RIDGE(2, 10, 12)

// Heights (WIDTHS, rows) of a strip of columns `begin`, `begin + step`, ...; those beyond the picture repeat its last column.
static void heights_of_strip(const float *laser, int64_t rows, int64_t width, int64_t begin, int64_t step,
    float taps[WIDTHS][32], float *strip, float *smooth, float *heights) {
    const float third = (float)(1.0 / 3);
    const int is_inside = begin > 0 && begin + STRIP * step < width;
    for (int64_t r = 0; r < rows; r++) { // mean of three columns, borders replicated
        const float *restrict row = laser + r * width, *restrict x = row + begin;
        float *restrict to = strip + (BEYOND + r) * STRIP;
        if (is_inside && step == 1) for (int c = 0; c < STRIP; c++) to[c] = third * x[c] + third * (x[c - 1] + x[c + 1]);
        else if (is_inside) for (int64_t c = 0, i = 0; c < STRIP; c++, i += step) to[c] = third * x[i] + third * (x[i - 1] + x[i + 1]);
        else for (int64_t c = 0; c < STRIP; c++) {
            const int64_t at = MIN(begin + c * step, width - 1);
            to[c] = third * row[at] + third * (row[MAX(at - 1, 0)] + row[MIN(at + 1, width - 1)]);
        }
    }
    extend(strip, rows);
    const int64_t n = rows * STRIP;
    ridge0(strip, smooth, rows, taps[0], heights), ridge1(strip, smooth, rows, taps[1], heights + n);
    ridge2(strip, smooth, rows, taps[2], heights + 2 * n);
}

// Factors of the strength of a ridge by the level of the scene: the variance of a camera's noise grows in proportion to the light
// (photon transfer, EMVA standard 1288). Where the scene is darker than usual, the factor stays 1, because otherwise a halo alone
// would count as a stripe there. ordered: (n,) heights of ridges of noise, by rising level. number: (256,) count of each level.
static void quiet_levels(float *ordered, const int32_t *number, int64_t n, Noises *found) {
    double levels[PARTS], variances[PARTS], mean = 0, variance = 0, above = 0, square = 0;
    for (int i = 0; i < PARTS; i++) {
        const int64_t first = i * n / PARTS, end = (i + 1) * n / PARTS;
        int64_t rest = (first + end) / 2;
        int level = 0;
        while (rest >= number[level]) rest -= number[level++];
        const double sigma = robust_sigma(ordered + first, end - first);
        levels[i] = level, variances[i] = sigma * sigma;
        mean += levels[i] / PARTS, variance += variances[i] / PARTS;
    }
    for (int i = 0; i < PARTS; i++) above += (levels[i] - mean) * variances[i], square += (levels[i] - mean) * (levels[i] - mean);
    const double slope = MAX(above / MAX(square, 1.0), 0.0), usual = found->noises[0] * found->noises[0];
    for (int level = 0; level < 256; level++)
        found->quiet[level] = (float)sqrt(usual / MAX(variance + slope * ((double)level - mean), usual));
}

// Noise of the ridge filters. If `away` is given, texture more than `reach` rows from that path counts as noise too.
void noises_of_ridges(const View *v, const float *laser, const Path *away, int reach, Noises *found, Any *w) {
    const int is_pair = v->scene->has_dark && v->scene->channels == CHANNELS; // in which fewer samples suffice
    const int64_t rows = v->rows, width = v->width, step = !away ? 7 : is_pair && width >= LEAST_THINNED ? 6 : 3;
    float taps[WIDTHS][32], *some[WIDTHS];
    enum { DOWN = 2 };
    const int64_t most = (rows / DOWN + 1) * (width / 3 + 1);
    taps_of_ridges(taps);
    for (int k = 0; k < WIDTHS; k++) some[k] = w->samples + k * most;
    float *strip = w->line, *smooth = strip + (rows + 2 * BEYOND) * STRIP, *heights = smooth + (rows + 2 * BEYOND) * STRIP;
    uint8_t *level = (uint8_t *)(w->samples + WIDTHS * most);
    int64_t n = 0, near = 1;
    for (int64_t begin = 0; begin < width; begin += STRIP * step) {
        heights_of_strip(laser, rows, width, begin, step, taps, strip, smooth, heights);
        for (int64_t c = 0; c < STRIP && begin + c * step < width; c++) {
            const int64_t at = begin + c * step;
            const int is_stripe = away && away->is_stripe[at];
            const int64_t low = is_stripe ? away->row[at] - reach : rows, high = low + 2 * reach;
            for (int64_t r = 0; r < rows; r += DOWN) {
                const int is_away = (r < low) | (r > high);
                const int64_t to = is_away ? n : most - near;
                for (int k = 0; k < WIDTHS; k++) some[k][to] = heights[(k * rows + r) * STRIP + c];
                if (v->level) level[to] = v->level[r * width + at];
                n += is_away, near += !is_away;
            }
        }
    }
    int32_t number[256] = {0}, first[256] = {0};
    const int is_known = v->level && n >= 2 * PARTS;
    float *ordered = w->closed;
    if (is_known) { // sorted by level, by counting
        for (int64_t i = 0; i < n; i++) number[level[i]]++;
        for (int i = 1; i < 256; i++) first[i] = first[i - 1] + number[i - 1];
        for (int64_t i = 0; i < n; i++) ordered[first[level[i]]++] = some[0][i];
    }
    for (int k = 0; k < WIDTHS; k++) {
        const double texture = n && away ? (double)select_value(some[k], n, (int64_t)(TEXTURE_QUANTILE * (double)n)) / TEXTURE_SIGMAS : 0;
        int64_t all = n;
        if (!is_pair) {
            all += near - 1;
            memmove(some[k] + n, some[k] + most - near + 1, sizeof **some * (size_t)(near - 1));
        }
        const double noise = all ? robust_sigma(some[k], all) : 0;
        found->noises[k] = MAX(MAX(noise, texture), LEAST_NOISE);
    }
    if (is_known) quiet_levels(ordered, number, n, found);
}

// Strength (rows, width) of the strongest ridge at every pixel, unless NULL, and its evidence (width, rows).
void strengths(const View *v, const float *laser, const Noises *noises, float *strength, float *evidence, float *line) {
    const int64_t rows = v->rows, width = v->width, size = rows * STRIP;
    const float f0 = (float)(1 / noises->noises[0]), f1 = (float)(1 / noises->noises[1]), f2 = (float)(1 / noises->noises[2]);
    float taps[WIDTHS][32];
    taps_of_ridges(taps);
    float *strip = line, *smooth = strip + (rows + 2 * BEYOND) * STRIP, *heights = smooth + (rows + 2 * BEYOND) * STRIP;
    for (int64_t begin = 0; begin < width; begin += STRIP) {
        const int64_t n = MIN(STRIP, width - begin);
        heights_of_strip(laser, rows, width, begin, 1, taps, strip, smooth, heights);
        const float *restrict a = heights, *restrict b = a + size, *restrict d = b + size;
        float *restrict seen = smooth;
        for (int64_t i = 0; i < size; i++) {
            const float one = a[i] * f0, two = b[i] * f1, three = d[i] * f2, most = MAX(one, two);
            seen[i] = MAX(most, three);
        }
        if (v->level) for (int64_t r = 0; r < rows; r++) for (int64_t c = 0; c < n; c++)
            seen[r * STRIP + c] *= noises->quiet[v->level[r * width + begin + c]];
        if (strength) for (int64_t r = 0; r < rows; r++)
            memcpy(strength + r * width + begin, seen + r * STRIP, sizeof *seen * (size_t)n);
        float *restrict shown = strip;
        for (int64_t r = 0; r < rows; r++) {
            const float *restrict x = seen + r * STRIP;
            float *restrict to = shown + r * STRIP, highest = -INFINITY;
            for (int c = 0; c < STRIP; c++) to[c] = MIN(x[c], LINEAR) - ZERO;
            for (int c = 0; c < STRIP; c++) highest = MAX(highest, x[c]);
            if (highest > LINEAR) // rare, and logarithms are slow
                for (int c = 0; c < STRIP; c++)
                    if (x[c] > LINEAR) to[c] += GAIN_OF_LOG * (float)log((double)(x[c] / LINEAR));
        }
        for (int64_t c = 0; c < n; c++) {
            float *restrict out = evidence + (begin + c) * rows;
            for (int64_t r = 0; r < rows; r++) out[r] = shown[r * STRIP + c];
        }
    }
}

// Height of a ridge of one width at a row, from the light (2 FAR_PX + 1,) of its column around that row. Rows beyond the picture
// repeat its first or last row.
float ridge_of_column(const float *mean, int64_t row, int64_t rows, int k, const float *taps) {
    float smooth[3];
    for (int i = 0; i < 3; i++) {
        const int64_t centre = within(row + (i - 1) * SIDES[k], rows) - row + FAR_PX;
        float sum = taps[REACHES[k]] * mean[centre];
        for (int t = 1; t <= REACHES[k]; t++) sum += taps[REACHES[k] + t] * (mean[centre - t] + mean[centre + t]);
        smooth[i] = sum;
    }
    return smooth[1] - MAX(smooth[0], smooth[2]);
}

// Height and sigma [px] of the strongest ridge at one pixel, computed as in the strips.
float ridge_at(const float *laser, int64_t rows, int64_t width, int64_t row, int64_t c, const Noises *noises,
    float taps[WIDTHS][32], float *sigma) {
    const float third = (float)(1.0 / 3);
    float mean[2 * FAR_PX + 1], found = 0, most = -INFINITY;
    const int64_t left = MAX(c - 1, 0), right = MIN(c + 1, width - 1);
    for (int64_t t = -FAR_PX; t <= FAR_PX; t++) {
        const float *x = laser + within(row + t, rows) * width;
        mean[FAR_PX + t] = third * x[c] + third * (x[left] + x[right]);
    }
    for (int k = 0; k < WIDTHS; k++) {
        const float h = ridge_of_column(mean, row, rows, k, taps[k]), v = h * (float)(1 / noises->noises[k]);
        if (v > most) most = v, found = h, *sigma = (float)SIGMAS[k];
    }
    return found;
}
