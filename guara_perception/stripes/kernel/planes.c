// Planes of a picture; laser light of a pair of pictures whose exposures may differ; details of that light along the columns.
#include "any_light.h"

// Ratio of exposures beyond which noise, clipping and the camera's own curve differ too. A laser-off picture beyond it is
// still used, up to MOST_USED_GAIN, if its subtraction leaves at most MOST_LEFT grey levels of the scene in most pixels: then it
// shows the same view.
#define MOST_GAIN 1.6
#define MOST_USED_GAIN 3.0
#define MOST_LEFT 0.9
// The fit ends after ROUNDS, or when gain and offset change by less than SAME_GAIN and SAME_OFFSET. It is used if it leaves less
// than FITTED_OF_PLAIN of what an offset alone leaves: median over all pixels plus median over those from the quantile BRIGHT_FROM
// up, which show a gain best and may be few.
#define ROUNDS 6
#define SAME_GAIN 2e-4
#define SAME_OFFSET 0.02
#define FITTED_OF_PLAIN 0.7
#define BRIGHT_FROM 0.9f
// A laser-off picture that leaves more than this fraction of the scene's contrast, and more than these grey levels, shows another
// scene.
#define MOST_SCENE_LEFT 0.5
#define LEAST_SCENE_LEFT 6.0
// The fit uses every FIT_ROWS-th row and FIT_COLUMNS-th column in units of FIT_LEVEL per grey level, and every MEDIAN_APART-th of
// these samples for a median. Scenes are compared by the means of blocks of BLOCK x BLOCK pixels.
enum { MEDIAN_APART = 3, FIT_ROWS = 8, FIT_COLUMNS = 4, FIT_LEVEL = 16, BLOCK = 8 };
// Distance of the two rows, one above and one below a pixel, whose mean is subtracted from it to obtain its detail.
enum { DETAIL_SIDE = 5 };

// Planes (channels, rows, columns / factor) of a picture: means of `factor` columns. line: 2 * columns bytes.
void planes(const Picture *p, int64_t factor, char *line, uint16_t *out) {
    const int64_t count = p->columns / factor;
    for (int64_t k = 0; k < p->channels; k++)
        for (int64_t r = 0; r < p->rows; r++, out += count) {
            const void *samples = samples_of(p, r, k, line);
            uint16_t *restrict to = out;
            if (p->size == 1) {
                const uint8_t *restrict x = samples;
                if (factor == 4) for (int64_t c = 0; c < count; c++)
                    to[c] = (uint16_t)((x[4 * c] + x[4 * c + 1] + x[4 * c + 2] + x[4 * c + 3]) << 6);
                else if (factor == 2) for (int64_t c = 0; c < count; c++) to[c] = (uint16_t)((x[2 * c] + x[2 * c + 1]) << 7);
                else for (int64_t c = 0; c < count; c++) to[c] = (uint16_t)(x[c] << 8);
            } else {
                const uint16_t *restrict x = samples;
                const float share = 255.0f * LEVEL / 65535 / (float)factor;
                for (int64_t c = 0; c < count; c++) {
                    int32_t sum = 0;
                    for (int64_t i = 0; i < factor; i++) sum += x[factor * c + i];
                    to[c] = (uint16_t)((float)sum * share + 0.5f);
                }
            }
        }
}

// ---- exposure ----------------------------------------------------------------------------------------------------------
// Fit bright = gain * dark + offset by least squares, without outliers. work: (2 * n,). use: (n,).
static void fit(const uint16_t *restrict dark, const uint16_t *restrict bright, int64_t n, float *work, uint8_t *restrict use,
    double *gain, double *offset) {
    *gain = 1, *offset = 0;
    memset(use, 1, (size_t)n);
    for (int round = 0; round < ROUNDS; round++) {
        int64_t count = 0, x = 0, y = 0, xx = 0, xy = 0;
        for (int64_t i = 0; i < n; i++) {
            const int32_t m = use[i] ? -1 : 0, d = dark[i] & m, b = bright[i] & m;
            count -= m, x += d, y += b, xx += d * d, xy += d * b;
        }
        const double mx = (double)x / (double)count, my = (double)y / (double)count;
        const double variance = (double)xx / (double)count - mx * mx;
        if (variance < FIT_LEVEL * FIT_LEVEL) break;
        const double gain_before = *gain, offset_before = *offset;
        *gain = ((double)xy / (double)count - mx * my) / variance;
        *offset = (my - *gain * mx) / FIT_LEVEL;
        if (round == ROUNDS - 1 || (round && fabs(*gain - gain_before) < SAME_GAIN && fabs(*offset - offset_before) < SAME_OFFSET)) break;
        const float g = (float)*gain, o = (float)*offset * FIT_LEVEL;
        float *restrict apart = work, *restrict copy = work + n;
        int64_t some = 0;
        for (int64_t i = 0; i < n; i++) apart[i] = fabsf((float)bright[i] - g * (float)dark[i] - o);
        for (int64_t i = 0; i < n; i += MEDIAN_APART) copy[some++] = apart[i];
        const float most = 2.5f * MAX(upper_median(copy, some), 0.5f * FIT_LEVEL);
        for (int64_t i = 0; i < n; i++) use[i] = apart[i] <= most;
    }
}

static double contrast(const float *blocks, int64_t n, float *work) { // median deviation from the median
    memcpy(work, blocks, sizeof *work * (size_t)n);
    const float m = median_f(work, n);
    for (int64_t i = 0; i < n; i++) work[i] = fabsf(blocks[i] - m);
    return (double)median_f(work, n);
}

static void block_means(const Scene *s, const uint16_t *plane, int64_t ny, int64_t nx, uint32_t *restrict sums, float *means) {
    const int64_t w = s->width;
    for (int64_t y = 0; y < ny; y++) {
        const int64_t count = MIN(BLOCK, s->rows - BLOCK * y);
        memset(sums, 0, sizeof *sums * (size_t)w);
        for (int64_t r = BLOCK * y; r < BLOCK * y + count; r++) {
            const uint16_t *restrict p = plane + r * w;
            for (int64_t c = 0; c < w; c++) sums[c] += p[c];
        }
        for (int64_t x = 0; x < nx; x++) {
            const int64_t size = MIN(BLOCK, w - BLOCK * x);
            uint32_t sum = 0;
            for (int64_t i = 0; i < size; i++) sum += sums[BLOCK * x + i];
            means[y * nx + x] = (float)sum / (float)(size * count * LEVEL);
        }
    }
}

// Fit the exposure of one channel of the laser-off picture. Returns a remark on that picture, or USED; clears has_dark if it
// cannot be used. is_changed: as in `extract_any_light`. was_unlike: 1 if an earlier channel showed that the exposures differ.
static int64_t fit_channel(Scene *s, int64_t k, int64_t is_changed, int64_t was_unlike, Any *w) {
    const int64_t rows = s->rows, width = s->width, most = ((rows + FIT_ROWS - 1) / FIT_ROWS) * ((width + FIT_COLUMNS - 1) / FIT_COLUMNS);
    float *work = w->samples;
    uint16_t *dark = (uint16_t *)(work + 2 * most), *bright = dark + most;
    uint8_t *use = (uint8_t *)(bright + most);
    int64_t m = 0, number = 0;
    for (int64_t r = 0; r < rows; r += FIT_ROWS) {
        const uint16_t *p = s->on + at_row(s, k, r), *q = s->off + at_row(s, k, r);
        for (int64_t c = 0; c < width; c += FIT_COLUMNS) {
            bright[m] = p[c] / (LEVEL / FIT_LEVEL), dark[m] = q[c] / (LEVEL / FIT_LEVEL);
            m += p[c] < LEVEL_CLIPPED && q[c] < LEVEL_CLIPPED;
        }
    }
    s->gain[k] = 1, s->offset[k] = 0;
    if (!m) return USED;
    for (int64_t i = 0; i < m; i++) work[i] = (float)(bright[i] - dark[i]) / FIT_LEVEL;
    const float plain = median_f(work, m);
    for (int64_t i = 0; i < m; i++) work[i] = dark[i];
    const float from = select_value(work, m, (int64_t)ceilf((float)(m - 1) * BRIGHT_FROM));
    double gain, fitted;
    fit(dark, bright, m, work, use, &gain, &fitted);
    const float factors[2] = {(float)gain, 1}, offsets[2] = {(float)fitted, plain};
    double sums[2], lefts[2];
    for (int kind = 0; kind < 2; kind++, number = 0) {
        const float g = factors[kind] / FIT_LEVEL, o = offsets[kind];
        float *all = work, *some = work + m;
        for (int64_t i = 0; i < m; i++) {
            all[i] = fabsf((float)bright[i] / FIT_LEVEL - g * (float)dark[i] - o);
            some[number] = all[i], number += (float)dark[i] >= from;
        }
        sums[kind] = (double)median_f(some, number);
        lefts[kind] = (double)median_f(all, m), sums[kind] += lefts[kind];
    }
    const int used = sums[0] < FITTED_OF_PLAIN * sums[1] ? 0 : 1;
    s->gain[k] = factors[used], s->offset[k] = offsets[used];
    const double ratio = used ? 1 : gain;
    const int64_t is_unlike = !(1 / MOST_GAIN <= ratio && ratio <= MOST_GAIN) || was_unlike;
    if (is_unlike && !was_unlike) s->remark_numbers[0] = 1 / ratio;
    const int is_left = lefts[used] > MOST_LEFT * MAX(ratio, 1) || !(1 / MOST_USED_GAIN <= ratio && ratio <= MOST_USED_GAIN);
    if ((is_unlike || is_changed) && is_left) {
        s->has_dark = 0;
        return is_changed ? OTHER_SCENE : OTHER_EXPOSURE;
    }
    const int64_t ny = MAX((int64_t)rint((double)rows / BLOCK), 1), nx = MAX((int64_t)rint((double)width / BLOCK), 1), n = ny * nx;
    float *on = w->closed, *off = on + n;
    block_means(s, s->on + at_row(s, k, 0), ny, nx, (uint32_t *)w->line, on);
    block_means(s, s->off + at_row(s, k, 0), ny, nx, (uint32_t *)w->line, off);
    for (int64_t i = 0; i < n; i++) off[i] = on[i] - s->gain[k] * off[i];
    const double scene = contrast(on, n, work), unlike = contrast(off, n, work);
    if (unlike > MAX(MOST_SCENE_LEFT * scene, LEAST_SCENE_LEFT)) {
        s->remark_numbers[0] = unlike, s->remark_numbers[1] = scene, s->has_dark = 0;
        return OTHER_SCENE;
    }
    return is_unlike ? OTHER_EXPOSURE : USED;
}

void fit_exposure(Scene *s, int64_t is_changed, Any *w) {
    for (int64_t k = 0; k < s->channels && s->has_dark; k++) s->remark = fit_channel(s, k, is_changed, s->remark == OTHER_EXPOSURE, w);
}

// Laser light: laser-on picture minus the expected scene, which is limited to `most` because the laser-on picture is clipped there.
void subtract(Scene *s) {
    const int64_t n = s->rows * s->width;
    for (int64_t k = 0; k < s->channels; k++) {
        const float gain = s->gain[k] / LEVEL, offset = s->offset[k], most = s->most;
        const uint16_t *restrict on = s->on + k * n, *restrict off = s->off + k * n;
        float *restrict light = s->light + k * n;
        if (s->has_dark) for (int64_t i = 0; i < n; i++) {
            const float expected = gain * (float)off[i] + offset;
            light[i] = (float)on[i] * (1.0f / LEVEL) - MIN(expected, most);
        }
        else for (int64_t i = 0; i < n; i++) light[i] = (float)on[i] * (1.0f / LEVEL);
    }
}

// ---- details: light minus the mean of the rows DETAIL_SIDE above and below ----------------------------------------------------
static inline int64_t reflected(int64_t r, int64_t rows) { return r < 0 ? -r : r >= rows ? 2 * rows - 2 - r : r; }

static void down(const float *across, const float *taps, float *detail, int64_t rows, int64_t width) { // smooth over nine rows
    for (int64_t r = 0; r < rows; r++) {
        const float *restrict x = across + r * width;
        float *restrict out = detail + r * width;
        for (int64_t c = 0; c < width; c++) out[c] = taps[4] * x[c];
        for (int64_t t = 1; t <= 4; t++) {
            const float *restrict u = across + reflected(r - t, rows) * width, *restrict d = across + reflected(r + t, rows) * width;
            for (int64_t c = 0; c < width; c++) out[c] += taps[4 + t] * (u[c] + d[c]);
        }
    }
}

// Light, laser-on picture and details of some columns, in w->thin_light, w->thin_on and w->thin_detail.
void look(const Scene *s, int64_t first, int64_t step, int64_t thin, Any *w) {
    const int64_t rows = s->rows, width = s->width;
    float *across = w->evidence, *smooth = w->closed; // (rows, thin)
    for (int64_t k = 0; k < s->channels; k++) {
        for (int64_t r = 0; r < rows; r++) {
            const float *restrict l = s->light + at_row(s, k, r);
            const uint16_t *restrict on = s->on + at_row(s, k, r);
            float *restrict to = w->thin_light + (k * rows + r) * thin, *restrict mean = across + r * thin;
            uint16_t *restrict to_on = w->thin_on + (k * rows + r) * thin;
            for (int64_t i = 0; i < thin; i++) {
                const int64_t c = first + step * i, left = reflected(c - 1, width), right = reflected(c + 1, width);
                to[i] = l[c], to_on[i] = on[c], mean[i] = s->across[1] * l[c] + s->across[2] * (l[left] + l[right]);
            }
        }
        down(across, s->down, smooth, rows, thin);
        for (int64_t r = 0; r < rows; r++) {
            const float *restrict x = smooth + r * thin, *restrict u = smooth + MAX(r - DETAIL_SIDE, 0) * thin;
            const float *restrict d = smooth + MIN(r + DETAIL_SIDE, rows - 1) * thin;
            float *restrict out = w->thin_detail + (k * rows + r) * thin;
            for (int64_t c = 0; c < thin; c++) out[c] = (u[c] + d[c]) * -0.5f + x[c];
        }
    }
    if (w->level) for (int64_t r = 0; r < rows; r++) for (int64_t i = 0; i < thin; i++)
        w->thin_level[r * thin + i] = w->level[r * width + first + step * i];
}

float detail_at(const Scene *s, int64_t row, int64_t column, int64_t k) { // of one pixel
    enum { FAR = DETAIL_SIDE + 4 };
    const int64_t left = reflected(column - 1, s->width), right = reflected(column + 1, s->width);
    float mean[2 * FAR + 1], smooth[3];
    for (int64_t t = -FAR; t <= FAR; t++) {
        const float *l = s->light + at_row(s, k, within(reflected(row + t, s->rows), s->rows));
        mean[FAR + t] = s->across[1] * l[column] + s->across[2] * (l[left] + l[right]);
    }
    for (int side = -1; side <= 1; side++) {
        const int64_t centre = within(row + side * DETAIL_SIDE, s->rows) - row + FAR;
        float sum = s->down[4] * mean[centre];
        for (int64_t t = 1; t <= 4; t++) {
            const int64_t up = reflected(row - FAR + centre - t, s->rows) - row + FAR;
            const int64_t low = reflected(row - FAR + centre + t, s->rows) - row + FAR;
            sum += s->down[4 + t] * (mean[up] + mean[low]);
        }
        smooth[side + 1] = sum;
    }
    return (smooth[0] + smooth[2]) * -0.5f + smooth[1];
}

// Brightness (rows, width) of the scene of a mono camera [grey levels]: means of 5 x 5 pixels. sums: (rows, width).
void brightness(const Scene *s, uint16_t *sums, uint8_t *level) {
    const int64_t rows = s->rows, width = s->width;
    for (int64_t r = 0; r < rows; r++) for (int64_t c = 0; c < width; c++) {
        int32_t sum = 0;
        for (int64_t t = -2; t <= 2; t++) sum += s->off[at_row(s, 0, within(r + t, rows)) + c] / (LEVEL / FIT_LEVEL);
        sums[r * width + c] = (uint16_t)(sum / 5);
    }
    for (int64_t r = 0; r < rows; r++) for (int64_t c = 0; c < width; c++) {
        int32_t sum = 0;
        for (int64_t t = -2; t <= 2; t++) sum += sums[r * width + within(c + t, width)];
        level[r * width + c] = (uint8_t)((sum / 5 + FIT_LEVEL / 2) / FIT_LEVEL);
    }
}
