// A stripe by the highest peaks of its band. One pass from the pictures to their smoothed light: no copy of the band.
#include "kernel.h"

// Sums instead of means over three columns and three rows keep the fractions of a grey level in whole numbers.
#define COLUMN_MEAN_PX 3
// Rows and columns from one sample of the noise to the next; noise below a third of a quantum cannot be seen.
#define SAMPLE_ROWS 8
#define SAMPLE_COLUMNS 24
#define LEAST_NOISE 0.3
// A second peak is at least one block of rows away from the block of the highest. Columns that are handled at a time.
#define BLOCK_ROWS 8
enum { CHUNK = 64 };
// 5 sigma lets 0.1 % false columns through; the relative floor keeps a faint halo out of the gaps of a bright stripe.
#define THRESHOLD_SIGMAS 5.0
#define THRESHOLD_OF_MEDIAN_PEAK 0.05
// Distance of the columns in which the stripe's width is measured, and widths that make sense [px]: the lens never images
// a line sharper than the first. A wider one than the third is smoothed again to its own width.
#define WIDTH_COLUMNS 32
#define LEAST_SIGMA_PX 1.0
#define LARGEST_SIGMA_PX 8.0
#define WIDE_SIGMA_PX 2.5
// Rows that are added up for the widest stripe, at the most.
#define SUMMED_ROWS 33
#define FWHM_PER_SIGMA 2.3548
// The highest peaks are trusted if their median height exceeds this many sigmas of the noise, at most MOST_JUMPS of them
// jump by more than JUMP_PX rows to the next column, and at most MOST_RIVALS of them have a rival.
#define CLEAR_SIGMAS 15.0
#define JUMP_PX 4
#define MOST_JUMPS 0.05
#define MOST_RIVALS 0.2
// Noise above this is not the sensor's: the two frames do not match, and may hide a stripe [grey levels of 8 bits]. The same for a
// laser-off picture of another exposure, where the difference is known to contain some of the scene.
#define MOST_NOISE 4.0
#define MOST_UNEVEN_NOISE 2.5
// Peaks in a smaller share of the columns are chance: the band holds no stripe, which leaves no doubt.
#define LEAST_COLUMNS 0.05
// Height of a second peak, as a share of the highest, from which it is a rival.
#define RIVAL_OF_PEAK 0.35f
// Columns without a rival that are added on both sides of a run of columns with one, and the longest run that is a jump.
#define CONTEXT_COLUMNS 6
#define EDGE_COLUMNS 4
// A choice is ambiguous if the cost of the next best exceeds its own by less than this.
#define LEAST_MARGIN 1.5
// Peaks of one column closer than this, in sigmas of the stripe and at least in pixels, are one peak.
#define APART_SIGMAS 3.0
#define APART_PX 5
#define MOST_CANDIDATES 4
// Factor of log(highest / own height) in the cost of a peak, with the highest candidate of its column.
#define WEAKNESS_COST 2.0f
// Row difference between neighbouring columns that costs 1; a jump (an edge) costs at most JUMP_COST.
#define ROWS_PER_COST 2.0
#define JUMP_COST 4.0
// Cost of choosing no peak in a column, and of entering or leaving that state.
#define DROPOUT_COST 3.0
#define GAP_COST 1.0
// Fusing the channels: columns from one sampled top of the stripe to the next, sigmas of noise by which a top stands out,
// and the headroom of a channel that is clipped throughout: even that shows where the shoulders of the stripe are.
#define TOP_COLUMNS 16
#define TOP_SIGMAS 5.0
#define LEAST_HEADROOM 0.3

// Costs of the ways through the candidates of a column.
typedef struct { double own[MOST_CANDIDATES + 1], forward[MOST_CANDIDATES + 1], backward[MOST_CANDIDATES + 1]; } Costs;

// Light of a band: of one channel or of all together, whole numbers (int16_t) of one channel of 8 bits, float otherwise.
typedef struct {
    const Picture *on, *off;
    int64_t rows, columns, channel, is_fused, is_float;
    float mix[3], offset; // Light: the mixture of the channels, less the offset.
    int32_t highest;      // highest level of that channel in the rows made so far
} Light;

// Memory: lines (columns,) of samples, light, sums and blocks, samples of a statistic, ways through candidates.
typedef struct {
    char *lines, *light, *ring, *blocks, *sums, *searched;
    float *samples, *values, *heights;
    int64_t *indices, *candidates;
    Costs *costs;
} Work;

static int64_t carve(Work *work, char *memory, int64_t rows, int64_t columns, int64_t size) {
    const int64_t blocks = rows / BLOCK_ROWS + 1, samples = (rows / SAMPLE_ROWS + 1) * (columns / SAMPLE_COLUMNS + 1);
    const int64_t most = MAX(MAX(samples, rows), columns);
    int64_t at = 0;
#define TAKE(NAME, SIZE) work->NAME = (void *)(memory + at), at += ((SIZE) + 63) / 64 * 64
    TAKE(lines, 2 * 6 * columns);
    TAKE(light, 4 * (columns + 2));
    TAKE(ring, 4 * 3 * columns);
    TAKE(blocks, size * blocks * columns);
    TAKE(samples, 4 * most);
    TAKE(values, 4 * most);
    TAKE(heights, 4 * MOST_CANDIDATES * columns);
    TAKE(indices, 8 * columns);
    TAKE(candidates, 8 * MOST_CANDIDATES * columns);
    // The sums are not needed any more when candidates are chosen. Only a wide stripe is searched for in other light.
    TAKE(costs, MAX((int64_t)sizeof(Costs), SUMMED_ROWS * size) * columns);
    work->sums = (char *)work->costs;
    TAKE(searched, size * rows * columns);
    return at;
}

// Bytes of `memory` of `find_stripe`; size: bytes of a number of its light.
int64_t find_size(int64_t rows, int64_t columns, int64_t size) {
    static char nothing[1];
    Work work;
    return carve(&work, nothing, rows, columns, size);
}

// ---- light ---------------------------------------------------------------------------------------------------------
// Every third byte of 3 n from the first on. Whole vectors are read only up to the last of these bytes.
typedef uint8_t Pair __attribute__((vector_size(32)));
typedef uint8_t Bytes __attribute__((vector_size(16)));
// What lies 48 bytes apart, each in its half of a register.
#define BOTH(A, FROM)                                                                                                  \
    Bytes A##1, A##2;                                                                                                  \
    memcpy(&A##1, FROM, 16), memcpy(&A##2, (FROM) + 48, 16);                                                           \
    const Pair A = __builtin_shufflevector(A##1, A##2, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17,   \
        18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31)
void every_third(const uint8_t *restrict from, int64_t n, uint8_t *restrict to) {
    int64_t i = 0;
    for (; i + 32 < n; i += 32) {
        BOTH(a, from + 3 * i);
        BOTH(b, from + 3 * i + 16);
        BOTH(c, from + 3 * i + 32);
        const Pair ab = __builtin_shufflevector(a, b, 0, 3, 6, 9, 12, 15, 34, 37, 40, 43, 46, 0, 0, 0, 0, 0, 16, 19, 22, 25,
            28, 31, 50, 53, 56, 59, 62, 16, 16, 16, 16, 16);
        const Pair abc = __builtin_shufflevector(ab, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 33, 36, 39, 42, 45, 16, 17, 18, 19,
            20, 21, 22, 23, 24, 25, 26, 49, 52, 55, 58, 61);
        memcpy(to + i, &abc, 32);
    }
    for (; i < n; i++) to[i] = from[3 * i];
}

// One channel of a row, side by side; `line` is used where they do not lie so already.
static const void *samples_of(const Picture *p, int64_t row, int64_t channel, void *line) {
    const char *restrict from = p->data + row * p->row_step + channel * p->channel_step;
    const int64_t step = p->column_step, n = p->columns;
    uint8_t *restrict to = line;
    if (step == p->size && p->size == 1) return from;
    if (p->size == 2) for (int64_t c = 0; c < n; c++) memcpy(to + 2 * c, from + c * step, 2);
    else if (step == 3) every_third((const uint8_t *)from, n, to);
    else for (int64_t c = 0; c < n; c++) to[c] = (uint8_t)from[c * step];
    return line;
}

// Means of `factor` (2 or 4) columns of a colour picture of 8 bits, (rows, columns / factor, 3) in one piece.
// lines: 3 columns of bytes.
void shrink(const Picture *p, int64_t factor, uint8_t *lines, uint8_t *out) {
    const int64_t n = p->columns, count = n / factor;
    for (int64_t r = 0; r < p->rows; r++, out += 3 * count)
        for (int64_t k = 0; k < 3; k++) {
            const uint8_t *restrict x = samples_of(p, r, k, lines);
            uint8_t *restrict mean = lines + n;
            if (factor == 4) for (int64_t c = 0; c < count; c++)
                mean[c] = (uint8_t)((x[4 * c] + x[4 * c + 1] + x[4 * c + 2] + x[4 * c + 3] + 2) >> 2);
            else for (int64_t c = 0; c < count; c++) mean[c] = (uint8_t)((x[2 * c] + x[2 * c + 1] + 1) >> 1);
            for (int64_t c = 0; c < count; c++) out[3 * c + k] = mean[c];
        }
}

#define LIGHT_OF_ROW(NAME, SAMPLE, TYPE)                                                                               \
    static void one_##NAME(Light *light, int64_t row, char *lines, TYPE *restrict out) {                               \
        const int64_t n = light->columns;                                                                              \
        const SAMPLE *restrict p = samples_of(light->on, row, light->channel, lines);                                  \
        const SAMPLE *restrict q = samples_of(light->off, row, light->channel, lines + 2 * n);                         \
        const TYPE offset = (TYPE)light->offset;                                                                       \
        SAMPLE highest = 0;                                                                                            \
        for (int64_t c = 0; c < n; c++) highest = MAX(highest, p[c]), out[c] = (TYPE)((TYPE)(p[c] - q[c]) - offset);   \
        light->highest = MAX(light->highest, (int32_t)highest);                                                        \
    }                                                                                                                  \
    static void all_##NAME(Light *light, int64_t row, char *lines, float *restrict out) {                              \
        const int64_t n = light->columns;                                                                              \
        const SAMPLE *restrict p[3], *restrict q[3];                                                                   \
        for (int64_t k = 0; k < 3; k++) {                                                                              \
            p[k] = samples_of(light->on, row, k, lines + 2 * k * n);                                                   \
            q[k] = samples_of(light->off, row, k, lines + 2 * (3 + k) * n);                                            \
        }                                                                                                              \
        const float offset = light->offset, a = light->mix[0], b = light->mix[1], m = light->mix[2];                   \
        for (int64_t c = 0; c < n; c++)                                                                                \
            out[c] = a * (float)(p[0][c] - q[0][c]) - offset + b * (float)(p[1][c] - q[1][c]) + m * (float)(p[2][c] - q[2][c]); \
        light->highest = INT32_MAX;                                                                                    \
    }
LIGHT_OF_ROW(bytes, uint8_t, int16_t)
LIGHT_OF_ROW(words, uint16_t, float)

static void light_of_row(Light *light, int64_t row, char *lines, void *out) {
    if (light->is_fused && light->on->size == 1) all_bytes(light, row, lines, out);
    else if (light->is_fused) all_words(light, row, lines, out);
    else if (light->on->size == 1) one_bytes(light, row, lines, out);
    else one_words(light, row, lines, out);
}

static float value(const void *light, int64_t is_float, int64_t at) {
    return is_float ? ((const float *)light)[at] : (float)((const int16_t *)light)[at];
}

static int32_t difference(const Light *light, int64_t row, int64_t column, int64_t channel) {
    return level(light->on, row, column, channel) - level(light->off, row, column, channel);
}

// Light (rows,) of a column in the laser's channel.
static void differences(const Light *light, int64_t column, float *own) {
    const Picture *on = light->on, *off = light->off;
    const char *p = on->data + column * on->column_step + light->channel * on->channel_step;
    const char *q = off->data + column * off->column_step + light->channel * off->channel_step;
    if (on->size == 2) for (int64_t r = 0; r < light->rows; r++) own[r] = (float)difference(light, r, column, light->channel);
    else for (int64_t r = 0; r < light->rows; r++)
        own[r] = (float)(*(const uint8_t *)(p + r * on->row_step) - *(const uint8_t *)(q + r * off->row_step));
    if (column + TOP_COLUMNS >= on->columns) return;
    for (int64_t r = 0; r < light->rows; r++) { // far apart in memory: the next column is asked for
        __builtin_prefetch(p + r * on->row_step + TOP_COLUMNS * on->column_step);
        __builtin_prefetch(q + r * off->row_step + TOP_COLUMNS * off->column_step);
    }
}

// Mixture of all channels for a stripe whose core clips the strongest one: each channel is weighted by its headroom (the
// share of stripe tops at which it is not clipped) times its signal over its noise variance, all taken from the data, so
// a line of any colour works alike.
static void mix_channels(Light *light, Work *work) {
    const int64_t rows = light->rows, columns = light->columns, count = (columns + TOP_COLUMNS - 1) / TOP_COLUMNS;
    float offset[3];
    double noise[3], weight[3], gain[3], dot = 0, most = 0;
    for (int k = 0; k < 3; k++) {
        int64_t n = 0;
        for (int64_t r = 0; r < rows; r += SAMPLE_ROWS)
            for (int64_t c = 0; c < columns; c += SAMPLE_COLUMNS) work->samples[n++] = (float)difference(light, r, c, k);
        offset[k] = upper_median(work->samples, n);
        for (int64_t i = 0; i < n; i++) work->samples[i] = fabsf(work->samples[i] - offset[k]);
        noise[k] = (double)((float)SIGMA_PER_DEVIATION * upper_median(work->samples, n));
        noise[k] = MAX(noise[k], full_scale(light->on) / 512);
    }
    int64_t shown = 0, *top = work->indices, *column = work->candidates;
    for (int is_any = 0; is_any < 2 && !shown; is_any++)
        for (int64_t i = 0; i < count; i++) {
            float highest = -INFINITY, *own = work->samples;
            int64_t row = 0;
            differences(light, i * TOP_COLUMNS, own);
            for (int64_t r = 0; r < rows; r++) {
#define AT(R) own[within((R) < 0 ? -(R) : (R) < rows ? (R) : 2 * (rows - 1) - (R), rows)]
                const float *x = own + r;
                const float smooth = r >= 2 && r + 2 < rows ? 6 * x[0] + 4 * (x[-1] + x[1]) + (x[-2] + x[2])
                                                            : 6 * x[0] + 4 * (AT(r - 1) + AT(r + 1)) + (AT(r - 2) + AT(r + 2));
                if (smooth > highest) highest = smooth, row = r;
            }
            if (!is_any && !(highest / 16 > (float)(TOP_SIGMAS * noise[light->channel]))) continue;
            top[shown] = row, column[shown++] = i * TOP_COLUMNS;
        }
    for (int k = 0; k < 3; k++) {
        int64_t clipped = 0;
        for (int64_t i = 0; i < shown; i++) {
            clipped += level(light->on, top[i], column[i], k) >= clipped_from(light->on);
            work->samples[i] = (float)difference(light, top[i], column[i], k);
        }
        const double headroom = MAX(1 - (double)clipped / (double)shown, LEAST_HEADROOM);
        gain[k] = MAX((double)upper_median(work->samples, shown) - (double)offset[k] - noise[k], 0);
        weight[k] = headroom * headroom * gain[k] / (noise[k] * noise[k]);
        dot += weight[k] * gain[k], most = MAX(most, gain[k]);
    }
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        const double share = weight[k] * (most / MAX(dot, 1e-12));
        light->mix[k] = (float)share, sum += share * (double)offset[k];
    }
    light->offset = (float)sum;
}

// ---- smoothing and peaks ---------------------------------------------------------------------------------------------
// The whole band: sums of three columns and three rows, and the highest of every block of rows; of every eighth row some
// sums of three columns. At the edges the light is mirrored. Returns the number of these samples.
// Sums over rows by weights for a wide stripe: of sums of three columns; beyond the edges the light is that at the edge.
#define SMOOTHING(NAME, TYPE, ROUNDED)                                                                                 \
    static void columns_##NAME(Light *light, int64_t row, Work *work, int64_t is_mirrored, TYPE *restrict sums) {      \
        const int64_t n = light->columns, inner = is_mirrored && n > 1;                                                \
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
                columns_##NAME(light, r, work, 1, now);                                                                \
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
    static void widely_##NAME(Light *light, Work *work, double sigma) {                                                \
        const int64_t rows = light->rows, n = light->columns, reach = (int64_t)ceil(2 * sigma);                        \
        TYPE *sums = (TYPE *)work->sums;                                                                               \
        float taps[64] = {0}, *restrict total = work->values;                                                          \
        double all = 0;                                                                                                \
        for (int64_t t = -reach; t <= reach; t++) all += exp(-0.5 * (double)(t * t) / (sigma * sigma));                \
        for (int64_t t = 0; t <= reach; t++)                                                                           \
            taps[t] = (float)(3 * exp(-0.5 * (double)(t * t) / (sigma * sigma)) / all);                                \
        for (int64_t r = 0, made = 0; r < rows; r++) {                                                                 \
            for (; made < rows && made <= r + reach; made++)                                                           \
                columns_##NAME(light, made, work, 0, sums + made % SUMMED_ROWS * n);                                   \
            const TYPE *restrict here = sums + r % SUMMED_ROWS * n;                                                    \
            TYPE *restrict out = (TYPE *)work->searched + r * n;                                                       \
            TYPE *restrict block = (TYPE *)work->blocks + r / BLOCK_ROWS * n;                                          \
            for (int64_t c = 0; c < n; c++) total[c] = taps[0] * (float)here[c];                                       \
            for (int64_t t = 1; t <= reach; t++) {                                                                     \
                const TYPE *restrict up = sums + within(r - t, rows) % SUMMED_ROWS * n;                                \
                const TYPE *restrict low = sums + within(r + t, rows) % SUMMED_ROWS * n;                               \
                for (int64_t c = 0; c < n; c++) total[c] += taps[t] * ((float)up[c] + (float)low[c]);                  \
            }                                                                                                          \
            for (int64_t c = 0; c < n; c++) {                                                                          \
                const TYPE sum = (TYPE)ROUNDED(total[c]);                                                              \
                out[c] = sum, block[c] = r % BLOCK_ROWS ? MAX(block[c], sum) : sum;                                    \
            }                                                                                                          \
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
SMOOTHING(int16, int16_t, rintf)
SMOOTHING(float, float, )

// Typical width of a stripe as the sigma of a Gaussian [px], from the rows above half the peak: only the unbroken stretch
// around the top counts, not a second stripe further off. smoothed: variance of the Gaussian that the rows of `smooth`
// were smoothed by. top, height: of n columns, some of which are looked at. work: (n,).
double stripe_sigma(const void *smooth, int64_t is_float, int64_t rows, int64_t columns, const int64_t *top,
    const float *height, const int64_t *some, int64_t n, double smoothed, float *work) {
    const int64_t reach = (int64_t)ceil(FWHM_PER_SIGMA * LARGEST_SIGMA_PX);
    for (int64_t i = 0; i < n; i++) {
        const float half = 0.5f * height[i];
        int64_t low = 0, up = 0;
        while (low < reach && value(smooth, is_float, within(top[i] + low, rows) * columns + some[i]) > half) low++;
        while (up < reach && value(smooth, is_float, within(top[i] - up, rows) * columns + some[i]) > half) up++;
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

// ---- choice ----------------------------------------------------------------------------------------------------------
static double move(int64_t count, int64_t from, int64_t to, const int64_t *before, const int64_t *after) {
    if (from == count && to == count) return 0;
    if (from == count || to == count) return GAP_COST;
    const double rows = fabs((double)(before[from] - after[to])) / ROWS_PER_COST;
    return MIN(rows, JUMP_COST);
}

// Choose one of up to four peaks, or none, in each of n neighbouring columns: dynamic programming with explicit dropout.
// rows, heights: (n, count) of the candidates, height 0 where a column has fewer. choice: index of the chosen one, -1 for
// none. margin: cost of the cheapest path with another choice in this column, minus the cost of the best path.
void follow_candidates(const int64_t *rows, const float *heights, int64_t n, int64_t count, Costs *costs, int64_t *choice,
    double *margin) {
    for (int64_t i = 0; i < n; i++) {
        const float *height = heights + i * count;
        float strongest = 1e-6f;
        for (int64_t k = 0; k < count; k++) strongest = MAX(strongest, height[k]);
        for (int64_t k = 0; k < count; k++) {
            const float weakness = height[k] > 0 ? -(float)log((double)(height[k] / strongest)) : INFINITY;
            costs[i].own[k] = (double)(WEAKNESS_COST * weakness);
        }
        costs[i].own[count] = DROPOUT_COST;
        for (int64_t k = 0; k <= count; k++) {
            double best = i ? INFINITY : 0;
            for (int64_t j = 0; i && j <= count; j++) {
                const double cost = costs[i - 1].forward[j] + move(count, j, k, rows + (i - 1) * count, rows + i * count);
                best = MIN(best, cost);
            }
            costs[i].forward[k] = costs[i].own[k] + best;
        }
    }
    for (int64_t i = n - 1; i >= 0; i--) {
        double least = INFINITY, next = INFINITY;
        for (int64_t k = 0; k <= count; k++) {
            double best = i < n - 1 ? INFINITY : 0;
            for (int64_t j = 0; i < n - 1 && j <= count; j++) {
                const double cost = costs[i + 1].own[j] + costs[i + 1].backward[j];
                best = MIN(best, cost + move(count, k, j, rows + i * count, rows + (i + 1) * count));
            }
            costs[i].backward[k] = best;
            const double total = costs[i].forward[k] + best;
            if (total < least) next = least, least = total, choice[i] = k < count ? k : -1;
            else next = MIN(next, total);
        }
        margin[i] = isfinite(next) ? next - least : INFINITY;
    }
}

// Up to MOST_CANDIDATES local maxima of a column, highest first, further apart than `distance`; height 0 for none.
static void candidates(const void *searched, const Light *light, int64_t column, float threshold, int64_t distance,
    int64_t *rows, float *heights) {
    const int64_t last = light->rows - 1, n = light->columns;
    for (int k = 0; k < MOST_CANDIDATES; k++) {
        rows[k] = 0, heights[k] = 0;
        float before = -INFINITY, here = value(searched, light->is_float, column);
        for (int64_t r = 0; r <= last; r++) {
            const float after = r < last ? value(searched, light->is_float, (r + 1) * n + column) : -INFINITY;
            int is_free = here >= before && here >= after && here >= threshold && here > heights[k];
            for (int j = 0; j < k && is_free; j++) is_free = llabs(r - rows[j]) > distance;
            if (is_free) rows[k] = r, heights[k] = here;
            before = here, here = after;
        }
    }
    for (int k = 1; k < MOST_CANDIDATES; k++) if (heights[k] < RIVAL_OF_PEAK * heights[0]) heights[k] = 0;
}

// Test for doubt that the highest peaks of a band are its stripe.
static int is_doubtful(const Light *light, const int64_t *top, const float *height, const float *second,
    double threshold, double noise, int is_uneven) {
    const float least = (float)threshold;
    int64_t count = 0, dim = 0, jumps = 0, rivals = 0;
    const float clear = (float)(CLEAR_SIGMAS / THRESHOLD_SIGMAS * threshold);
    for (int64_t c = 0; c < light->columns; c++) count += height[c] > least, dim += height[c] > least && height[c] < clear;
    const int is_few = (double)count < LEAST_COLUMNS * (double)light->columns;
    noise /= COLUMN_MEAN_PX * full_scale(light->on) / 255;
    if (is_uneven && (is_few || noise > MOST_UNEVEN_NOISE)) return 1;
    if (is_few) return noise > MOST_NOISE;
    if (dim > count / 2) return 1; // the upper median is dim
    for (int64_t c = 0; c < light->columns; c++) {
        if (!(height[c] > least)) continue;
        jumps += c > 0 && height[c - 1] > least && llabs(top[c] - top[c - 1]) > JUMP_PX;
        rivals += second[c] > least && second[c] > RIVAL_OF_PEAK * height[c];
    }
    return (double)jumps > MOST_JUMPS * (double)count || (double)rivals > MOST_RIVALS * (double)count;
}

// Choose the highest peak where it has no rival; elsewhere follow the stripe from column to column. is_unsure: another
// choice would have been as good.
static void choose(const Light *light, Work *work, const void *searched, int64_t *top, float *height, const float *second,
    double threshold, double sigma, uint8_t *is_unsure) {
    const int64_t n = light->columns, distance = MAX((int64_t)ceil(APART_SIGMAS * sigma), APART_PX);
    const float least = (float)threshold;
    double *margin = (double *)work->indices;
    uint8_t *is_rival = (uint8_t *)work->lines;
    for (int64_t c = 0; c < n; c++) {
        is_rival[c] = second[c] > RIVAL_OF_PEAK * height[c] && second[c] > least && height[c] > least;
        is_unsure[c] = 0;
    }
    for (int64_t begin = 0, end; begin < n; begin = end) {
        if (!is_rival[begin]) { end = begin + 1; continue; }
        // Runs whose contexts overlap are joined.
        int64_t last = begin;
        for (end = begin + 1; end < n && end - last <= 2 * CONTEXT_COLUMNS; end++) if (is_rival[end]) last = end;
        end = last + 1;
        if (end - begin <= EDGE_COLUMNS) {
            // At a jump the mean over columns mixes the light of both sides: neither peak is right.
            for (int64_t c = begin; c < end; c++) is_unsure[c] = is_rival[c];
            continue;
        }
        const int64_t first = MAX(begin - CONTEXT_COLUMNS, 0), count = MIN(end + CONTEXT_COLUMNS, n) - first;
        int64_t *rows = work->candidates, *choice = (int64_t *)work->ring;
        for (int64_t i = 0; i < count; i++)
            candidates(searched, light, first + i, least, distance, rows + MOST_CANDIDATES * i,
                work->heights + MOST_CANDIDATES * i);
        follow_candidates(rows, work->heights, count, MOST_CANDIDATES, work->costs, choice, margin);
        for (int64_t i = 0; i < count; i++) {
            const float *heights = work->heights + MOST_CANDIDATES * i;
            if (choice[i] >= 0) top[first + i] = rows[MOST_CANDIDATES * i + choice[i]], height[first + i] = heights[choice[i]];
            is_unsure[first + i] |= heights[1] > 0 && (choice[i] < 0 || margin[i] < LEAST_MARGIN);
        }
    }
}

// Noise of the light that is searched for peaks; and the columns (n) whose peak stands out from it.
static double noise_of(const Light *light, Work *work, const void *searched, const float *height, int64_t *n) {
    int64_t count = 0;
    for (int64_t r = 0; r < light->rows; r += SAMPLE_ROWS)
        for (int64_t c = 0; c < light->columns; c += SAMPLE_COLUMNS)
            work->samples[count++] = value(searched, light->is_float, r * light->columns + c);
    const double spread = robust_sigma(work->samples, count), noise = MAX(spread, LEAST_NOISE * SCALE);
    *n = 0;
    for (int64_t c = 0; c < light->columns; c++)
        if (height[c] > (float)(THRESHOLD_SIGMAS * noise)) work->indices[(*n)++] = c;
    return noise;
}

// Find a stripe in a pair of pictures, column by column: the row and the height of its peak, whether it counts, whether
// its core is clipped, and whether it is unsure. Returns whether it is in doubt: then the highest peaks are given.
// is_fused: whether all channels together are searched. smooth: (rows, columns), receives the
// smoothed light. found: sigma of the stripe and noise of the light.
int64_t find_stripe(const Picture *on, const Picture *off, const Judgement *seen, int64_t is_fused, char *memory, void *smooth, int64_t *top, float *height, uint8_t *is_peak, uint8_t *is_clipped,
    uint8_t *is_unsure, double *found) {
    Work work;
    Light light = {.on = on, .off = off, .rows = on->rows, .columns = on->columns, .channel = (int64_t)seen->channel,
        .is_fused = is_fused, .is_float = is_fused || on->size == 2};
    const int64_t n = light.columns;
    carve(&work, memory, on->rows, n, light.is_float ? 4 : 2);
    if (light.is_fused) mix_channels(&light, &work);
    else light.offset = fabs(seen->change) > full_scale(on) / 256 ? (float)seen->change : 0;
    float *second = work.values;
    int64_t samples = light.is_float ? smooth_float(&light, &work, smooth) : smooth_int16(&light, &work, smooth), strong;
    const double spread = samples ? robust_sigma(work.values, samples) : 0;
    const double own_noise = MAX(spread, LEAST_NOISE * COLUMN_MEAN_PX);
    const void *searched = smooth;
    if (light.is_float) peaks_float(&light, &work, searched, top, height, second);
    else peaks_int16(&light, &work, searched, top, height, second);
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
        searched = work.searched;
        if (light.is_float) widely_float(&light, &work, sigma), peaks_float(&light, &work, searched, top, height, second);
        else widely_int16(&light, &work, sigma), peaks_int16(&light, &work, searched, top, height, second);
        noise = noise_of(&light, &work, searched, height, &strong);
    }
    for (int64_t i = 0; i < strong; i++) work.samples[i] = height[work.indices[i]];
    const double median_peak = strong ? (double)upper_median(work.samples, strong) : 0;
    const double threshold = MAX(THRESHOLD_SIGMAS * noise, THRESHOLD_OF_MEDIAN_PEAK * median_peak);
    found[0] = sigma, found[1] = own_noise;
    const int is_in_doubt = is_doubtful(&light, top, height, second, threshold, own_noise, seen->is_uneven != 0);
    if (!is_in_doubt) choose(&light, &work, searched, top, height, second, threshold, sigma, is_unsure);
    for (int64_t c = 0; c < n; c++) is_peak[c] = height[c] > (float)threshold, is_clipped[c] = 0;
    if (!is_in_doubt && light.highest >= clipped_from(on)) {
        uint8_t *is_lost = (uint8_t *)work.lines;
        clipped_columns(on, top, sigma, light.channel, light.is_fused, is_clipped, is_lost);
        for (int64_t c = 0; c < n; c++) is_unsure[c] |= is_lost[c];
    }
    return is_in_doubt;
}
