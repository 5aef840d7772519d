// Exposure of a laser-off picture relative to the laser-on one, and their difference.
#include "kernel.h"

// Iterations of the fit, and number of median deviations beyond which a pixel is left out.
#define ROUNDS 6
#define TRIM_DEVIATIONS 2.5

// Median of |bright - gain dark - offset|, plus that of the pixels from `bright_from` on. work: (2 n,).
static double deviation(const float *restrict dark, const float *restrict bright, int64_t n, float gain, float offset,
    float bright_from, float *restrict work) {
    int64_t some = n;
    for (int64_t i = 0; i < n; i++) work[i] = fabsf(bright[i] - gain * dark[i] - offset);
    for (int64_t i = 0; i < n; i++) if (dark[i] >= bright_from) work[some++] = work[i];
    return median(work, n) + (some > n ? median(work + n, some - n) : 0);
}

// Least squares of the pixels that are not left out: gain and offset by which the bright values follow from the dark.
static void fit(const float *restrict dark, const float *restrict bright, int64_t n, float *restrict work,
    double *gain, double *offset) {
    float most = INFINITY, *left = work + n;
    for (int64_t i = 0; i < n; i++) work[i] = 0;
    *gain = 1, *offset = 0;
    for (int round = 0; round < ROUNDS; round++) {
        double count = 0, x = 0, y = 0, xx = 0, xy = 0;
        for (int64_t i = 0; i < n; i++) if (work[i] <= most) count++, x += (double)dark[i], y += (double)bright[i];
        x /= count, y /= count;
        for (int64_t i = 0; i < n; i++) {
            const double apart = work[i] <= most ? (double)dark[i] - x : 0;
            xx += apart * apart, xy += apart * (double)bright[i];
        }
        if (!(xx / count >= 1)) break;
        *gain = xy / xx, *offset = y - *gain * x;
        const float g = (float)*gain, o = (float)*offset;
        for (int64_t i = 0; i < n; i++) left[i] = work[i] = fabsf(bright[i] - g * dark[i] - o);
        const double middle = median(left, n);
        most = (float)(TRIM_DEVIATIONS * MAX(middle, 0.5));
    }
}

// dark, bright: (n,) levels with the laser off and on. bright_from: dark level from which a pixel is bright. work: (2 n,).
// found: gain and offset of the fit, the offset without a gain, and the deviation of either: of all pixels plus of the
// bright ones.
void exposure(const float *dark, const float *bright, int64_t n, double bright_from, float *work, double *found) {
    const float from = (float)bright_from;
    fit(dark, bright, n, work, &found[0], &found[1]);
    for (int64_t i = 0; i < n; i++) work[i] = bright[i] - dark[i];
    found[2] = median(work, n);
    found[3] = deviation(dark, bright, n, (float)found[0], (float)found[1], from, work);
    found[4] = deviation(dark, bright, n, 1, (float)found[2], from, work);
}

// light = on - gain off - offset, of n pixels of some channels.
void subtract(const float *restrict on, const float *restrict off, int64_t n, int64_t channels,
    const float *restrict gains, const float *restrict offsets, float *restrict light) {
    float gain[3 * LANES], offset[3 * LANES];
    for (int k = 0; k < 3 * LANES; k++) gain[k] = gains[k % channels], offset[k] = offsets[k % channels];
    int64_t i = 0;
    const int64_t size = n * channels, group = channels * LANES;
    for (; i + group <= size; i += group)
        for (int64_t k = 0; k < group; k++) light[i + k] = on[i + k] - gain[k] * off[i + k] - offset[k];
    for (; i < size; i++) light[i] = on[i] - gains[i % channels] * off[i] - offsets[i % channels];
}
