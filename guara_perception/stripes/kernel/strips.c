// The picture in the laser's colour, and its ridges of some widths, in strips of columns.
#include "any_light.h"

// ---- strips of 16 columns: a row of one is in one or a few registers ---------------------------------------------------------
typedef float Row __attribute__((vector_size(4 * STRIP), aligned(4)));
static inline void keep_higher(Row *a, const Row *b) { for (int i = 0; i < STRIP; i++) (*a)[i] = MAX((*a)[i], (*b)[i]); }
static inline void keep_lower(Row *a, const Row *b) { for (int i = 0; i < STRIP; i++) (*a)[i] = MIN((*a)[i], (*b)[i]); }

// ---- vertical windows -----------------------------------------------------------------------------------------------------
#define WINDOW 25
#define HALF (WINDOW / 2)
static void extreme(Row *x, int n, int is_highest) { // over WINDOW rows of n + 2 HALF rows; in place, from row 0 on
    static const int BY[5] = {1, 2, 4, 8, WINDOW - 16};
    for (int step = 0; step < 5; step++) {
        const int by = BY[step], end = step < 4 ? n + 2 * HALF - by : n;
        if (is_highest) for (int r = 0; r < end; r++) keep_higher(x + r, x + r + by);
        else for (int r = 0; r < end; r++) keep_lower(x + r, x + r + by);
    }
}
// Grey closing or opening along the columns, or what an opening leaves of the picture; what lies beyond does not count.
static void close_or_open(const float *in, float *out, int rows, int width, int is_closing, Row *work, int only_rest) {
    Row *inside = work + HALF, *after = inside + rows;
    for (int begin = 0; begin < width; begin += STRIP) {
        const int n = MIN(STRIP, width - begin);
        for (int r = 0; r < rows; r++) {
            const float *x = in + (int64_t)r * width + begin;
            if (n == STRIP) memcpy(inside + r, x, sizeof(Row));
            else memset(inside + r, 0, sizeof(Row)), memcpy(inside + r, x, sizeof *x * (size_t)n);
        }
        for (int pass = 0; pass < 2; pass++) {
            const int is_highest = is_closing ^ pass;
            if (pass) memmove(inside, work, sizeof(Row) * (size_t)rows);
            for (int i = 0; i < HALF; i++) for (int c = 0; c < STRIP; c++) work[i][c] = after[i][c] = is_highest ? -INFINITY : INFINITY;
            extreme(work, rows, is_highest);
        }
        for (int r = 0; r < rows; r++) {
            const int64_t at = (int64_t)r * width + begin;
            const float *x = (const float *)(work + r);
            if (n == STRIP && only_rest) for (int c = 0; c < STRIP; c++) out[at + c] = in[at + c] - x[c];
            else for (int c = 0; c < n; c++) out[at + c] = only_rest ? in[at + c] - x[c] : x[c];
        }
    }
}

// ---- laser_colour.in_laser_colour --------------------------------------------------------------------------------------
void in_laser_colour(const View *v, const double *weights, int channel, float *mixed, uint8_t *core, Any *w) {
    const Scene *s = v->scene;
    const int rows = v->rows, width = v->width;
    const float m0 = (float)weights[0], m1 = (float)weights[1], m2 = (float)weights[2];
    int first = rows, last = -1;
    for (int r = 0; r < rows; r++) {
        float *restrict out = mixed + (int64_t)r * width;
        const uint8_t *p;
        if (v->light) {
            const float *restrict l0 = v->light + (int64_t)r * width, *restrict l1 = l0 + (int64_t)rows * width;
            const float *restrict l2 = l1 + (int64_t)rows * width;
            for (int c = 0; c < width; c++) out[c] = m0 * l0[c] + m1 * l1[c] + m2 * l2[c];
            p = v->frame + ((int64_t)channel * rows + r) * width;
        } else {
            uint8_t *on = (uint8_t *)w->line, *off = on + 3 * width;
            channel_rows(s, row_of(s, s->on, r), on);
            p = on + channel * width;
            const uint8_t *restrict a0 = on, *restrict a1 = on + width, *restrict a2 = on + 2 * width;
            if (v->scene->has_dark) {
                channel_rows(s, row_of(s, s->off, r), off);
                const uint8_t *restrict b0 = off, *restrict b1 = off + width, *restrict b2 = off + 2 * width;
                const float *g = v->scene->gain, *o = v->scene->offset;
                const float g0 = g[0], g1 = g[1], g2 = g[2], o0 = o[0], o1 = o[1], o2 = o[2], most = s->most;
                for (int c = 0; c < width; c++)
                    out[c] = m0 * ((float)a0[c] - expected(g0, b0[c], o0, most)) + m1 * ((float)a1[c] - expected(g1, b1[c], o1, most)) +
                             m2 * ((float)a2[c] - expected(g2, b2[c], o2, most));
            } else
                for (int c = 0; c < width; c++) out[c] = m0 * (float)a0[c] + m1 * (float)a1[c] + m2 * (float)a2[c];
        }
        uint8_t *restrict full = core + (int64_t)r * width;
        uint8_t any = 0;
        for (int c = 0; c < width; c++) full[c] = p[c] >= LEVEL_CLIPPED, any |= full[c];
        if (any) first = MIN(first, r), last = r;
    }
    if (last < 0) return;
    // One row more above and below.
    const int top = MAX(first - 1, 0), end = MIN(last + 2, rows);
    uint8_t *before = (uint8_t *)w->line, *here = before + width;
    memset(before, 0, (size_t)width);
    for (int r = top; r < end; r++) {
        uint8_t *restrict row = core + (int64_t)r * width, *restrict next = r + 1 < rows ? row + width : NULL;
        memcpy(here, row, (size_t)width);
        for (int c = 0; c < width; c++) row[c] = before[c] | here[c] | (next ? next[c] : 0);
        uint8_t *t = before; before = here, here = t;
    }
    const int from = MAX(top - WINDOW, 0), to = MIN(end - 1 + WINDOW + 1, rows);
    float *closed = w->heights[0];
    close_or_open(mixed + (int64_t)from * width, closed, to - from, width, 1, (Row *)w->heights[1], 0);
    for (int r = top; r < end; r++) {
        const uint8_t *restrict row = core + (int64_t)r * width;
        for (int c = 0; c < width; c++) if (row[c]) {
            const float rim = closed[(int64_t)(r - from) * width + c];
            const float sum = view_light(v, r, c, 0) + view_light(v, r, c, 1) + view_light(v, r, c, 2);
            const float others = 0.1f * (sum - view_light(v, r, c, channel)), most = 0.5f * MAX(rim, 0.0f);
            mixed[(int64_t)r * width + c] = rim + MIN(MAX(others, 0.0f), most);
        }
    }
}

// Evidence is ZERO less than the strength, and from LINEAR on its logarithm grows by GAIN_OF_LOG.
#define ZERO 3.2f
#define LINEAR 8.0f
#define GAIN_OF_LOG 3.0f

// ---- ridges --------------------------------------------------------------------------------------------------------------
// 16 columns at a time: a strip of them stays in the nearest cache, and a row of it in one or a few registers.
#define BEYOND 12 // rows of a strip above and below the picture, which are those at its edge
static inline void put(const Row *strip, float *out, int rows, int width, int n) { // a copy of constant size is one move
    if (n == STRIP) for (int r = 0; r < rows; r++) memcpy(out + (int64_t)r * width, strip + r, sizeof(Row));
    else for (int r = 0; r < rows; r++) for (int c = 0; c < n; c++) out[(int64_t)r * width + c] = ((const float *)(strip + r))[c];
}

static void extend(Row *strip, int rows) { // strip[0] is row -BEYOND
    for (int i = 0; i < BEYOND; i++) strip[i] = strip[BEYOND], strip[BEYOND + rows + i] = strip[BEYOND + rows - 1];
}

#define RIDGE(K, REACH, SIDE)                                                                                          \
    static void ridge##K(const Row *strip, Row *smooth, int rows, const float *taps, Row *out) {                       \
        strip += BEYOND, smooth += BEYOND;                                                                             \
        for (int r = 0; r < rows; r++) {                                                                               \
            Row sum = taps[REACH] * strip[r];                                                                          \
            _Pragma("GCC unroll 10") for (int t = 1; t <= REACH; t++) sum += taps[REACH + t] * (strip[r - t] + strip[r + t]); \
            smooth[r] = sum;                                                                                           \
        }                                                                                                              \
        extend(smooth - BEYOND, rows);                                                                                 \
        for (int r = 0; r < rows; r++) {                                                                               \
            Row side = smooth[r - SIDE];                                                                               \
            keep_higher(&side, smooth + r + SIDE);                                                                     \
            out[r] = smooth[r] - side;                                                                                 \
        }                                                                                                              \
    }
RIDGE(0, 3, 3) RIDGE(1, 5, 6) RIDGE(2, 10, 12)

// Heights (WIDTHS, rows) of a strip of columns `begin`, `begin + step`, ...; those beyond the picture repeat its last column.
static void heights_of_strip(const float *laser, int rows, int width, int begin, int step, float taps[WIDTHS][32], Row *strip,
    Row *smooth, Row *heights) {
    const float third = (float)(1.0 / 3);
    const int is_inside = begin > 0 && begin + STRIP * step < width;
    for (int r = 0; r < rows; r++) { // mean of three columns, borders replicated
        const float *row = laser + (int64_t)r * width, *x = row + begin;
        float *to = (float *)(strip + BEYOND + r);
        if (is_inside && step == 1) for (int c = 0; c < STRIP; c++) to[c] = third * x[c] + third * (x[c - 1] + x[c + 1]);
        else if (is_inside) for (int c = 0, i = 0; c < STRIP; c++, i += step) to[c] = third * x[i] + third * (x[i - 1] + x[i + 1]);
        else for (int c = 0; c < STRIP; c++) {
            const int at = MIN(begin + c * step, width - 1);
            to[c] = third * row[at] + third * (row[MAX(at - 1, 0)] + row[MIN(at + 1, width - 1)]);
        }
    }
    extend(strip, rows);
    ridge0(strip, smooth, rows, taps[0], heights), ridge1(strip, smooth, rows, taps[1], heights + rows);
    ridge2(strip, smooth, rows, taps[2], heights + 2 * rows);
}

// How high ridges are by chance; where `away` is given texture beside that path is chance too.
void noises_of_ridges(const float *laser, int rows, int width, const Path *away, int reach, double *noises, float *line,
    float *samples) {
    float taps[WIDTHS][32], *some[WIDTHS];
    for (int k = 0; k < WIDTHS; k++) {
        gaussian(2 * REACHES[k] + 1, SIGMAS[k], taps[k]);
        some[k] = samples + (int64_t)k * (rows / 2 + 1) * (width / 3 + 1);
    }
    Row *strip = (Row *)line, *smooth = strip + rows + 2 * BEYOND, *heights = smooth + rows + 2 * BEYOND;
    const int step = !away ? 7 : width < 160 ? 3 : 6, down = away ? 2 : 3;
    int n = 0;
    for (int begin = 0; begin < width; begin += STRIP * step) {
        heights_of_strip(laser, rows, width, begin, step, taps, strip, smooth, heights);
        const float *h[WIDTHS] = {(float *)heights, (float *)(heights + rows), (float *)(heights + 2 * rows)};
        for (int c = 0; c < STRIP && begin + c * step < width; c++) {
            const int at = begin + c * step, is_stripe = away && away->is_stripe[at];
            const int low = is_stripe ? away->row[at] - reach : rows, high = low + 2 * reach;
            for (int r = 0; r < rows; r += down) {
                for (int k = 0; k < WIDTHS; k++) some[k][n] = h[k][r * STRIP + c];
                n += (r < low) | (r > high);
            }
        }
    }
    for (int k = 0; k < WIDTHS; k++) {
        const double texture = n && away ? (double)select_value(some[k], n, (int)(0.99 * n)) / 3.0 : 0;
        const double noise = n ? robust_sigma(some[k], n) : 0;
        noises[k] = MAX(MAX(noise, texture), 0.15);
    }
}

// Strength of the strongest ridge at every pixel, where it is wanted, and its evidence column by column.
void strengths(const float *laser, const double *noises, int rows, int width, float *strength, float *evidence, float *line) {
    const float f0 = (float)(1 / noises[0]), f1 = (float)(1 / noises[1]), f2 = (float)(1 / noises[2]);
    float taps[WIDTHS][32];
    for (int k = 0; k < WIDTHS; k++) gaussian(2 * REACHES[k] + 1, SIGMAS[k], taps[k]);
    Row *strip = (Row *)line, *smooth = strip + rows + 2 * BEYOND, *h = smooth + rows + 2 * BEYOND;
    for (int begin = 0; begin < width; begin += STRIP) {
        const int n = MIN(STRIP, width - begin);
        heights_of_strip(laser, rows, width, begin, 1, taps, strip, smooth, h);
        for (int r = 0; r < rows; r++) {
            const Row a = h[r] * f0, b = h[rows + r] * f1, c = h[2 * rows + r] * f2;
            smooth[r] = a;
            keep_higher(smooth + r, &b), keep_higher(smooth + r, &c);
        }
        if (strength) put(smooth, strength + begin, rows, width, n);
        for (int r = 0; r < rows; r++) {
            const Row linear = {LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR, LINEAR,
                LINEAR, LINEAR, LINEAR, LINEAR};
            Row seen = smooth[r];
            float highest = seen[0];
            keep_lower(&seen, &linear);
            seen -= ZERO;
            for (int c = 1; c < STRIP; c++) highest = MAX(highest, smooth[r][c]);
            if (highest > LINEAR) // few, and logarithms are dear
                for (int c = 0; c < STRIP; c++)
                    if (smooth[r][c] > LINEAR) seen[c] += GAIN_OF_LOG * (float)log((double)(smooth[r][c] / LINEAR));
            smooth[r] = seen;
        }
        for (int c = 0; c < n; c++) {
            float *restrict out = evidence + (int64_t)(begin + c) * rows;
            for (int r = 0; r < rows; r++) out[r] = ((const float *)smooth)[r * STRIP + c];
        }
    }
}

// Height and width of the strongest ridge at one pixel, as the strips have them.
float ridge_at(const float *laser, int rows, int width, int row, int c, const double *noises, float taps[WIDTHS][32],
    float *sigma) {
    enum { FAR = 22 };
    const float third = (float)(1.0 / 3);
    float mean[2 * FAR + 1], found = 0, most = -INFINITY;
    const int left = MAX(c - 1, 0), right = MIN(c + 1, width - 1);
    for (int t = -FAR; t <= FAR; t++) {
        const float *x = laser + (int64_t)within(row + t, rows) * width;
        mean[FAR + t] = third * x[c] + third * (x[left] + x[right]);
    }
    for (int k = 0; k < WIDTHS; k++) {
        float smooth[3];
        for (int i = 0; i < 3; i++) { // at the row, above and below; a row beyond the picture is that at its edge
            const int centre = within(row + (i - 1) * SIDES[k], rows) - row + FAR;
            float sum = taps[k][REACHES[k]] * mean[centre];
            for (int t = 1; t <= REACHES[k]; t++) sum += taps[k][REACHES[k] + t] * (mean[centre - t] + mean[centre + t]);
            smooth[i] = sum;
        }
        const float h = smooth[1] - MAX(smooth[0], smooth[2]), v = noises ? h * (float)(1 / noises[k]) : h;
        if (v > most) most = v, found = h, *sigma = (float)SIGMAS[k];
    }
    return found;
}

