// Plain C11 without Python.h, allocation or state: every function can run in any thread and uses memory of its caller.
// Compiled with -ffp-contract=off: fused multiply-adds round differently, and not every machine has them.
#ifndef GUARA_KERNEL_H
#define GUARA_KERNEL_H
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX(A, B) ((A) > (B) ? (A) : (B))
#define MIN(A, B) ((A) < (B) ? (A) : (B))
// Numbers processed together in loops of constant length, which compilers turn into vector instructions.
#define LANES 16

// Ratio of the standard deviation of a normal distribution to its median absolute deviation.
#define SIGMA_PER_DEVIATION 1.4826
// Rows summed before the centre of a stripe is measured; number of pixels in each sum over rows and columns; variance that
// the sum over rows adds to the width of the stripe [px^2].
#define ROW_MEAN_PX 3
#define SCALE 9
#define ROW_SMOOTHING_VARIANCE (2.0 / 3)
// Number of shifts from the top at which the derivative filters are evaluated, and largest number of taps of a filter.
#define SHIFTS 7
#define MOST_TAPS 64
// Share of full scale from which a sample counts as clipped, as in band.py.
#define CLIPPED 0.98
// A stripe wider than this is searched for in light smoothed to its width, and measured by window.c.
#define WIDE_SIGMA_PX 2.5

// Picture (rows, columns, channels) with samples of `size` bytes, 1 or 2, and any strides [bytes].
typedef struct {
    const char *data;
    int64_t rows, columns, channels, row_step, column_step, channel_step, size;
} Picture;

static inline int64_t within(int64_t row, int64_t rows) { return row < 0 ? 0 : row >= rows ? rows - 1 : row; }
static inline int32_t level(const Picture *p, int64_t row, int64_t column, int64_t channel) {
    const char *at = p->data + row * p->row_step + column * p->column_step + channel * p->channel_step;
    uint16_t wide;
    if (p->size == 1) return *(const uint8_t *)at;
    memcpy(&wide, at, 2);
    return wide;
}
static inline double full_scale(const Picture *p) { return p->size == 1 ? 255 : 65535; }
static inline int32_t clipped_from(const Picture *p) { return (int32_t)ceil(CLIPPED * full_scale(p)); }

// Judgement of a pair of pictures by some of its columns: channel of the laser, swapped pictures, change of brightness
// beside the stripe [grey levels], different exposures, clipped core.
typedef struct { double channel, is_swapped, change, is_uneven, is_core_clipped; } Judgement;

int64_t judge_size(int64_t rows, int64_t columns, int64_t channels);
void judge(const Picture *on, const Picture *off, float *work, Judgement *found);
int64_t find_size(int64_t rows, int64_t columns);
int64_t find_stripe(const Picture *on, const Picture *off, const Judgement *seen, int64_t is_fused, char *memory,
    void *smooth, int64_t *top, float *height, uint8_t *is_peak, uint8_t *is_clipped, uint8_t *is_unsure, double *mix,
    double *found);
double second_line(const Picture *on, const Picture *off, const float *position, double at_most, char *memory);
int64_t window_size(int64_t columns);
void measure_window(const Picture *on, const Picture *off, const double *mix, const double *gain, uint8_t *is_path,
    uint8_t *is_stripe, const uint8_t *is_core, int64_t factor, double ridge, float *work, int64_t *row, float *height,
    float *answers, double *found);
void responses(const void *light, int64_t is_float, int64_t rows, int64_t columns, const int64_t *top,
    const float *filters, int64_t taps, float *out);
int64_t derivative_filters(double sigma, float *filters);
double noise_gain(const float *filters, int64_t taps, int64_t smoothed_rows);
int64_t measure(const int64_t *top, const float *height, const uint8_t *is_peak, const uint8_t *is_clipped,
    const uint8_t *is_unsure, const float *responses, const Picture *background, int64_t channel, int64_t n, int64_t rows,
    int64_t first_row, double sigma, double noise, float *work, float *position, float *deviation, uint8_t *status,
    float *doubtful);
const void *samples_of(const Picture *p, int64_t row, int64_t channel, void *line);
void run_ends(const double *height, const double *strength, int64_t n, double *work, uint8_t *is_end);
void clipped_columns(const Picture *on, const int64_t *top, double sigma, int64_t channel, int64_t is_fused,
    uint8_t *is_clipped, uint8_t *is_lost);
float upper_median(float *v, int64_t n);
double robust_sigma(float *v, int64_t n);
float select_value(float *v, int64_t n, int64_t k);
double median(float *v, int64_t n);
#endif
