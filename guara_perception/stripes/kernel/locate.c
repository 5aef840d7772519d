// Triangulation of stripes: intersection of camera rays with laser planes, and selection of the usable points.
#include "kernel.h"

// Columns processed at a time.
enum { CHUNK = 64 };

// Points (3, stripes, n) and standard deviations (stripes, n) of their heights. position, deviation: (stripes, n) rows of the
// stripes and their standard deviations [px]. rays: (terms, 2, n) coefficients, highest power first, of x and y of the ray in
// each column as polynomials of the row scaled to -1 ... 1; if terms is 0, (2, stripes, n) x and y of each ray. middle_row: row
// scaled to 0. planes: (stripes, 4) in the camera's frame. pose: (3, 4) of the camera. per_row: change of y per row. least_sine:
// of the angle between ray and plane; below it, points are NaN. Operations have the same order for every point, so that the
// rounding of a point does not depend on its neighbours.
void locate(const double *position, const double *deviation, int64_t stripes, int64_t n, const double *rays, int64_t terms,
    double middle_row, const double *planes, const double *pose, double per_row, double least_sine, double *points,
    double *sigma) {
    const double least = least_sine * least_sine, *across = pose + 4, *up = pose + 8;
    for (int64_t s = 0; s < stripes; s++)
        for (int64_t begin = 0; begin < n; begin += CHUNK) {
            const int64_t m = MIN(CHUNK, n - begin), at = s * n + begin;
            const double *plane = planes + 4 * s;
            double row[CHUNK], x[CHUNK], y[CHUNK];
            const double *first_x = terms ? rays + begin : rays + at, *first_y = terms ? first_x + n : first_x + stripes * n;
            for (int64_t i = 0; i < m; i++) row[i] = terms ? position[at + i] / middle_row - 1 : 1;
            for (int64_t i = 0; i < m; i++) x[i] = first_x[i] * row[i], y[i] = first_y[i] * row[i];
            for (int64_t t = 1; t < terms; t++) {
                const double *restrict by_x = rays + 2 * t * n + begin, *restrict by_y = by_x + n;
                if (t + 1 < terms) for (int64_t i = 0; i < m; i++) x[i] = (x[i] + by_x[i]) * row[i], y[i] = (y[i] + by_y[i]) * row[i];
                else for (int64_t i = 0; i < m; i++) x[i] += by_x[i], y[i] += by_y[i];
            }
            for (int64_t i = 0; i < m; i++) {
                const double along = plane[0] * x[i] + plane[1] * y[i] + plane[2], far = -plane[3] / along;
                const int is_grazing = along * along < least * (x[i] * x[i] + y[i] * y[i] + 1);
                const double depth = is_grazing | (far <= 0) ? (double)NAN : far;
                const double z = pose[8] * x[i] + pose[9] * y[i] + pose[10];
                const double slope = (up[1] - plane[1] / along * z) * depth * per_row * deviation[at + i];
                sigma[at + i] = fabs(slope);
                points[at + i] = (pose[0] * x[i] + pose[1] * y[i] + pose[2]) * depth + pose[3];
                points[stripes * n + at + i] = (across[0] * x[i] + across[1] * y[i] + across[2]) * depth + across[3];
                points[2 * stripes * n + at + i] = z * depth + up[3];
            }
        }
}

// Select the usable points of stripes (3, stripes, n). variance, strength: (stripes, n). mixed, beyond: statuses of returns at the
// end of a run, and below `lowest` or above `highest`. kept, single: points and variances as float, NaN where they cannot be used.
// status: (stripes, n), updated. is_mixed, is_beyond: (stripes, n) masks of both kinds of returns. work: 4 (n + 1) numbers of
// 8 bytes.
void settle_points(const double *points, const double *variance, const double *strength, int64_t stripes, int64_t n, double lowest,
    double highest, int64_t mixed, int64_t beyond, double *work, float *kept, float *single, uint8_t *status, uint8_t *is_mixed,
    uint8_t *is_beyond) {
    const int64_t all = stripes * n;
    for (int64_t s = 0; s < stripes; s++) {
        const int64_t at = s * n;
        const double *height = points + 2 * all + at;
        run_ends(height, strength + at, n, work, is_mixed + at);
        for (int64_t i = at; i < at + n; i++) {
            const double z = points[2 * all + i];
            is_beyond[i] = (z < lowest) | (z > highest);
            const int is_off = is_mixed[i] | is_beyond[i];
            status[i] = (uint8_t)(is_beyond[i] ? beyond : is_mixed[i] ? mixed : status[i]);
            single[i] = is_off | isnan(z) ? NAN : (float)variance[i];
            for (int64_t k = 0; k < 3; k++) kept[k * all + i] = is_off ? NAN : (float)points[k * all + i];
        }
    }
}
