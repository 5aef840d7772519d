// Selection of the unbroken pieces of a path that belong to the laser.
#include "any_light.h"

// A piece of the path ends where it moves by more rows than this from one column to the next.
#define PIECE_JUMP_PX 4
// A stripe has pieces of at least this number of columns, and of this number times relative strength; and quantile of the heights
// that is the height of the strong pieces.
#define LEAST_COLUMNS 12
#define LEAST_STRONG_COLUMNS 6
#define STRONG_SHARE 0.75f
// A laser keeps the ratio of its channels on any surface; other light deviates by more than this.
#define MOST_COLOUR_DEVIATION 0.9
// Laser light is coherent, so it looks grainy on every rough surface; ambient light does not. The grain is measured in
// pieces of at least GRAINED_COLUMNS, as the deviation of the light across the stripe from its running mean over GRAIN_COLUMNS.
// It is visible if it is at least CLEAR_GRAIN times the noise beside it, and ROUNDING: a drawn picture has neither grain nor noise.
// A piece with less than LEAST_GRAIN of the brightest piece's grain is not lit by the laser. A piece of which MOST_CLIPPED or more
// is clipped is too bright to show its grain.
enum { GRAINED_COLUMNS = 24, GRAIN_COLUMNS = 9 };
#define CLEAR_GRAIN 2.0
#define ROUNDING 1e-3
#define LEAST_GRAIN (1.0 / 3)
#define MOST_CLIPPED 0.25
// Distance within which a ridge belongs to the path [rows], and fraction of its strength above which another ridge may equally be
// the stripe.
#define NEAR_PATH_PX 12
#define TWIN_OF_RIDGE 0.5f
// A stripe is also a ridge in the laser-on picture: least height of that ridge, as a fraction of its height in the difference of
// both pictures; least fraction of the examined columns of a piece that have it, since edges of the scene can hide it in some; and
// distance of these columns. An edge that moved between the pictures is no ridge in either.
#define LEAST_OWN_RIDGE 0.4f
#define LEAST_OWN_COLUMNS 0.25
#define OWN_COLUMNS 2

int64_t end_of_piece(const Path *p, int64_t begin, int64_t width) {
    const uint8_t *is_stripe = p->is_stripe;
    int64_t end = begin + 1;
    while (end < width && is_stripe[end] == is_stripe[begin] && (!is_stripe[begin] || abs(p->row[end] - p->row[end - 1]) <= PIECE_JUMP_PX)) end++;
    return end;
}
#define FOR_PIECES(P, WIDTH)                                                                                           \
    for (int64_t begin = 0, end; begin < WIDTH && (end = end_of_piece(P, begin, WIDTH)); begin = end) if ((P)->is_stripe[begin])

static float quantile(float *v, int64_t n, float share) {
    const float at = (float)(n - 1) * share;
    const int64_t low = (int64_t)at, high = MIN(low + 1, n - 1);
    const float b = select_value(v, n, high), a = select_value(v, n, low);
    return a + (b - a) * (at - (float)low);
}

// Mask of the pieces that are long enough and higher than `least` times the strong ones. shrunk: columns of the camera's pictures
// per column. work: (width,).
void strong_pieces(const float *height, const Path *p, const uint8_t *is_core, int64_t width, int64_t shrunk, double least,
    uint8_t *good, float *work) {
    int64_t n = 0;
    memset(good, 0, (size_t)width);
    for (int64_t c = 0; c < width; c++) if (p->is_stripe[c]) work[n++] = height[c];
    if (!n) return;
    const float strong = quantile(work, n, STRONG_SHARE);
    FOR_PIECES(p, width) {
        for (int64_t c = begin; c < end; c++) work[c - begin] = is_core[c] ? MAX(height[c], strong) : height[c];
        const double strength = (double)(median_f(work, end - begin) / strong), length = (double)(shrunk * (end - begin));
        if (length >= LEAST_COLUMNS && length * strength >= LEAST_STRONG_COLUMNS && strength > least)
            memset(good + begin, 1, (size_t)(end - begin));
    }
}

static void keep(const Path *p, const uint8_t *good, int64_t width, Path *kept) {
    memcpy(kept->row, p->row, sizeof *p->row * (size_t)width), memcpy(kept->is_stripe, good, (size_t)width);
}

// Keep the pieces that have the laser's colour; mostly clipped pieces are not judged.
void of_laser_colour(const Scene *s, const Path *p, const double *colour, int channel, uint8_t *good, Path *kept) {
    const int64_t width = s->width;
    keep(p, good, width, kept);
    FOR_PIECES(kept, width) {
        float sum[CHANNELS] = {0};
        int64_t clear = 0;
        for (int64_t c = begin; c < end; c += 2) {
            int is_clear = 1;
            for (int k = 0; k < CHANNELS; k++) is_clear &= s->on[at_row(s, k, p->row[c]) + c] < LEVEL_CLIPPED;
            for (int k = 0; is_clear && k < CHANNELS; k++) sum[k] += detail_at(s, p->row[c], c, k);
            clear += is_clear;
        }
        if ((double)clear < MAX((double)(LEAST_COLUMNS / 2 / s->shrunk), 0.5 * (double)(end - begin)) / 2) continue;
        double deviation = 0, mean[CHANNELS];
        for (int k = 0; k < CHANNELS; k++) mean[k] = (double)(sum[k] / (float)clear);
        for (int k = 0; k < CHANNELS; k++) {
            const double apart = fabs(mean[k] / MAX(mean[channel], 1e-6) - colour[k]);
            deviation = MAX(deviation, apart);
        }
        memset(good + begin, mean[channel] > 0 && deviation < MOST_COLOUR_DEVIATION, (size_t)(end - begin));
    }
}

// ---- grain -----------------------------------------------------------------------------------------------------------------
static double unevenness(const float *v, int64_t n, float *apart) { // robust standard deviation from the running mean
    for (int64_t i = 0; i < n; i++) {
        float sum = 0;
        for (int64_t t = i - GRAIN_COLUMNS / 2; t <= i + GRAIN_COLUMNS / 2; t++) sum += v[t < 0 ? -t : t >= n ? 2 * n - 2 - t : t];
        apart[i] = v[i] - sum / GRAIN_COLUMNS;
    }
    return robust_sigma(apart, n);
}

// Relative variation of the light of a piece from column to column, and the part of it that is noise. work: (3, width).
static void grain_of(const float *light, int64_t rows, int64_t width, const Path *p, int64_t begin, int64_t end,
    const float *sigma, float *work, double *grain, double *noise) {
    const int64_t n = end - begin;
    float *added = work, *beside = work + n;
    memcpy(work, sigma + begin, sizeof *work * (size_t)n);
    const int64_t size = 2 * (int64_t)ceil(2 * median(work, n)) + 1, before = 3 * size / 2;
    double sum = 0;
    for (int64_t i = 0; i < n; i++) {
        float part[3] = {0};
        for (int64_t t = 0; t < 3 * size; t++) part[t / size] += light[within(p->row[begin + i] + t - before, rows) * width + begin + i];
        added[i] = part[1] - 0.5f * (part[0] + part[2]), beside[i] = part[0] - part[2], sum += (double)added[i];
    }
    const double level = MAX(sum / (double)n, 1e-6);
    *grain = unevenness(added, n, work + 2 * n) / level, *noise = sqrt(0.75) * unevenness(beside, n, work + 2 * n) / level;
}

static int is_grained(const uint8_t *is_core, int64_t begin, int64_t end) { // long enough and hardly clipped
    int64_t clipped = 0;
    for (int64_t c = begin; c < end; c++) clipped += is_core[c];
    return end - begin >= GRAINED_COLUMNS && (double)clipped < MOST_CLIPPED * (double)(end - begin);
}

// Keep the pieces that are as grainy as laser light, or whose grain cannot be judged. Speckle (Goodman: Some fundamental
// properties of speckle, JOSA 66, 1976) depends on camera and laser more than on the surface, so the pieces are compared
// with the brightest one. If that shows no grain, all are kept, and so is a piece whose grain is lost in clipped light or noise.
void of_laser_speckle(const float *light, int64_t rows, int64_t width, const Path *p, const uint8_t *is_core,
    const float *sigma, uint8_t *good, Path *kept, float *work) {
    int64_t first = 0, last = 0;
    double most = -INFINITY, grain, noise;
    keep(p, good, width, kept);
    FOR_PIECES(kept, width) {
        if (!is_grained(is_core, begin, end)) continue;
        for (int64_t c = begin; c < end; c++) work[c - begin] = light[p->row[c] * width + c];
        const double level = median(work, end - begin);
        if (level > most) most = level, first = begin, last = end;
    }
    if (!last) return;
    grain_of(light, rows, width, p, first, last, sigma, work, &grain, &noise);
    if (grain < MAX(CLEAR_GRAIN * noise, ROUNDING)) return;
    const double least = LEAST_GRAIN * grain;
    FOR_PIECES(kept, width) {
        if (!is_grained(is_core, begin, end)) continue;
        grain_of(light, rows, width, p, begin, end, sigma, work, &grain, &noise);
        memset(good + begin, noise > least || grain * grain - noise * noise > least * least, (size_t)(end - begin));
    }
}

// ---- uncertain columns -----------------------------------------------------------------------------------------------------
// Columns in which a clipped ridge elsewhere has more than TWIN_OF_RIDGE of the path's strength: one of the two is a reflection,
// and clipped light does not show which. high: (width,) work memory.
void has_twin(const float *strength, const uint8_t *core, const Path *p, int64_t rows, int64_t width, uint8_t *twin,
    float *restrict high) {
    for (int64_t c = 0; c < width; c++) high[c] = 0;
    for (int64_t r = 0; r < rows; r++) {
        const float *restrict s = strength + r * width;
        const uint8_t *restrict full = core + r * width;
        for (int64_t c = 0; c < width; c++) {
            const float v = full[c] && abs((int32_t)r - p->row[c]) > NEAR_PATH_PX ? s[c] : 0;
            high[c] = MAX(high[c], v);
        }
    }
    for (int64_t c = 0; c < width; c++) twin[c] = high[c] > TWIN_OF_RIDGE * strength[p->row[c] * width + c];
}

// Keep only the pieces that are ridges of the laser-on picture too: an edge that moved between the pictures is none. good: (width,)
// work memory.
void without_moved_edges(const Scene *s, Found *f, uint8_t *good) {
    const int64_t width = s->width, rows = s->rows;
    float taps[WIDTHS][32];
    taps_of_ridges(taps);
    memcpy(good, f->path.is_stripe, (size_t)width);
    FOR_PIECES(&f->path, width) {
        int64_t ridges = 0, looked_at = 0;
        for (int64_t c = begin; c < end; c += OWN_COLUMNS, looked_at++) {
            if (f->is_core[c]) { ridges++; continue; }
            float mean[2 * FAR_PX + 1], highest = -INFINITY;
            const int64_t left = MAX(c - 1, 0), right = MIN(c + 1, width - 1);
            memset(mean, 0, sizeof mean);
            for (int k = 0; k < s->channels; k++) {
                const float share = (float)f->weights[k] / (3 * LEVEL);
                for (int64_t t = -FAR_PX; t <= FAR_PX; t++) {
                    const uint16_t *x = s->on + at_row(s, k, within(f->path.row[c] + t, rows));
                    mean[FAR_PX + t] += share * (float)(x[left] + x[c] + x[right]);
                }
            }
            for (int k = 0; k < WIDTHS; k++) {
                const float h = ridge_of_column(mean, f->path.row[c], rows, k, taps[k]);
                highest = MAX(highest, h);
            }
            ridges += highest > LEAST_OWN_RIDGE * f->height[c];
        }
        memset(good + begin, (double)ridges > LEAST_OWN_COLUMNS * (double)looked_at, (size_t)(end - begin));
    }
    memcpy(f->path.is_stripe, good, (size_t)width);
    for (int64_t c = 0; c < width; c++) f->is_core[c] &= good[c];
}
