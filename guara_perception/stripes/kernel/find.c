// Search for a stripe by the highest peaks of its band: from a pair of pictures to the row of the peak in every column.
#include "find.h"

// Least noise [grey levels]: less than a third of a quantisation step cannot be measured.
#define LEAST_NOISE 0.3
// A relative floor of the threshold keeps a faint halo out of the gaps of a bright stripe.
#define THRESHOLD_OF_MEDIAN_PEAK 0.05
// Spacing of the columns in which the width of the stripe is measured.
#define WIDTH_COLUMNS 32
// Light beside a wide stripe that rises by less than this fraction of the median peak belongs to the stripe.
#define RISE_OF_MEDIAN_PEAK 0.15

static int64_t carve(Work *work, char *memory, int64_t rows, int64_t columns) {
    const int64_t blocks = rows / BLOCK_ROWS + 1, samples = (rows / BIN_ROWS + 1) * (columns / SAMPLE_COLUMNS + 1);
    const int64_t most = MAX(MAX(samples, rows), columns), bins = (rows + BIN_ROWS - 1) / BIN_ROWS;
    int64_t at = 0;
#define TAKE(NAME, SIZE) work->NAME = (void *)(memory + at), at += ((SIZE) + 63) / 64 * 64
    TAKE(lines, 2 * 6 * columns);
    TAKE(light, 4 * (columns + 2));
    TAKE(ring, 4 * 3 * columns);
    TAKE(blocks, 4 * blocks * columns);
    TAKE(samples, 4 * most);
    TAKE(values, 4 * most);
    TAKE(heights, 4 * MOST_CANDIDATES * columns);
    TAKE(indices, 8 * columns);
    TAKE(candidates, 8 * MOST_CANDIDATES * columns);
    TAKE(costs, (int64_t)sizeof(Costs) * columns);
    // Only used to search for a wide stripe.
    TAKE(bins, 4 * bins * columns);
    TAKE(wide, 4 * bins * columns);
    return at;
}

// Bytes of `memory` of `find_stripe`.
int64_t find_size(int64_t rows, int64_t columns) {
    static char nothing[1];
    Work work;
    return carve(&work, nothing, rows, columns);
}

// Noise of the light that is searched for peaks. work->indices receives the n columns whose peak stands out from it.
static double noise_of(const Light *light, Work *work, const void *searched, const float *height, int64_t *n) {
    int64_t count = 0;
    for (int64_t r = 0; r < light->rows; r += light->step > 1 ? 1 : SAMPLE_ROWS)
        for (int64_t c = 0; c < light->columns; c += SAMPLE_COLUMNS)
            work->samples[count++] = value(searched, light->is_float, r * light->columns + c);
    const double spread = robust_sigma(work->samples, count), noise = MAX(spread, LEAST_NOISE * SCALE);
    *n = 0;
    for (int64_t c = 0; c < light->columns; c++)
        if (height[c] > (float)(THRESHOLD_SIGMAS * noise)) work->indices[(*n)++] = c;
    return noise;
}

// Find a stripe in a pair of pictures: row and height of the peak in every column, and masks of the columns with a peak, with
// a clipped core and with an uncertain peak. Returns 1 if the stripe is in doubt; top and height are then those of the highest
// peaks. is_fused: search all channels together. smooth: (rows, columns), receives the smoothed light. mix: receives the
// weights of the channels. found: receives sigma of the stripe [px] and noise of the light. Rows of a wide stripe are
// multiples of BIN_ROWS plus BIN_ROWS / 2.
int64_t find_stripe(const Picture *on, const Picture *off, const Judgement *seen, int64_t is_fused, char *memory,
    void *smooth, int64_t *top, float *height, uint8_t *is_peak, uint8_t *is_clipped, uint8_t *is_unsure, double *mix,
    double *found) {
    Work work;
    Light light = {.on = on, .off = off, .rows = on->rows, .columns = on->columns, .channel = (int64_t)seen->channel,
        .is_fused = is_fused, .is_float = is_fused || on->size == 2, .step = 1}, wide;
    const int64_t n = light.columns;
    carve(&work, memory, on->rows, n);
    if (light.is_fused) mix_channels(&light, &work);
    else light.offset = fabs(seen->change) > full_scale(on) / 256 ? (float)seen->change : 0, light.mix[light.channel] = 1;
    for (int k = 0; k < 3; k++) mix[k] = (double)light.mix[k];
    float *second = work.values;
    int64_t samples = smooth_light(&light, &work, smooth), strong;
    const double spread = samples ? robust_sigma(work.values, samples) : 0;
    const double own_noise = MAX(spread, LEAST_NOISE * COLUMN_MEAN_PX);
    const void *searched = smooth;
    const Light *looked_in = &light;
    find_peaks(&light, &work, searched, top, height, second);
    double noise = noise_of(&light, &work, searched, height, &strong);
    int64_t *some = (int64_t *)work.ring, *tops = work.candidates, looked_at = 0;
    for (int64_t i = 0; i < strong; i += WIDTH_COLUMNS, looked_at++) {
        const int64_t c = some[looked_at] = work.indices[i];
        tops[looked_at] = top[c], work.heights[looked_at] = height[c];
    }
    double sigma = stripe_sigma(smooth, light.is_float, light.rows, n, tops, work.heights, some, looked_at,
        ROW_SMOOTHING_VARIANCE, work.samples);
    sigma = rint(10 * sigma) / 10;
    if (sigma > WIDE_SIGMA_PX) {
        wide_light(&light, &work, smooth, sigma, &wide);
        searched = work.wide, looked_in = &wide;
        find_peaks(&wide, &work, searched, top, height, second);
        noise = noise_of(&wide, &work, searched, height, &strong);
    }
    for (int64_t i = 0; i < strong; i++) work.samples[i] = height[work.indices[i]];
    const double median_peak = strong ? (double)upper_median(work.samples, strong) : 0;
    const double threshold = MAX(THRESHOLD_SIGMAS * noise, THRESHOLD_OF_MEDIAN_PEAK * median_peak);
    found[0] = sigma, found[1] = own_noise;
    if (looked_in == &wide) {
        find_rises(&wide, &work, top, (float)(RISE_OF_MEDIAN_PEAK * median_peak), second);
        for (int64_t c = 0; c < n; c++) top[c] = row_of_bin(top[c], light.rows);
    }
    const int is_in_doubt = is_doubtful(looked_in, top, height, second, threshold, own_noise, seen->is_uneven != 0);
    if (!is_in_doubt) choose(looked_in, &work, searched, top, height, second, threshold, sigma, is_unsure);
    for (int64_t c = 0; c < n; c++) is_peak[c] = height[c] > (float)threshold, is_clipped[c] = 0;
    if (!is_in_doubt && light.highest >= clipped_from(on)) {
        uint8_t *is_lost = (uint8_t *)work.lines;
        clipped_columns(on, top, sigma, light.channel, light.is_fused, is_clipped, is_lost);
        for (int64_t c = 0; c < n; c++) is_unsure[c] |= is_lost[c];
    }
    return is_in_doubt;
}
