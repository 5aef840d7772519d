// Colour of the laser, estimated from the picture, and projection of the picture on it (Fisher's linear discriminant).
#include "any_light.h"

// Spacing of the samples of a covariance: in rows; in columns of a view with details of all columns, and of one with some.
enum { COVARIANCE_ROWS = 2, COVARIANCE_COLUMNS = 5, COVARIANCE_SOME = 1 };
// Standard deviation that JPEG and quantisation cause in a channel [grey levels], and regularisation of the covariance as a
// fraction of its trace.
#define LEAST_DEVIATION 0.15
#define UNKNOWN_SHARE 1e-3
// Number of columns from which a colour is measured; distance of the background from the centre of the stripe, and half-width of
// the stripe with its rim [rows].
enum { COLOUR_COLUMNS = 200, BACKGROUND_PX = 12, RIM_PX = 6 };
// Largest response of another channel to a line laser, as a fraction of that of the laser's own channel.
#define MOST_LEAKAGE 0.8
// A clipped core with its halo is narrower than this. Weight of the other channels in a core, and their largest contribution as
// a fraction of the light of the rim.
enum { WIDEST_CORE_PX = 25 };
#define OTHERS_SHARE 0.1f
#define MOST_OF_CORE 0.5f

static inline int is_near(const Path *p, int64_t r, int64_t c, int reach) { return p->is_stripe[c] && labs(r - p->row[c]) <= reach; }

// Covariance of the details of a scene away from the stripe.
void covariance(const View *v, const Path *near, int reach, double scene[CHANNELS][CHANNELS]) {
    const int64_t apart = v->detail_step == 1 ? COVARIANCE_COLUMNS : COVARIANCE_SOME;
    double sum[CHANNELS][CHANNELS] = {{0}}, trace = 0;
    int64_t used = 0;
    memset(scene, 0, CHANNELS * sizeof *scene);
    for (int k = 0; k < CHANNELS; k++) scene[k][k] = 1;
    if (v->scene->channels < CHANNELS) return;
    for (int64_t r = 0; r < v->rows; r += COVARIANCE_ROWS) {
        const float *x[CHANNELS];
        float part[6] = {0};
        for (int64_t k = 0; k < CHANNELS; k++) x[k] = v->detail + (k * v->rows + r) * v->detail_width;
        for (int64_t c = 0; c < v->detail_width; c += apart) {
            if (is_near(near, r, v->detail_first + c * v->detail_step, reach)) continue;
            const float a = x[0][c], b = x[1][c], d = x[2][c];
            part[0] += a * a, part[1] += a * b, part[2] += a * d, part[3] += b * b, part[4] += b * d, part[5] += d * d;
            used++;
        }
        sum[0][0] += part[0], sum[0][1] += part[1], sum[0][2] += part[2];
        sum[1][1] += part[3], sum[1][2] += part[4], sum[2][2] += part[5];
    }
    sum[1][0] = sum[0][1], sum[2][0] = sum[0][2], sum[2][1] = sum[1][2];
    for (int i = 0; i < CHANNELS; i++) for (int j = 0; j < CHANNELS; j++) scene[i][j] = sum[i][j] / (double)MAX(used, 1);
    for (int i = 0; i < CHANNELS; i++) trace += scene[i][i];
    for (int i = 0; i < CHANNELS; i++) scene[i][i] += LEAST_DEVIATION * LEAST_DEVIATION + UNKNOWN_SHARE * trace;
}

// Weights of the channels that suppress the scene and do not change the brightness of light in the laser's colour.
void laser_weights(int64_t channels, double scene[CHANNELS][CHANNELS], const double *colour, double *weights) {
    double a[CHANNELS][CHANNELS + 1], along = 0;
    for (int i = 0; i < CHANNELS; i++) {
        memcpy(a[i], scene[i], sizeof scene[i]);
        a[i][CHANNELS] = i < channels ? colour[i] : 0;
    }
    for (int i = 0; i < CHANNELS; i++) {
        int pivot = i;
        for (int j = i + 1; j < CHANNELS; j++) if (fabs(a[j][i]) > fabs(a[pivot][i])) pivot = j;
        for (int k = 0; k <= CHANNELS; k++) { const double t = a[i][k]; a[i][k] = a[pivot][k], a[pivot][k] = t; }
        for (int j = i + 1; j < CHANNELS; j++) {
            const double f = a[j][i] / a[i][i];
            for (int k = i; k <= CHANNELS; k++) a[j][k] -= f * a[i][k];
        }
    }
    for (int i = CHANNELS - 1; i >= 0; i--) {
        double v = a[i][CHANNELS];
        for (int k = i + 1; k < CHANNELS; k++) v -= a[i][k] * weights[k];
        weights[i] = v / a[i][i];
    }
    for (int i = 0; i < channels; i++) along += colour[i] * weights[i];
    for (int i = 0; i < CHANNELS; i++) weights[i] /= MAX(along, 1e-9);
}

// ---- colours of a path -------------------------------------------------------------------------------------------------
static int some_columns(const View *v, const Path *p, int64_t *columns) { // up to COLOUR_COLUMNS of those with a stripe
    int64_t n = 0, m = 0, i = 0;
    for (int64_t c = 0; c < v->width; c++) n += p->is_stripe[c];
    const int64_t apart = MAX((n + COLOUR_COLUMNS - 1) / COLOUR_COLUMNS, 1);
    for (int64_t c = 0; c < v->width; c++) if (p->is_stripe[c] && i++ % apart == 0) columns[m++] = c;
    return (int)m;
}

static int is_clear(const View *v, int64_t r, int64_t c, int besides) { // not clipped in any channel besides the given one
    int clear = 1;
    for (int k = 0; k < v->scene->channels; k++) clear &= k == besides || v->on[at_pixel(v, k, r, c)] < LEVEL_CLIPPED;
    return clear;
}

// Median colour that a stripe adds to its surroundings in the brighter half of the columns, from pixels that are not clipped.
void rim_colour(const View *v, const Path *p, int channel, double added[CHANNELS]) {
    int64_t columns[COLOUR_COLUMNS + 1];
    const int n = some_columns(v, p, columns), channels = (int)v->scene->channels;
    const int64_t last = v->rows - 1;
    float sum[CHANNELS][COLOUR_COLUMNS + 1], kept[CHANNELS][COLOUR_COLUMNS + 1], own[COLOUR_COLUMNS + 1];
    int m = 0;
    added[0] = added[1] = added[2] = 0;
    if (!n) return;
    for (int i = 0; i < n; i++) {
        const int64_t c = columns[i], row = p->row[c];
        float beside[CHANNELS];
        for (int k = 0; k < channels; k++) {
            const float above = v->light[at_pixel(v, k, MAX(row - BACKGROUND_PX, 0), c)];
            beside[k] = 0.5f * (above + v->light[at_pixel(v, k, MIN(row + BACKGROUND_PX, last), c)]), sum[k][i] = 0;
        }
        for (int64_t t = -RIM_PX; t <= RIM_PX; t++) {
            const int64_t r = within(row + t, v->rows);
            if (!is_clear(v, r, c, NONE)) continue;
            for (int k = 0; k < channels; k++) sum[k][i] += v->light[at_pixel(v, k, r, c)] - beside[k];
        }
    }
    memcpy(own, sum[channel], sizeof *own * (size_t)n);
    const float least = upper_median(own, n);
    for (int i = 0; i < n; i++) if (sum[channel][i] >= least) {
        for (int k = 0; k < channels; k++) kept[k][m] = sum[k][i];
        m++;
    }
    for (int k = 0; k < channels; k++) added[k] = (double)upper_median(kept[k], m);
}

// Median colour of the centre of a stripe where no channel but the laser's own is clipped. If that is clipped, it is a lower bound.
static void core_colour(const View *v, const Path *p, int channel, double added[CHANNELS]) {
    int64_t columns[COLOUR_COLUMNS + 1];
    const int n = some_columns(v, p, columns), channels = (int)v->scene->channels;
    float kept[CHANNELS][COLOUR_COLUMNS + 1];
    int m = 0;
    added[0] = added[1] = added[2] = 0;
    for (int i = 0; i < n; i++) {
        const int64_t c = columns[i], r = p->row[c];
        if (!is_clear(v, r, c, channel)) continue;
        for (int k = 0; k < channels; k++)
            kept[k][m] = v->detail_step == 1 ? v->detail[at_pixel(v, k, r, c)] : detail_at(v->scene, r, c, k);
        m++;
    }
    for (int k = 0; m && k < channels; k++) added[k] = (double)upper_median(kept[k], m);
}

// Colour relative to one channel, with the others limited to MOST_LEAKAGE.
void relative_colour(const double *added, int channel, double *colour) {
    for (int k = 0; k < CHANNELS; k++) colour[k] = MIN(MAX(added[k] / MAX(added[channel], 1e-6), 0.0), MOST_LEAKAGE);
    colour[channel] = 1;
}

static double purity_of(const double *added, int channel) { // 0 for white or another laser's colour, 1 for a pure one
    if (added[channel] <= 0) return 0;
    double other = -INFINITY;
    for (int k = 0; k < CHANNELS; k++) if (k != channel) other = MAX(other, added[k]);
    return MIN(MAX((1.05 - other / added[channel]) / 0.6, 0.0), 1.0);
}

// Purity of the colour of a path: the higher of the purities of its rim and of its core, which may be white.
double purity(const View *v, const Path *p, int channel) {
    double rim[CHANNELS], core[CHANNELS];
    if (v->scene->channels < CHANNELS) return 1;
    rim_colour(v, p, channel, rim);
    const double a = purity_of(rim, channel);
    if (a >= 1) return a;
    core_colour(v, p, channel, core);
    const double b = purity_of(core, channel);
    return MAX(a, b);
}

// ---- the picture in the laser's colour ---------------------------------------------------------------------------------
static void extreme(float *x, int64_t n, int is_highest) { // running extreme over WIDEST_CORE_PX rows of a strip (n + 24, STRIP), in place
    static const int BY[5] = {1, 2, 4, 8, WIDEST_CORE_PX - 16};
    for (int step = 0; step < 5; step++) {
        const int64_t by = BY[step] * STRIP, end = (step < 4 ? n + WIDEST_CORE_PX - 1 - BY[step] : n) * STRIP;
        if (is_highest) for (int64_t i = 0; i < end; i += STRIP) for (int c = 0; c < STRIP; c++) x[i + c] = MAX(x[i + c], x[i + by + c]);
        else for (int64_t i = 0; i < end; i += STRIP) for (int c = 0; c < STRIP; c++) x[i + c] = MIN(x[i + c], x[i + by + c]);
    }
}

// Grey closing along the columns near the clipped cores (rows, width), strip by strip; rows beyond the picture are ignored. work:
// (rows + 24, STRIP).
static void close_columns(const float *in, const uint8_t *core, float *out, int64_t rows, int64_t width, float *work) {
    enum { HALF = WIDEST_CORE_PX / 2 * STRIP };
    for (int64_t begin = 0; begin < width; begin += STRIP) {
        const int64_t n = MIN(STRIP, width - begin);
        int64_t first = rows, last = -1;
        for (int64_t r = 0; r < rows; r++) {
            int any = 0;
            for (int64_t c = begin; c < begin + n; c++) any |= core[r * width + c];
            if (any) first = MIN(first, r), last = r;
        }
        if (last < 0) continue;
        first = MAX(first - WIDEST_CORE_PX + 1, 0);
        const int64_t count = MIN(last + WIDEST_CORE_PX, rows) - first;
        float *inside = work + HALF, *after = inside + count * STRIP;
        memset(inside, 0, sizeof *inside * (size_t)(count * STRIP));
        for (int64_t r = 0; r < count; r++) memcpy(inside + r * STRIP, in + (first + r) * width + begin, sizeof *in * (size_t)n);
        for (int pass = 0; pass < 2; pass++) {
            if (pass) memmove(inside, work, sizeof *inside * (size_t)(count * STRIP));
            for (int i = 0; i < HALF; i++) work[i] = after[i] = pass ? INFINITY : -INFINITY;
            extreme(work, count, !pass);
        }
        for (int64_t r = 0; r < count; r++) memcpy(out + (first + r) * width + begin, work + r * STRIP, sizeof *out * (size_t)n);
    }
}

// Picture in the colour of the laser, and mask of its clipped pixels. A clipped pixel is at least as bright as the rim of its core,
// whatever its other channels show. It is therefore filled from the rim and slightly raised by the other channels, which still
// show the centre.
void in_laser_colour(const View *v, const double *weights, int channel, float *mixed, uint8_t *core, Any *w) {
    const int64_t rows = v->rows, width = v->width, n = rows * width;
    const int is_colour = v->scene->channels == CHANNELS;
    const float m0 = (float)weights[0], m1 = (float)weights[1], m2 = (float)weights[2];
    const float *restrict l0 = v->light, *restrict l1 = l0 + is_colour * n, *restrict l2 = l1 + is_colour * n;
    int64_t first = rows, last = -1;
    if (is_colour) for (int64_t i = 0; i < n; i++) mixed[i] = m0 * l0[i] + m1 * l1[i] + m2 * l2[i];
    else memcpy(mixed, l0, sizeof *mixed * (size_t)n);
    for (int64_t r = 0; r < rows; r++) {
        const uint16_t *restrict p = v->on + at_pixel(v, channel, r, 0);
        uint8_t *restrict full = core + r * width;
        uint16_t most = 0;
        for (int64_t c = 0; c < width; c++) most = MAX(most, p[c]), full[c] = p[c] >= LEVEL_CLIPPED;
        if (most >= LEVEL_CLIPPED) first = MIN(first, r), last = r;
    }
    if (last < 0 || !is_colour) return;
    // Extend the cores by one row above and below.
    const int64_t top = MAX(first - 1, 0), end = MIN(last + 2, rows);
    uint8_t *before = (uint8_t *)w->line, *here = before + width;
    memset(before, 0, (size_t)width);
    for (int64_t r = top; r < end; r++) {
        uint8_t *restrict row = core + r * width, *restrict next = r + 1 < rows ? row + width : NULL;
        memcpy(here, row, (size_t)width);
        if (next) for (int64_t c = 0; c < width; c++) row[c] = before[c] | here[c] | next[c];
        else for (int64_t c = 0; c < width; c++) row[c] = before[c] | here[c];
        uint8_t *t = before; before = here, here = t;
    }
    close_columns(mixed, core, w->closed, rows, width, w->line);
    for (int64_t r = top; r < end; r++) for (int64_t c = 0; c < width; c++) if (core[r * width + c]) {
        const float rim = w->closed[r * width + c];
        const float sum = v->light[at_pixel(v, 0, r, c)] + v->light[at_pixel(v, 1, r, c)] + v->light[at_pixel(v, 2, r, c)];
        const float others = OTHERS_SHARE * (sum - v->light[at_pixel(v, channel, r, c)]), most = MOST_OF_CORE * MAX(rim, 0.0f);
        mixed[r * width + c] = rim + MIN(MAX(others, 0.0f), most);
    }
}
