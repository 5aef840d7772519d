// The background of pictures: a small one of each, and the motion of the camera by what moved in it.
#include "kernel.h"

// Levels (rows / factor, columns / factor) of a channel: means of factor x factor pixels times a gain. line, sums: of a row
// (columns,) of samples of 2 bytes, and two of uint32_t.
void shrink(const Picture *p, int64_t channel, int64_t factor, double gain, void *line, uint32_t *sums, uint8_t *out) {
    const int64_t rows = p->rows / factor, columns = p->columns / factor;
    const float share = (float)(gain / (double)(factor * factor));
    for (int64_t r = 0; r < rows; r++) {
        uint32_t *restrict sum = sums;
        for (int64_t i = 0; i < factor; i++) {
            const void *samples = samples_of(p, r * factor + i, channel, line);
            const uint8_t *restrict bytes = samples;
            const uint16_t *restrict words = samples;
            if (p->size == 1) for (int64_t c = 0; c < p->columns; c++) sum[c] = (i ? sum[c] : 0) + bytes[c];
            else for (int64_t c = 0; c < p->columns; c++) sum[c] = (i ? sum[c] : 0) + words[c];
        }
        int64_t left = factor, n = p->columns;
        for (; left % 2 == 0; left /= 2, n /= 2) {
            const uint32_t *restrict from = sum;
            uint32_t *restrict to = sums + (sum == sums ? p->columns : 0);
            for (int64_t c = 0; c < n / 2; c++) to[c] = from[2 * c] + from[2 * c + 1];
            sum = to;
        }
        for (int64_t c = 0; c < columns; c++) {
            uint32_t total = sum[c * left];
            for (int64_t i = 1; i < left; i++) total += sum[c * left + i];
            out[r * columns + c] = (uint8_t)MIN((float)total * share + 0.5f, 255.0f);
        }
    }
}

// Inverse of a symmetric positive definite matrix by Gauss and Jordan; 0 where it is none.
enum { DEGREES = 6 };
static int invert(const double *matrix, double *inverse) {
    double a[DEGREES][2 * DEGREES] = {0};
    for (int i = 0; i < DEGREES; i++) {
        for (int k = 0; k < DEGREES; k++) a[i][k] = matrix[i * DEGREES + k];
        a[i][DEGREES + i] = 1;
    }
    for (int i = 0; i < DEGREES; i++) {
        if (!(a[i][i] > 0)) return 0;
        const double pivot = 1 / a[i][i];
        for (int k = 0; k < 2 * DEGREES; k++) a[i][k] *= pivot;
        for (int j = 0; j < DEGREES; j++) {
            const double factor = j == i ? 0 : a[j][i];
            for (int k = 0; k < 2 * DEGREES; k++) a[j][k] -= factor * a[i][k];
        }
    }
    for (int i = 0; i < DEGREES; i++) memcpy(inverse + i * DEGREES, a[i] + DEGREES, DEGREES * sizeof(double));
    return 1;
}

// Motion (6,) that explains flows (n, 2) by their rows (n, 2, 6): steps of least squares with Tukey's weights, so that what
// moves by itself counts nothing. found: the motion, the inverse of its normal equations (6, 6), the noise, and the number
// of flows that agree. 0 where the equations' condition exceeds the given one. work: (2, n).
int64_t fit_motion(const double *rows, const double *wanted, int64_t n, int64_t steps, double least_noise,
    double most_condition, float *work, double *found) {
    double *inverse = found + DEGREES, *noise = inverse + DEGREES * DEGREES, *agree = noise + 1;
    float *weight = work, *left = work + n;
    for (int64_t i = 0; i < n; i++) weight[i] = 1;
    for (int64_t step = 0; step < steps; step++) {
        double normal[DEGREES * DEGREES] = {0}, right[DEGREES] = {0}, size = 0, inverse_size = 0;
        for (int64_t i = 0; i < 2 * n; i++)
            for (int j = 0; j < DEGREES; j++) {
                const double own = (double)weight[i / 2] * rows[i * DEGREES + j];
                right[j] += own * wanted[i];
                for (int k = 0; k < DEGREES; k++) normal[j * DEGREES + k] += own * rows[i * DEGREES + k];
            }
        if (!invert(normal, inverse)) return 0;
        for (int k = 0; k < DEGREES * DEGREES; k++) size += normal[k] * normal[k], inverse_size += inverse[k] * inverse[k];
        if (!(sqrt(size * inverse_size) < most_condition)) return 0;
        for (int j = 0; j < DEGREES; j++) {
            found[j] = 0;
            for (int k = 0; k < DEGREES; k++) found[j] += inverse[j * DEGREES + k] * right[k];
        }
        for (int64_t i = 0; i < n; i++) {
            double off[2] = {wanted[2 * i], wanted[2 * i + 1]};
            for (int k = 0; k < DEGREES; k++)
                off[0] -= rows[2 * i * DEGREES + k] * found[k], off[1] -= rows[(2 * i + 1) * DEGREES + k] * found[k];
            left[i] = weight[i] = (float)sqrt(off[0] * off[0] + off[1] * off[1]);
        }
        *noise = MAX(median(weight, n), least_noise), *agree = 0;
        for (int64_t i = 0; i < n; i++) {
            const float far = left[i] / (float)(6 * *noise), rest = MAX(1 - far * far, 0);
            weight[i] = rest * rest, *agree += weight[i] > 0;
        }
    }
    return 1;
}
