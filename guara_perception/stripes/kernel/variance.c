// Variance of heights due to the covariance of the calibration, point by point, so that rounding does not depend on others.
#include "kernel.h"

enum { TERMS = 10 };

static double quadratic_form(const double *vector, const double *matrix, int64_t n) {
    double sum = 0;
    for (int64_t i = 0; i < n; i++) {
        double row = 0;
        for (int64_t k = 0; k < n; k++) row += matrix[i * n + k] * vector[k];
        sum += vector[i] * row;
    }
    return sum;
}

// Variances (n,) of the heights of points (3, n). stripe: (n,) index of each point's plane, (4,) in the camera frame, and of
// that plane's covariance (4, 4). camera, base: (4, 4) poses of the camera in the frame of the points and in the base frame.
// origin, field: centre (3,) in the base frame and covariance (TERMS, TERMS) of the height polynomial, whose terms are those of
// height_sigma.py. A baseline below `least` gives NaN.
void height_variance(const double *points, const int64_t *stripe, int64_t n, const double *planes, const double *covariances,
    const double *camera, const double *base, const double *origin, const double *field, double least, double *variance) {
    for (int64_t i = 0; i < n; i++) {
        const double *plane = planes + 4 * stripe[i];
        double at[4] = {0, 0, 0, 1}, offset[3];
        for (int k = 0; k < 3; k++)
            for (int j = 0; j < 3; j++) at[k] += camera[4 * j + k] * (points[j * n + i] - camera[4 * j + 3]);
        // Moving X along its ray changes n . X + d in proportion to n . X, and the height in proportion to r_z . X,
        // where r_z is the last row of the rotation.
        const double baseline = plane[0] * at[0] + plane[1] * at[1] + plane[2] * at[2];
        const double rise = camera[8] * at[0] + camera[9] * at[1] + camera[10] * at[2];
        const double gain = fabs(baseline) < least ? NAN : rise / baseline;
        for (int k = 0; k < 3; k++)
            offset[k] = base[4 * k] * at[0] + base[4 * k + 1] * at[1] + base[4 * k + 2] * at[2] + base[4 * k + 3] - origin[k];
        const double x = offset[0], y = offset[1], z = offset[2];
        const double terms[TERMS] = {1, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z};
        variance[i] = gain * gain * quadratic_form(at, covariances + 16 * stripe[i], 4) + quadratic_form(terms, field, TERMS);
    }
}

// Index (n,) of the plane, of planes (s, 4), nearest to each point (3, n); the first of several at the same distance.
// distance: (s,) work memory.
void nearest_planes(const double *points, int64_t n, const double *planes, int64_t s, float *restrict distance,
    int64_t *row) {
    for (int64_t i = 0; i < n; i++) {
        const double x = points[i], y = points[n + i], z = points[2 * n + i];
        for (int64_t k = 0; k < s; k++)
            distance[k] = (float)fabs(planes[4 * k] * x + planes[4 * k + 1] * y + planes[4 * k + 2] * z + planes[4 * k + 3]);
        // Find the least distance in lanes, then the first plane that has it: a search plane by plane takes three times as long.
        float lanes[LANES], least = INFINITY;
        int64_t best = 0, k = 0;
        for (int j = 0; j < LANES; j++) lanes[j] = INFINITY;
        for (; k + LANES <= s; k += LANES) for (int j = 0; j < LANES; j++) lanes[j] = MIN(distance[k + j], lanes[j]);
        for (; k < s; k++) least = MIN(distance[k], least);
        for (int j = 0; j < LANES; j++) least = MIN(lanes[j], least);
        while (best < s && distance[best] > least) best++;
        row[i] = best < s ? best : 0;
    }
}
