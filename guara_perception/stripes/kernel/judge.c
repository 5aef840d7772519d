// Judgement of a pair of pictures by some of its columns: channel of the laser, change of exposure, clipping.
#include "kernel.h"

// Distance of the examined rows, and number of examined columns: a thin stripe is missed in some columns, never in all.
#define JUDGED_ROWS 3
#define AHEAD_ROWS (2 * JUDGED_ROWS)
#define JUDGED_COLUMNS 16
#define MOST_COLUMNS (2 * JUDGED_COLUMNS)
// Height that noise reaches in a column, and height above which a peak stands out [mean absolute deviations].
#define NOISE_DEVIATIONS 4.0f
#define PEAK_DEVIATIONS 6.0f
// Fraction of clipped tops above which the channels are fused.
#define FUSE_FROM_CLIPPED 0.2
// Change of brightness beside the stripe above which the exposures differ, as a fraction of full scale.
#define EVEN_AMBIENT_CHANGE (1.0 / 64)
// Width of a clipped core above which the stripe has too little of its shoulders left, and distance from the top within which
// the core is searched for [sigmas of the stripe].
#define MAX_CLIPPED_SIGMAS 5.0
#define REACH_SIGMAS 3.0

// One channel of a column: highest level of the laser-on picture; highest and lowest light, and its mean absolute deviation.
typedef struct { float seen, high, low, noise; } Column;

// Length of `work` of `judge` (float).
int64_t judge_size(int64_t rows, int64_t columns, int64_t channels) {
    return (rows / JUDGED_ROWS + 1) * MIN(columns, MOST_COLUMNS) * (channels + 1);
}

// Test for swapped pictures: the deepest dip exceeds twice the highest peak, and most columns have a dip.
static int swapped(Column columns[][MOST_COLUMNS], int64_t n, int64_t channels) {
    float deepest = -INFINITY, highest = -INFINITY, most = -INFINITY, above[MOST_COLUMNS];
    int64_t channel = 0;
    for (int64_t k = 0; k < channels; k++) {
        float sum = 0;
        for (int64_t i = 0; i < n; i++) {
            deepest = MAX(deepest, -columns[k][i].low), highest = MAX(highest, columns[k][i].high);
            sum -= columns[k][i].low;
        }
        if (sum > most) most = sum, channel = k;
    }
    for (int64_t i = 0; i < n; i++) above[i] = -columns[channel][i].low - PEAK_DEVIATIONS * columns[channel][i].noise;
    return deepest > 2 * highest && median(above, n) > 0;
}

// Median of the light: change of brightness of the surroundings.
static float change_of(const float *light, int64_t n, float *copy) {
    memcpy(copy, light, (size_t)n * sizeof *copy);
    return upper_median(copy, n);
}

// Judge a pair of pictures. off: NULL if there is none; the light is then the excess over the median of a column.
void judge(const Picture *on, const Picture *off, float *work, Judgement *found) {
    const int64_t apart = MAX(on->columns / JUDGED_COLUMNS, 1), columns = (on->columns + apart - 1) / apart;
    const int64_t rows = (on->rows + JUDGED_ROWS - 1) / JUDGED_ROWS, channels = MIN(on->channels, 3), each = rows * columns;
    float *light = work, *copy = work + channels * each, change = 0;
    Column of[3][MOST_COLUMNS] = {0};
    int is_uneven = 0;
    for (int64_t r = 0; r < rows; r++)
        for (int64_t i = 0; i < columns; i++) {
            // Prefetched long before they are read, since they are far apart in memory.
            const int64_t row = JUDGED_ROWS * r, column = apart * i, soon = MIN(row + AHEAD_ROWS, on->rows - 1);
            __builtin_prefetch(on->data + soon * on->row_step + column * on->column_step);
            if (off) __builtin_prefetch(off->data + soon * off->row_step + column * off->column_step);
            for (int64_t k = 0; k < channels; k++) {
                const int32_t seen = level(on, row, column, k), dark = off ? level(off, row, column, k) : 0;
                of[k][i].seen = MAX(of[k][i].seen, (float)seen);
                light[k * each + i * rows + r] = (float)(seen - dark);
            }
        }
    for (int64_t k = 0; k < channels; k++) {
        float beside = 0;
        for (int64_t i = 0; i < columns; i++) {
            float *restrict own = light + k * each + i * rows, high = -INFINITY, low = INFINITY, sum = 0;
            if (!off) {
                memcpy(copy, own, (size_t)rows * sizeof *own);
                const float middle = (float)median(copy, rows);
                for (int64_t r = 0; r < rows; r++) own[r] -= middle;
            }
            for (int64_t r = 0; r < rows; r++) high = MAX(high, own[r]), low = MIN(low, own[r]), sum += own[r];
            // The brightest pixel of each column is omitted: the light of the stripe is no change of the surroundings.
            beside += sum - high, of[k][i].high = high, of[k][i].low = low;
        }
        beside = beside / (float)columns / (float)MAX(rows - 1, 1);
        is_uneven |= fabsf(beside) > EVEN_AMBIENT_CHANGE * full_scale(on);
    }
    float most = -INFINITY;
    int64_t channel = 0;
    for (int64_t k = 0; k < channels; k++) {
        if (is_uneven) change = change_of(light + k * each, each, copy);
        // A change of brightness, which differs between the channels, is not noise.
        const float shift = is_uneven ? change : 0;
        float stands_out = 0;
        for (int64_t i = 0; i < columns; i++) {
            const float *restrict own = light + k * each + i * rows;
            float deviation = 0;
            // The mean absolute value suffices in place of a robust sigma: the stripe is a small part of every column.
            for (int64_t r = 0; r < rows; r++) deviation += fabsf(own[r] - shift);
            of[k][i].high -= shift, of[k][i].low -= shift, of[k][i].noise = deviation / (float)rows;
            stands_out += of[k][i].high - NOISE_DEVIATIONS * of[k][i].noise;
        }
        if (stands_out > most) most = stands_out, channel = k;
    }
    int64_t tops = 0, clipped = 0;
    for (int64_t i = 0; i < columns; i++) {
        const Column *own = &of[channel][i];
        if (own->high > PEAK_DEVIATIONS * own->noise) tops++, clipped += own->seen >= (float)clipped_from(on);
    }
    *found = (Judgement){(double)channel, swapped(of, columns, channels), (double)change_of(light + channel * each, each, copy), off && is_uneven,
        (double)clipped > FUSE_FROM_CLIPPED * (double)MAX(tops, 1)};
}

// is_clipped: columns whose core is clipped in `channel`. is_lost: columns whose clipped core is too wide to be measured; if the
// channels are fused, only pixels clipped in all channels count. top: (columns,) rows of the stripe.
void clipped_columns(const Picture *on, const int64_t *top, double sigma, int64_t channel, int64_t is_fused,
    uint8_t *is_clipped, uint8_t *is_lost) {
    const int64_t reach = (int64_t)(REACH_SIGMAS * sigma);
    const int32_t from = clipped_from(on);
    for (int64_t c = 0; c < on->columns; c++) {
        int64_t one = 0, all = 0;
        for (int64_t r = top[c] - reach; r <= top[c] + reach; r++) one += level(on, within(r, on->rows), c, channel) >= from;
        is_clipped[c] = one > 0, is_lost[c] = (double)one > MAX_CLIPPED_SIGMAS * sigma;
        if (!is_fused || !is_lost[c]) continue;
        for (int64_t r = top[c] - reach; r <= top[c] + reach; r++) {
            int is_white = 1;
            for (int64_t k = 0; k < on->channels; k++) is_white &= level(on, within(r, on->rows), c, k) >= from;
            all += is_white;
        }
        is_lost[c] = (double)all > MAX_CLIPPED_SIGMAS * sigma;
    }
}
