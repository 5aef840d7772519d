// Light of a pair of pictures, also of another exposure, and what of it changes across the columns within a few pixels.
#include "any_light.h"

// Ratio of exposures beyond which noise, clipping and the camera's own curve differ too. Such a picture is used, up to the
// second, if no more than so many grey levels of the scene are left in most of its pixels: it shows the same view.
#define MOST_GAIN 1.6
#define MOST_USED_GAIN 3.0
#define MOST_LEFT 0.9
// A fit that changes by less is done.
#define SAME_GAIN 2e-4
#define SAME_OFFSET 0.02

// ---- exposure.subtract -------------------------------------------------------------------------------------------------
static void fit(const uint8_t *dark, const uint8_t *bright, int n, float *work, uint8_t *use, double *gain, double *offset) {
    *gain = 1, *offset = 0;
    memset(use, 1, (size_t)n);
    for (int round = 0; round < 6; round++) {
        int64_t count = 0, x = 0, y = 0, xx = 0, xy = 0;
        for (int i = 0; i < n; i++) {
            const int m = use[i] ? -1 : 0, d = dark[i] & m, b = bright[i] & m;
            count -= m, x += d, y += b, xx += d * d, xy += d * b;
        }
        const double mx = (double)x / (double)count, my = (double)y / (double)count;
        const double variance = (double)xx / (double)count - mx * mx;
        if (variance < 1) break;
        const double gain_before = *gain, offset_before = *offset;
        *gain = ((double)xy / (double)count - mx * my) / variance;
        *offset = my - *gain * mx;
        if (round && fabs(*gain - gain_before) < SAME_GAIN && fabs(*offset - offset_before) < SAME_OFFSET) break;
        const float g = (float)*gain, o = (float)*offset;
        for (int i = 0; i < n; i++) work[i] = fabsf((float)bright[i] - g * (float)dark[i] - o);
        if (round == 5) break;
        float *copy = work + n;
        memcpy(copy, work, sizeof *work * (size_t)n);
        const float most = (float)(2.5 * MAX((double)median_f(copy, n), 0.5));
        for (int i = 0; i < n; i++) use[i] = work[i] <= most;
    }
}

static double contrast(const float *blocks, int n, float *work) { // median deviation from the median
    memcpy(work, blocks, sizeof *work * (size_t)n);
    const float m = median_f(work, n);
    for (int i = 0; i < n; i++) work[i] = fabsf(blocks[i] - m);
    return (double)median_f(work, n);
}

// Means of blocks of 8 x 8 pixels of every channel, as cv2.resize with INTER_AREA has them.
static void block_means(const Scene *s, int is_on, int ny, int nx, uint16_t *sums, float *means) {
    const int w = s->width;
    for (int y = 0; y < ny; y++) {
        const int first = 8 * y, count = MIN(8, s->rows - first);
        memset(sums, 0, sizeof *sums * (size_t)(3 * w));
        for (int r = first; r < first + count; r++) {
            const uint8_t *p = row_of(s, is_on ? s->on : s->off, r);
            for (int i = 0; i < 3 * w; i++) sums[i] = (uint16_t)(sums[i] + p[i]);
        }
        for (int x = 0; x < nx; x++) {
            const int size = MIN(8, w - 8 * x);
            for (int k = 0; k < CHANNELS; k++) {
                int sum = 0;
                for (int i = 0; i < size; i++) sum += sums[3 * (8 * x + i) + k];
                means[((int64_t)k * ny + y) * nx + x] = (float)sum / (float)(size * count);
            }
        }
    }
}

void fit_exposure(Scene *s, int is_changed, Any *w) {
    const int sw = (s->width + 3) / 4, sh = (s->rows + 7) / 8, n = sw * sh;
    const int ny = (int)rint(s->rows / 8.0), nx = (int)rint(s->width / 8.0);
    uint8_t *dark = (uint8_t *)(w->samples + 3 * n), *bright = dark + n, *use = bright + n;
    float *work = w->samples, *on = w->heights[0], *off = on + 3 * ny * nx, *left = off + 3 * ny * nx;
    block_means(s, 1, ny, nx, (uint16_t *)w->line, on), block_means(s, 0, ny, nx, (uint16_t *)w->line, off);
    for (int k = 0; k < CHANNELS; k++) {
        int32_t levels[256] = {0};
        int m = 0;
        for (int r = 0; r < s->rows; r += 8) for (int c = 0; c < s->width; c += 4) {
            const uint8_t p = row_of(s, s->on, r)[3 * c + k], q = row_of(s, s->off, r)[3 * c + k];
            bright[m] = p, dark[m] = q, m += p < LEVEL_CLIPPED && q < LEVEL_CLIPPED;
        }
        if (!m) { s->gain[k] = 1, s->offset[k] = 0; continue; }
        for (int i = 0; i < m; i++) levels[dark[i]]++, work[i] = (float)(bright[i] - dark[i]);
        // A value at least as large as this quantile is bright; between two levels that is the upper one.
        const float at = (float)(m - 1) * 0.9f;
        int rest = (int)at, level = 0;
        while (rest >= levels[level]) rest -= levels[level++];
        if (at > (float)(int)at && rest + 1 == levels[level]) do level++; while (level < 255 && !levels[level]);
        const double offset = (double)median_f(work, m);
        double gain, fitted_offset;
        fit(dark, bright, m, work, use, &gain, &fitted_offset);
        const float g = (float)gain, o = (float)fitted_offset, plain_offset = (float)offset;
        double sums[2], lefts[2];
        for (int kind = 0; kind < 2; kind++) {
            int number = 0;
            float *all = work, *some = work + m;
            for (int i = 0; i < m; i++) {
                const float d = (float)dark[i], p = (float)bright[i], v = kind ? fabsf(p - d - plain_offset) : fabsf(p - g * d - o);
                all[i] = v, some[number] = v, number += dark[i] >= level;
            }
            lefts[kind] = (double)median_f(all, m), sums[kind] = lefts[kind] + (double)median_f(some, number);
        }
        const int is_fitted = sums[0] < 0.7 * sums[1];
        s->gain[k] = is_fitted ? g : 1;
        s->offset[k] = is_fitted ? o : plain_offset;
        const double used = is_fitted ? gain : 1;
        const int is_unlike = !(1 / MOST_GAIN <= used && used <= MOST_GAIN), is_told = s->remark == OTHER_EXPOSURE;
        if (is_unlike && !is_told) s->remark = OTHER_EXPOSURE, s->remark_number = 1 / used;
        const int is_left = lefts[!is_fitted] > MOST_LEFT * MAX(used, 1) || !(1 / MOST_USED_GAIN <= used && used <= MOST_USED_GAIN);
        if ((is_unlike || is_told || is_changed) && is_left) {
            s->remark = is_changed ? OTHER_SCENE : OTHER_EXPOSURE, s->has_dark = 0;
            return;
        }
        for (int i = 0; i < ny * nx; i++) left[i] = on[k * ny * nx + i] - s->gain[k] * off[k * ny * nx + i];
        const double scene = contrast(on + k * ny * nx, ny * nx, work), unlike = contrast(left, ny * nx, work);
        if (unlike > MAX(0.5 * scene, 6.0)) {
            s->remark = OTHER_SCENE, s->has_dark = 0;
            return;
        }
    }
}

// ---- laser_colour.details, in the columns in which they are looked at ----------------------------------------------------
static inline int reflected(int r, int rows) { return r < 0 ? -r : r >= rows ? 2 * rows - 2 - r : r; }

static void down(const float *across, const float *taps, float *detail, int rows, int width) { // smooth over nine rows
    for (int r = 0; r < rows; r++) {
        const float *restrict x = across + (int64_t)r * width;
        float *restrict out = detail + (int64_t)r * width;
        for (int c = 0; c < width; c++) out[c] = taps[4] * x[c];
        for (int t = 1; t <= 4; t++) {
            const float *restrict u = across + (int64_t)reflected(r - t, rows) * width;
            const float *restrict d = across + (int64_t)reflected(r + t, rows) * width;
            for (int c = 0; c < width; c++) out[c] += taps[4 + t] * (u[c] + d[c]);
        }
    }
}
static void subtract_beside(const float *smooth, float *detail, int rows, int width) {
    for (int r = 0; r < rows; r++) {
        const float *restrict x = smooth + (int64_t)r * width, *restrict u = smooth + (int64_t)MAX(r - 5, 0) * width;
        const float *restrict d = smooth + (int64_t)MIN(r + 5, rows - 1) * width;
        float *restrict out = detail + (int64_t)r * width;
        for (int c = 0; c < width; c++) out[c] = (u[c] + d[c]) * -0.5f + x[c];
    }
}

static void light_row(const Scene *s, int r, int k, const uint8_t *on, const uint8_t *off, float *out) {
    const int w = s->width;
    const uint8_t *restrict p = on + k * w, *restrict q = off + k * w;
    const float gain = s->gain[k], offset = s->offset[k], most = s->most;
    (void)r;
    if (s->has_dark) for (int c = 0; c < w; c++) out[c] = (float)p[c] - expected(gain, q[c], offset, most);
    else for (int c = 0; c < w; c++) out[c] = (float)p[c];
}

void look(const Scene *s, Any *w, int thin, int some) {
    // Light, frame and details of every fourth column, details of every fifth.
    const int rows = s->rows, width = s->width, step = 4, first = 2;
    const float *taps = s->across;
    uint8_t *on = (uint8_t *)(w->line + 2 * width + 16), *off = on + 3 * width;
    float *l = w->line + 1, *h = w->line + width + 8;
    float *across = w->heights[0], *across_some = w->heights[1]; // (CHANNELS, rows, thin), (CHANNELS, rows, some)
    for (int r = 0; r < rows; r++) {
        channel_rows(s, row_of(s, s->on, r), on);
        if (s->has_dark) channel_rows(s, row_of(s, s->off, r), off);
        for (int k = 0; k < CHANNELS; k++) {
            const int64_t at = ((int64_t)k * rows + r) * thin, at_some = ((int64_t)k * rows + r) * some;
            light_row(s, r, k, on, off, l);
            l[-1] = l[1], l[width] = l[width - 2];
            for (int c = 0; c < width; c++) h[c] = taps[1] * l[c] + taps[2] * (l[c - 1] + l[c + 1]);
            for (int c = 0; c < thin; c++) {
                w->thin_light[at + c] = l[first + step * c], w->thin_frame[at + c] = on[k * width + first + step * c];
                across[at + c] = h[first + step * c];
            }
            for (int c = 0; c < some; c++) across_some[at_some + c] = h[5 * c];
        }
    }
    for (int k = 0; k < CHANNELS; k++) {
        float *smooth = w->heights[2];
        down(across + (int64_t)k * rows * thin, s->down, smooth, rows, thin);
        subtract_beside(smooth, w->thin_detail + (int64_t)k * rows * thin, rows, thin);
        down(across_some + (int64_t)k * rows * some, s->down, smooth, rows, some);
        subtract_beside(smooth, w->some_detail + (int64_t)k * rows * some, rows, some);
    }
}

float detail_at(const Scene *s, int row, int column, int k) { // of one pixel of the band
    static const int SHIFT[3] = {0, -5, 5};
    const int rows = s->rows, w = s->width;
    const float *across = s->across, *taps = s->down;
    float smooth[3];
    const int left = reflected(column - 1, w), right = reflected(column + 1, w);
    for (int side = 0; side < 3; side++) {
        const int centre = within(row + SHIFT[side], rows);
        float h[9];
        for (int t = 0; t < 9; t++) {
            const int r = reflected(centre + t - 4, rows);
            h[t] = across[1] * light_at(s, r, column, k) + across[2] * (light_at(s, r, left, k) + light_at(s, r, right, k));
        }
        float sum = taps[4] * h[4];
        for (int t = 1; t <= 4; t++) sum += taps[4 + t] * (h[4 - t] + h[4 + t]);
        smooth[side] = sum;
    }
    return (smooth[1] + smooth[2]) * -0.5f + smooth[0];
}

