// Measurement of a stripe along a known path, at full resolution, in a window of rows about the path.
#include "kernel.h"

// ROWS: rows of a window; the path is in row MIDDLE. MARGIN: largest shift at which the window of a neighbouring column can be
// used as it is. INNER: rows that are summed over three columns.
enum { ROWS = 64, MIDDLE = 31, MARGIN = 7, INNER = ROWS - 2 * MARGIN };
// Rows of the grey opening that estimates the background: wider than any stripe, narrower than texture.
#define OPENING 25
// A path jumps where it moves by more rows than JUMP_ROWS between neighbouring columns. Beside a jump, the light within
// NEAR_ROWS of the path rows on its two sides is compared.
#define JUMP_ROWS 4
#define NEAR_ROWS 3
// Largest distance of a peak from the path, in sigmas of its ridge (of the stripe if that is wide), and its least value [px].
#define REACH_SIGMAS 1.5
#define LEAST_REACH_PX 2
// Largest spacing of the columns in which the width of the stripe is measured, and bounds of its sigma.
#define WIDTH_COLUMNS 8
#define FWHM_PER_SIGMA 2.3548
#define LEAST_SIGMA_PX 1.0
#define LARGEST_SIGMA_PX 8.0
// Least noise [grey levels], as in find.c. The noise is measured in END_ROWS rows at each end of every NOISE_COLUMNS-th window.
#define LEAST_NOISE 0.3
#define END_ROWS 6
#define NOISE_COLUMNS 5

// Pictures and weights of their channels: light = sum of mix * (on - gain * off), with weights of 1 in clipped columns.
typedef struct {
    const Picture *on, *off;
    const uint8_t *is_core;
    float mix[3], gain[3];
} Mixture;

static float light_at(const Mixture *m, int64_t row, int64_t column) {
    float sum = 0;
    const int64_t r = within(row, m->on->rows);
    for (int64_t k = 0; k < m->on->channels; k++) {
        float v = (float)level(m->on, r, column, k);
        if (m->off) v -= m->gain[k] * (float)level(m->off, r, column, k);
        sum += m->is_core[column] ? v : m->mix[k] * v;
    }
    return sum;
}

// Light of ROWS rows of a column, from row `first` on.
static void column_light(const Mixture *m, int64_t first, int64_t column, float *restrict out) {
    const Picture *on = m->on, *off = m->off;
    if (on->size != 1 || first < 0 || first + ROWS > on->rows) {
        for (int64_t t = 0; t < ROWS; t++) out[t] = light_at(m, first + t, column);
        return;
    }
    for (int64_t t = 0; t < ROWS; t++) out[t] = 0;
    for (int64_t k = 0; k < on->channels; k++) {
        const float share = m->is_core[column] ? 1 : m->mix[k], gain = m->gain[k];
        const char *p = on->data + first * on->row_step + column * on->column_step + k * on->channel_step;
        if (!off) {
            for (int64_t t = 0; t < ROWS; t++) out[t] += share * (float)*(const uint8_t *)(p + t * on->row_step);
            continue;
        }
        const char *q = off->data + first * off->row_step + column * off->column_step + k * off->channel_step;
        for (int64_t t = 0; t < ROWS; t++)
            out[t] += share * ((float)*(const uint8_t *)(p + t * on->row_step) -
                               gain * (float)*(const uint8_t *)(q + t * off->row_step));
    }
}

// Light (STRIP, ROWS) of a strip of columns, read row by row, so that vector instructions can be used. Returns 0, and
// writes nothing, for pictures of 16 bits and for windows that begin too far apart or reach beyond the picture.
enum { STRIP = 16, MOST_APART = 32 };
static int strip_light(const Mixture *m, const int64_t *row, int64_t column, float *restrict out) {
    const Picture *on = m->on, *off = m->off;
    int64_t first = row[column], last = first;
    for (int64_t c = 1; c < STRIP; c++) first = MIN(first, row[column + c]), last = MAX(last, row[column + c]);
    const int64_t count = last - first + ROWS;
    if (on->size != 1 || last - first > MOST_APART || first < MIDDLE || first - MIDDLE + count > on->rows) return 0;
    float buffer[(MOST_APART + ROWS) * STRIP], share[3][STRIP];
    memset(buffer, 0, sizeof *buffer * (size_t)(count * STRIP));
    for (int64_t k = 0; k < on->channels; k++)
        for (int c = 0; c < STRIP; c++) share[k][c] = m->is_core[column + c] ? 1 : m->mix[k];
    for (int64_t t = 0; t < count; t++) {
        const int64_t r = first - MIDDLE + t;
        const char *p = on->data + r * on->row_step + column * on->column_step;
        const char *q = off ? off->data + r * off->row_step + column * off->column_step : NULL;
        float *restrict sum = buffer + t * STRIP;
        for (int64_t k = 0; k < on->channels; k++, p += on->channel_step, q += off ? off->channel_step : 0) {
            float v[STRIP];
            if (on->column_step == 3) for (int c = 0; c < STRIP; c++) v[c] = (float)((const uint8_t *)p)[3 * c];
            else for (int64_t c = 0; c < STRIP; c++) v[c] = (float)*(const uint8_t *)(p + c * on->column_step);
            const float gain = m->gain[k];
            if (off && off->column_step == 3) for (int c = 0; c < STRIP; c++) v[c] -= gain * (float)((const uint8_t *)q)[3 * c];
            else if (off) for (int64_t c = 0; c < STRIP; c++) v[c] -= gain * (float)*(const uint8_t *)(q + c * off->column_step);
            for (int c = 0; c < STRIP; c++) sum[c] += share[k][c] * v[c];
        }
    }
    for (int64_t c = 0; c < STRIP; c++) {
        const float *restrict x = buffer + (row[column + c] - first) * STRIP + c;
        for (int64_t t = 0; t < ROWS; t++) out[c * ROWS + t] = x[t * STRIP];
    }
    return 1;
}

// Brightest light within NEAR_ROWS of a row, above the mean of the light OPENING / 2 rows away.
static float height_near(const Mixture *m, int64_t row, int64_t column) {
    float most = -INFINITY;
    for (int64_t t = -NEAR_ROWS; t <= NEAR_ROWS; t++) {
        float sum = 0;
        for (int64_t s = -1; s <= 1; s++) sum += light_at(m, row + t + s, column);
        most = MAX(most, sum);
    }
    return most - 1.5f * (light_at(m, row - OPENING / 2, column) + light_at(m, row + OPENING / 2, column));
}

// Beside a jump, a picture with averaged columns mixes both sides: move each column to the side on which it is brighter.
static void choose_sides(const Mixture *m, int64_t reach, const uint8_t *is_path, int64_t *row) {
    const int64_t n = m->on->columns;
    for (int64_t c = 1; c < n; c++) {
        if (!is_path[c] || !is_path[c - 1] || llabs(row[c] - row[c - 1]) <= JUMP_ROWS) continue;
        const int64_t before = row[c - 1], after = row[c], first = MAX(c - reach, 0), last = MIN(c + reach, n);
        for (int64_t i = first; i < last; i++) {
            if (llabs(row[i] - (i < c ? before : after)) > JUMP_ROWS) continue;
            const int is_after = height_near(m, after, i) > height_near(m, before, i);
            if (is_after != (i >= c)) row[i] = is_after ? after : before;
        }
        c = last;
    }
}

// Running minimum and maximum over OPENING rows, in place, by doubling the number of rows; loops of constant length become
// vector instructions.
enum { HALF = OPENING / 2, LENGTH = INNER + 2 * OPENING, COUNTED = 80 };
#define DOUBLE(OF, BY) for (int t = 0; t < COUNTED; t++) v[t] = OF(v[t], v[t + BY]);
static void lowest_of(float *restrict v) { DOUBLE(MIN, 1) DOUBLE(MIN, 2) DOUBLE(MIN, 4) DOUBLE(MIN, 8) DOUBLE(MIN, OPENING - 16) }
static void highest_of(float *restrict v) { DOUBLE(MAX, 1) DOUBLE(MAX, 2) DOUBLE(MAX, 4) DOUBLE(MAX, 8) DOUBLE(MAX, OPENING - 16) }

// Subtract the grey opening from INNER rows; rows beyond them are ignored.
static void open_rows(float *restrict x) {
    float low[LENGTH], high[LENGTH];
    for (int t = 0; t < LENGTH; t++) low[t] = INFINITY, high[t] = -INFINITY;
    memcpy(low + HALF, x, INNER * sizeof *x);
    lowest_of(low);
    memcpy(high + HALF, low, INNER * sizeof *x);
    highest_of(high);
    for (int t = 0; t < INNER; t++) x[t] -= high[t];
}

static int64_t highest_near(const float *x, int64_t row, int64_t reach) {
    int64_t best = MAX(row - reach, 0);
    for (int64_t t = best + 1; t <= MIN(row + reach, INNER - 1); t++) if (x[t] > x[best]) best = t;
    return best;
}

static int64_t wide_near(const float *x, int64_t row, int64_t reach, double sigma) { // row with the largest Gaussian-weighted sum over rows
    const int64_t half = (int64_t)ceil(2 * sigma);
    float taps[OPENING], most = -INFINITY;
    int64_t best = row;
    for (int64_t t = 0; t <= half; t++) taps[t] = (float)exp(-0.5 * (double)(t * t) / (sigma * sigma));
    for (int64_t r = MAX(row - reach, 0); r <= MIN(row + reach, INNER - 1); r++) {
        float sum = taps[0] * x[r];
        for (int64_t t = 1; t <= half; t++) sum += taps[t] * (x[within(r - t, INNER)] + x[within(r + t, INNER)]);
        if (sum > most) most = sum, best = r;
    }
    return best;
}

// A column has no stripe if its light is below: near an end, END_SHARE of the brightest light nearby or END_SIGMAS times the
// noise, whichever is larger; near a jump, JUMP_SHARE of the brightest light nearby; anywhere, LEAST_SHARE of the strong columns,
// as in a narrow gap.
#define END_SHARE 0.25f
#define END_SIGMAS 4.0f
#define JUMP_SHARE 0.1f
#define LEAST_SHARE 0.1f
#define LEAST_SHARE_ALONE 0.15f // without a laser-off picture

// Remove columns without light at ends, at jumps and in gaps from a path and its stripe, which were found in means of `factor`
// columns. height, row: (n,) height of the peaks, row of the path. work: (3, n).
static void trim(const float *height, const int64_t *row, int64_t n, int64_t factor, uint8_t *is_path, uint8_t *is_stripe,
    const uint8_t *is_core, float least, float noise, float *work) {
    float *lit = work, *is_end = work + n, *is_jump = is_end + n;
    int64_t count = 0;
    for (int64_t c = 0; c < n; c++) if (is_stripe[c]) work[count++] = height[c];
    const float strong = count ? select_value(work, count, 3 * (count - 1) / 4) : 0;
    for (int64_t c = 0; c < n; c++) {
        lit[c] = is_path[c] ? height[c] : 0, is_end[c] = !is_stripe[c];
        is_jump[c] = c + 1 < n && llabs(row[c + 1] - row[c]) > JUMP_ROWS;
    }
    for (int64_t c = 0; c < n; c++) {
        if (!is_path[c]) continue;
        float most = 0, end = 0, jump = 0;
        for (int64_t i = MAX(c - 4 * factor, 0); i <= MIN(c + 4 * factor, n - 1); i++) most = MAX(most, lit[i]);
        for (int64_t i = MAX(c - 2 * factor, 0); i <= MIN(c + 2 * factor, n - 1); i++)
            end = MAX(end, is_end[i]), jump = MAX(jump, is_jump[i]);
        const float mean = (height[MAX(c - 1, 0)] + height[c] + height[MIN(c + 1, n - 1)]) / 3;
        const int is_dim = mean < least * strong && !is_core[c];
        if (is_dim || (end > 0 && height[c] < MAX(END_SHARE * most, noise)) || (jump > 0 && height[c] < JUMP_SHARE * most))
            is_path[c] = is_stripe[c] = 0;
    }
}

// Length of `work` of `measure_window` (float).
int64_t window_size(int64_t columns) { return columns * (ROWS + 2 * INNER) + 4 * columns + 64; }

// Measure a stripe along its path. mix, gain: weights of the channels, and factors of the laser-off picture. is_path, is_stripe,
// is_core: (n,) masks of the columns that may have a stripe, that have one (columns without light are removed from both), and
// that are clipped. factor: number of columns averaged to find the path. ridge: sigma of the path's ridge [px]. row: (n,) rows
// of the path, replaced by the rows of the peaks. height, answers: (n,) and (SHIFTS, n), receive the light of the peaks and the
// responses of the filters. found: receives sigma of the stripe [px] and noise of a response.
void measure_window(const Picture *on, const Picture *off, const double *mix, const double *gain, uint8_t *is_path,
    uint8_t *is_stripe, const uint8_t *is_core, int64_t factor, double ridge, float *work, int64_t *row, float *height,
    float *answers, double *found) {
    const int64_t n = on->columns;
    Mixture m = {.on = on, .off = off, .is_core = is_core};
    for (int64_t k = 0; k < on->channels; k++) m.mix[k] = (float)mix[k], m.gain[k] = (float)gain[k];
    float *light = work, *sums = light + n * ROWS, *smooth = sums + n * INNER, *some = smooth + n * INNER;
    if (factor > 1) choose_sides(&m, factor, is_path, row);
    for (int64_t begin = 0; begin < n; begin += STRIP) {
        if (begin + STRIP <= n && strip_light(&m, row, begin, light + begin * ROWS)) continue;
        for (int64_t c = begin; c < MIN(begin + STRIP, n); c++) column_light(&m, row[c] - MIDDLE, c, light + c * ROWS);
    }
    for (int64_t c = 0; c < n; c++) {
        float *restrict sum = sums + c * INNER, *restrict out = smooth + c * INNER;
        memcpy(sum, light + c * ROWS + MARGIN, INNER * sizeof *sum);
        for (int64_t side = -1; side <= 1; side += 2) {
            int64_t other = c + side;
            if (other < 0 || other >= n) other = within(c - side, n);
            const int64_t shift = row[c] - row[other];
            if (llabs(shift) <= MARGIN && is_core[other] == is_core[c]) {
                const float *restrict x = light + other * ROWS + MARGIN + shift;
                for (int t = 0; t < INNER; t++) sum[t] += x[t];
            } else { // another window, or another mixture
                float x[ROWS];
                Mixture same = m;
                uint8_t core[1] = {is_core[c]};
                same.is_core = core - other;
                column_light(&same, row[c] - MIDDLE, other, x);
                for (int t = 0; t < INNER; t++) sum[t] += x[t + MARGIN];
            }
        }
        open_rows(sum);
        for (int t = 0; t < INNER; t++) out[t] = sum[MAX(t - 1, 0)] + sum[t] + sum[MIN(t + 1, INNER - 1)];
    }
    // The ends of a window contain only noise.
    int64_t count = 0, used = 0;
    for (int64_t c = 0; c < n; c += NOISE_COLUMNS) for (int t = 0; t < END_ROWS; t++) {
        some[count++] = sums[c * INNER + t], some[count++] = sums[c * INNER + INNER - 1 - t];
    }
    const double noise = robust_sigma(some, count);
    for (int64_t c = 0; c < n; c++) used += is_stripe[c];
    const int64_t reach = MAX((int64_t)ceil(REACH_SIGMAS * ridge), LEAST_REACH_PX), path = MIDDLE - MARGIN;
    double sigma = LEAST_SIGMA_PX;
    int64_t *top = (int64_t *)some;
    for (int64_t c = 0; c < n; c++) top[c] = used ? highest_near(smooth + c * INNER, path, reach) : path;
    if (used) {
        const int64_t apart = MIN(WIDTH_COLUMNS, MAX(used / WIDTH_COLUMNS, 1));
        float *widths = light; // no longer needed
        count = used = 0;
        for (int64_t c = 0; c < n; c++) {
            if (!is_stripe[c] || used++ % apart) continue;
            const float *x = smooth + c * INNER, half = 0.5f * x[top[c]];
            int64_t low = 0, up = 0;
            while (top[c] + low < INNER && x[top[c] + low] > half) low++;
            while (top[c] - up >= 0 && x[top[c] - up] > half) up++;
            widths[count++] = (float)(low + up - 1);
        }
        const double width = (double)upper_median(widths, count) / FWHM_PER_SIGMA;
        sigma = sqrt(MAX(width * width - ROW_SMOOTHING_VARIANCE, 0));
        sigma = rint(10 * MIN(MAX(sigma, LEAST_SIGMA_PX), LARGEST_SIGMA_PX)) / 10;
        const int64_t wide = MAX((int64_t)ceil(REACH_SIGMAS * sigma), LEAST_REACH_PX);
        if (sigma > WIDE_SIGMA_PX)
            for (int64_t c = 0; c < n; c++) top[c] = wide_near(sums + c * INNER, top[c], wide, sigma);
    }
    float filters[SHIFTS * MOST_TAPS];
    const int64_t taps = derivative_filters(sigma, filters);
    for (int64_t c = 0; c < n; c++) {
        const float *x = smooth + c * INNER;
        float answer[SHIFTS] = {0};
        for (int64_t t = 0; t < taps; t++) {
            const float seen = x[within(top[c] - taps / 2 + t, INNER)];
            for (int s = 0; s < SHIFTS; s++) answer[s] += filters[s * taps + t] * seen;
        }
        for (int s = 0; s < SHIFTS; s++) answers[s * n + c] = answer[s];
        height[c] = x[top[c]];
    }
    if (factor > 1) trim(height, row, n, factor, is_path, is_stripe, is_core, off ? LEAST_SHARE : LEAST_SHARE_ALONE,
        END_SIGMAS * sqrtf(ROW_MEAN_PX) * (float)noise, light);
    for (int64_t c = 0; c < n; c++) row[c] = within(row[c] + top[c] - path, on->rows);
    const double least = LEAST_NOISE * 3 * full_scale(on) / 255;
    found[0] = sigma, found[1] = MAX(noise, least) * noise_gain(filters, taps, ROW_MEAN_PX);
}
