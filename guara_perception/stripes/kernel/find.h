// Declarations shared by the files that search for a stripe by the highest peaks of its band.
#ifndef GUARA_FIND_H
#define GUARA_FIND_H
#include "kernel.h"

// Sums instead of means over three columns and three rows keep the fractions of a grey level in whole numbers.
#define COLUMN_MEAN_PX 3
// Rows and columns from one sample of the noise to the next.
#define SAMPLE_ROWS 8
#define SAMPLE_COLUMNS 24
// Rows of a block: a second peak is searched for outside the block of the highest and its two neighbours. CHUNK: columns
// processed at a time.
#define BLOCK_ROWS 8
enum { CHUNK = 64 };
// Rows binned to one to search for a wide stripe, and largest number of bins that are smoothed on each side.
#define BIN_ROWS 4
#define MOST_BINS 8
// At 5 sigmas, noise exceeds the threshold in 0.1 % of the columns.
#define THRESHOLD_SIGMAS 5.0
#define MOST_CANDIDATES 4

// Costs of the candidates of a column, the last of which is no peak: their own, and those of the cheapest path up to each
// (its own included) and after it.
typedef struct { double own[MOST_CANDIDATES + 1], forward[MOST_CANDIDATES + 1], backward[MOST_CANDIDATES + 1]; } Costs;

// Light of a band: int16_t if it is of one channel of 8 bits, float otherwise. step: rows of the pictures per row.
typedef struct {
    const Picture *on, *off;
    int64_t rows, columns, channel, is_fused, is_float, step;
    float mix[3], offset; // light = weighted sum of the channels - offset
    int32_t highest;      // highest level of the channel in the rows computed so far; INT32_MAX if fused
} Light;

// Work memory: lines (columns,) of samples, light, sums and blocks; samples of a statistic; paths through candidates.
typedef struct {
    char *lines, *light, *ring, *blocks;
    float *samples, *values, *heights, *bins, *wide;
    int64_t *indices, *candidates;
    Costs *costs;
} Work;

static inline float value(const void *light, int64_t is_float, int64_t at) {
    return is_float ? ((const float *)light)[at] : (float)((const int16_t *)light)[at];
}

// Middle row of a bin.
static inline int64_t row_of_bin(int64_t bin, int64_t rows) { return within(BIN_ROWS * bin + BIN_ROWS / 2, rows); }

void mix_channels(Light *light, Work *work);
void light_of_row(Light *light, int64_t row, char *lines, void *out);
int64_t smooth_light(Light *light, Work *work, void *smooth);
void wide_light(const Light *light, Work *work, const void *smooth, double sigma, Light *wide);
void find_peaks(const Light *light, Work *work, const void *searched, int64_t *top, float *height, float *second);
void find_rises(const Light *light, Work *work, const int64_t *top, float rise, float *second);
double stripe_sigma(const void *smooth, int64_t is_float, int64_t rows, int64_t columns, const int64_t *top,
    const float *height, const int64_t *some, int64_t n, double smoothed, float *work);
int is_doubtful(const Light *light, const int64_t *top, const float *height, const float *second, double threshold,
    double noise, int is_uneven);
void choose(const Light *light, Work *work, const void *searched, int64_t *top, float *height, const float *second,
    double threshold, double sigma, uint8_t *is_unsure);
#endif
