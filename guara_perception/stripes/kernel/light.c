// Laser light of a pair of pictures, computed row by row without copying the band.
#include "find.h"

// Fusion of the channels: spacing of the columns in which tops of the stripe are sampled; sigmas of noise by which a top
// stands out; headroom of a channel that is clipped at every top, since it still shows the shoulders of the stripe.
#define TOP_COLUMNS 16
#define TOP_SIGMAS 5.0
#define LEAST_HEADROOM 0.3

// Copy n bytes, each the first of three. No vector is read beyond the last of them.
typedef uint8_t Pair __attribute__((vector_size(32)));
typedef uint8_t Bytes __attribute__((vector_size(16)));
// Two vectors that are 48 bytes apart in memory, in the halves of one register.
#define BOTH(A, FROM)                                                                                                  \
    Bytes A##1, A##2;                                                                                                  \
    memcpy(&A##1, FROM, 16), memcpy(&A##2, (FROM) + 48, 16);                                                           \
    const Pair A = __builtin_shufflevector(A##1, A##2, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17,   \
        18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31)
static void every_third(const uint8_t *restrict from, int64_t n, uint8_t *restrict to) {
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

// Samples of one channel of a row, contiguous; they are copied to `line` unless they already are.
const void *samples_of(const Picture *p, int64_t row, int64_t channel, void *line) {
    const char *restrict from = p->data + row * p->row_step + channel * p->channel_step;
    const int64_t step = p->column_step, n = p->columns;
    uint8_t *restrict to = line;
    if (step == p->size && p->size == 1) return from;
    if (p->size == 2) for (int64_t c = 0; c < n; c++) memcpy(to + 2 * c, from + c * step, 2);
    else if (step == 3) every_third((const uint8_t *)from, n, to);
    else for (int64_t c = 0; c < n; c++) to[c] = (uint8_t)from[c * step];
    return line;
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

void light_of_row(Light *light, int64_t row, char *lines, void *out) {
    if (light->is_fused && light->on->size == 1) all_bytes(light, row, lines, out);
    else if (light->is_fused) all_words(light, row, lines, out);
    else if (light->on->size == 1) one_bytes(light, row, lines, out);
    else one_words(light, row, lines, out);
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
    for (int64_t r = 0; r < light->rows; r++) { // prefetch the next column, which is far apart in memory
        __builtin_prefetch(p + r * on->row_step + TOP_COLUMNS * on->column_step);
        __builtin_prefetch(q + r * off->row_step + TOP_COLUMNS * off->column_step);
    }
}

// Mixture of all channels for a stripe whose core clips the strongest one: each channel is weighted by its headroom (the
// share of stripe tops at which it is not clipped) times its signal over its noise variance, all taken from the data, so
// a line of any colour works alike.
void mix_channels(Light *light, Work *work) {
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
