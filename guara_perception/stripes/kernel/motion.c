// Motion of the camera, from the background of its pictures: small pictures, and corners followed in them.
#include "kernel.h"

// Small picture (rows / factor, columns / factor) of a channel: means of factor x factor pixels, times a gain. line: (columns,)
// samples of 2 bytes. sums: (2, columns).
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

// Half side of the compared square around a corner, largest motion of a corner, and half side of the square that this requires
// [px of the small picture].
enum { HALF = 6, FAR = 1, REACH = HALF + FAR + 1, SIDE = 2 * REACH + 1, WINDOW = 2 * HALF + 1 };
// Length of a square, including floats that are read beyond its last row, LANES at a time.
enum { SQUARE = SIDE * SIDE + LANES };
// Largest number of steps, length of the last step [px], and largest residual as a fraction of the contrast of the square.
enum { MOST_STEPS = 10 };
#define LEAST_STEP 0.01f
#define MOST_LEFT 0.2f

// Square of the small picture around (x, y), rounded as by `shrink`.
enum { MOST_STEP = 4, MOST_FACTOR = 8, MOST_BYTES = SIDE * MOST_FACTOR * MOST_STEP };
static void small_square(const Picture *p, int64_t channel, int64_t factor, double gain, int64_t x, int64_t y, float *out) {
    const float share = (float)(gain / (double)(factor * factor));
    const int64_t step = p->column_step, bytes = (SIDE * factor - 1) * step + 1, first = (x - REACH) * factor;
    const int is_close = p->size == 1 && step > 0 && step <= MOST_STEP && factor <= MOST_FACTOR;
    for (int64_t r = 0; r < SIDE; r++) {
        int32_t sum[SIDE] = {0};
        uint16_t whole[MOST_BYTES];
        if (is_close) memset(whole, 0, (size_t)bytes * sizeof *whole);
        for (int64_t i = 0; i < factor; i++) {
            const int64_t row = (y - REACH + r) * factor + i;
            const uint8_t *restrict from = (const uint8_t *)p->data + row * p->row_step + channel * p->channel_step + first * step;
            // Sum all channels: contiguous sums are the fastest.
            if (is_close) for (int64_t k = 0; k < bytes; k++) whole[k] = (uint16_t)(whole[k] + from[k]);
            else for (int64_t c = 0; c < SIDE * factor; c++) sum[c / factor] += level(p, row, first + c, channel);
        }
        if (is_close)
            for (int64_t c = 0; c < SIDE; c++)
                for (int64_t k = 0; k < factor; k++) sum[c] += whole[(c * factor + k) * step];
        for (int64_t c = 0; c < SIDE; c++) out[r * SIDE + c] = (float)(uint8_t)MIN((float)sum[c] * share + 0.5f, 255.0f);
    }
}

static float sum_of(const float *lanes) {
    float sum = 0;
    for (int k = 0; k < WINDOW; k++) sum += lanes[k];
    return sum;
}

// Follow one corner by the method of Lucas and Kanade, without a pyramid. Returns 0 if it is lost. own: reference at the corner.
static int follow_corner(const uint8_t *own, int64_t columns, const float *square, float *moved) {
    float light[WINDOW][LANES], along_x[WINDOW][LANES], along_y[WINDOW][LANES], sums[5][LANES] = {{0}};
    float dx = 0, dy = 0;
    for (int64_t r = 0; r < WINDOW; r++)
        // Lanes beyond the window read the pixels that follow in the reference; their weight is 0.
        for (int64_t k = 0; k < LANES; k++) {
            const uint8_t *at = own + (r - HALF) * columns + k - HALF, *up = at - columns, *down = at + columns;
            const float counts = k < WINDOW, level = counts * (float)*at;
            const float x = counts * (float)(3 * (up[1] - up[-1] + down[1] - down[-1]) + 10 * (at[1] - at[-1])) / 32;
            const float y = counts * (float)(3 * (down[-1] - up[-1] + down[1] - up[1]) + 10 * (down[0] - up[0])) / 32;
            along_x[r][k] = x, along_y[r][k] = y, light[r][k] = level;
            sums[0][k] += x * x, sums[1][k] += x * y, sums[2][k] += y * y, sums[3][k] += level, sums[4][k] += level * level;
        }
    const float xx = sum_of(sums[0]), xy = sum_of(sums[1]), yy = sum_of(sums[2]), mean = sum_of(sums[3]) / (WINDOW * WINDOW);
    const float contrast = sum_of(sums[4]) - mean * mean * WINDOW * WINDOW;
    const float determinant = xx * yy - xy * xy;
    if (!(determinant > 0)) return 0;
    for (int64_t step = 0; step < MOST_STEPS; step++) {
        const int64_t left = (int64_t)floorf(dx), top = (int64_t)floorf(dy);
        const float u = dx - (float)left, v = dy - (float)top, a = (1 - u) * (1 - v), b = u * (1 - v), c = (1 - u) * v, d = u * v;
        float by_x[LANES] = {0}, by_y[LANES] = {0}, rest[LANES] = {0};
        for (int64_t r = 0; r < WINDOW; r++) {
            const float *at = square + (r + REACH - HALF + top) * SIDE + REACH - HALF + left, *below = at + SIDE;
            for (int64_t k = 0; k < LANES; k++) {
                const float less = light[r][k] - (a * at[k] + b * at[k + 1] + c * below[k] + d * below[k + 1]);
                by_x[k] += less * along_x[r][k], by_y[k] += less * along_y[r][k], rest[k] += less * less;
            }
        }
        const float x = sum_of(by_x), y = sum_of(by_y);
        const float step_x = (yy * x - xy * y) / determinant, step_y = (xx * y - xy * x) / determinant;
        dx += step_x, dy += step_y;
        if (!(fabsf(dx) < FAR && fabsf(dy) < FAR)) return 0;
        moved[0] = dx, moved[1] = dy;
        if (step_x * step_x + step_y * step_y < LEAST_STEP * LEAST_STEP) return sum_of(rest) <= MOST_LEFT * contrast;
    }
    return 0;
}

// Motion (n, 2) of some corners of a small reference (rows, columns) in a picture [px], less than FAR in each direction, and
// change (n, 2) of their rays; NaN if a corner is lost. Only the surroundings of the corners are read. used: (n,) indices of the
// corners. turn: (corners, 2, 2) change of a ray per pixel.
void follow_corners(const Picture *p, int64_t channel, int64_t factor, double gain, const uint8_t *reference,
    const double *corners, const double *turn, const int64_t *used, int64_t n, float *moved, double *flow) {
    const int64_t rows = p->rows / factor, columns = p->columns / factor;
    float square[SQUARE] = {0};
    for (int64_t i = 0; i < n; i++) {
        const double *corner = corners + 2 * used[i], *by = turn + 4 * used[i];
        const int64_t x = llrint(corner[0]), y = llrint(corner[1]);
        int found = x >= REACH && y >= REACH && x < columns - REACH && y < rows - REACH;
        if (found) {
            small_square(p, channel, factor, gain, x, y, square);
            found = follow_corner(reference + y * columns + x, columns, square, moved + 2 * i);
        }
        if (!found) moved[2 * i] = moved[2 * i + 1] = NAN;
        const double along = (double)moved[2 * i], down = (double)moved[2 * i + 1];
        flow[2 * i] = by[0] * along + by[1] * down, flow[2 * i + 1] = by[2] * along + by[3] * down;
    }
}

// Inverse of a symmetric positive definite matrix by Gauss-Jordan elimination. Returns 0 if the matrix is not positive definite.
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

// Fit the motion (6,) of the camera to flows (n, 2), and compute the rise of some points due to it. rows: (corners, 2, 6) flow per
// unit of each component of the motion. Least squares are repeated with Tukey's weights, so that objects that move by themselves
// have no effect. used: (n,) indices of the corners; flows of NaN are ignored. moved: (n, 2) motion of the corners [px].
// by_motion: (points, 6) rise per unit of each component. work: 2 * n numbers of 8 bytes. found: receives rises and their standard
// deviations (2, points) due to the noise of one picture, and the median motion of the corners [px]. Returns 0 if fewer flows than
// `least` or `least_share` are known or agree, or the condition number of the equations reaches `most_condition`.
int64_t fit_motion(const double *rows, const double *wanted, const float *moved, const int64_t *used, int64_t n, int64_t least,
    double least_share, int64_t steps, double least_noise, double most_condition, const double *by_motion, int64_t points,
    double *work, double *found) {
    int64_t *known = (int64_t *)work, count = 0, agree = 0;
    float *weight = (float *)(known + n), *left = weight + n;
    double inverse[DEGREES * DEGREES] = {0}, motion[DEGREES] = {0}, noise = 0;
    for (int64_t i = 0; i < n; i++) known[count] = i, count += isfinite(wanted[2 * i]) != 0;
    if (count < least || (double)count < least_share * (double)n) return 0;
    for (int64_t i = 0; i < count; i++) weight[i] = 1;
    for (int64_t step = 0; step < steps; step++) {
        double normal[DEGREES * DEGREES] = {0}, right[DEGREES] = {0}, size = 0, inverse_size = 0;
        for (int64_t i = 0; i < 2 * count; i++) {
            const double *row = rows + (2 * used[known[i / 2]] + i % 2) * DEGREES, flow = wanted[2 * known[i / 2] + i % 2];
            for (int j = 0; j < DEGREES; j++) {
                const double own = (double)weight[i / 2] * row[j];
                right[j] += own * flow;
                for (int k = 0; k < DEGREES; k++) normal[j * DEGREES + k] += own * row[k];
            }
        }
        if (!invert(normal, inverse)) return 0;
        for (int k = 0; k < DEGREES * DEGREES; k++) size += normal[k] * normal[k], inverse_size += inverse[k] * inverse[k];
        if (!(sqrt(size * inverse_size) < most_condition)) return 0;
        for (int j = 0; j < DEGREES; j++) {
            motion[j] = 0;
            for (int k = 0; k < DEGREES; k++) motion[j] += inverse[j * DEGREES + k] * right[k];
        }
        for (int64_t i = 0; i < count; i++) {
            const double *row = rows + 2 * used[known[i]] * DEGREES;
            double off[2] = {wanted[2 * known[i]], wanted[2 * known[i] + 1]};
            for (int k = 0; k < DEGREES; k++) off[0] -= row[k] * motion[k], off[1] -= row[DEGREES + k] * motion[k];
            left[i] = weight[i] = (float)sqrt(off[0] * off[0] + off[1] * off[1]);
        }
        noise = MAX(median(weight, count), least_noise), agree = 0;
        for (int64_t i = 0; i < count; i++) {
            const float far = left[i] / (float)(6 * noise), rest = MAX(1 - far * far, 0);
            weight[i] = rest * rest, agree += weight[i] > 0;
        }
    }
    if (agree < least || (double)agree < least_share * (double)count) return 0;
    for (int64_t p = 0; p < points; p++) {
        const double *own = by_motion + p * DEGREES;
        double rise = 0, square = 0;
        for (int j = 0; j < DEGREES; j++) {
            rise += own[j] * motion[j];
            for (int k = 0; k < DEGREES; k++) square += own[j] * inverse[j * DEGREES + k] * own[k];
        }
        // Half of the variance of a difference between two pictures comes from each.
        found[p] = rise, found[points + p] = noise * sqrt(square / 2);
    }
    for (int64_t i = 0; i < count; i++) {
        const float *own = moved + 2 * known[i];
        left[i] = sqrtf(own[0] * own[0] + own[1] * own[1]);
    }
    found[2 * points] = median(left, count);
    return 1;
}

// Motion as from `fit_motion`, from at most `most` corners outside rows first ... end - 1 of the small picture, evenly selected.
// memory: 6 * most numbers of 8 bytes. Returns -1 if there are fewer than `least` such corners.
int64_t look_at_corners(const Picture *p, int64_t channel, int64_t factor, double gain, const uint8_t *reference,
    const double *corners, const double *turn, const double *rows, int64_t n, int64_t most, double first, double end, int64_t least,
    double least_share, int64_t steps, double least_noise, double most_condition, const double *by_motion, int64_t points,
    double *memory, double *found) {
    int64_t *used = (int64_t *)memory, usable = 0, number = 0, taken = 0;
    double *flow = memory + most, *work = flow + 2 * most;
    float *moved = (float *)(work + 2 * most);
    for (int64_t i = 0; i < n; i++) usable += corners[2 * i + 1] < first || corners[2 * i + 1] >= end;
    if (usable < least) return -1;
    const int64_t count = MIN(usable, most);
    for (int64_t i = 0; i < n; i++) {
        if (!(corners[2 * i + 1] < first || corners[2 * i + 1] >= end)) continue;
        if (taken < count && number++ == taken * usable / count) used[taken++] = i;
    }
    follow_corners(p, channel, factor, gain, reference, corners, turn, used, count, moved, flow);
    return fit_motion(rows, flow, moved, used, count, least, least_share, steps, least_noise, most_condition, by_motion, points,
        work, found);
}
