// Plain C11 without Python.h, allocation or state: every function may run in any thread, in memory of its caller.
// Compiled with -ffp-contract=off: a fused multiply-add would round otherwise on one machine than on another.
#ifndef GUARA_KERNEL_H
#define GUARA_KERNEL_H
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX(A, B) ((A) > (B) ? (A) : (B))
#define MIN(A, B) ((A) < (B) ? (A) : (B))
// Numbers that are handled side by side, so that compilers use vector instructions.
#define LANES 16

// Makes the median of absolute deviations the standard deviation of a normal distribution.
#define SIGMA_PER_DEVIATION 1.4826
// Share of full scale from which a sample counts as clipped, as in band.py.
#define CLIPPED 0.98

// A picture (rows, columns, channels) as a camera gives it: samples of 1 or 2 bytes, anywhere in memory [bytes].
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

void clipped_columns(const Picture *on, const int64_t *top, double sigma, int64_t channel, int64_t is_fused,
    uint8_t *is_clipped, uint8_t *is_lost);
float upper_median(float *v, int64_t n);
double robust_sigma(float *v, int64_t n);
float select_value(float *v, int64_t n, int64_t k);
double median(float *v, int64_t n);
#endif
