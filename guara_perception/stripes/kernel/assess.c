// Tests of the disc around each cell of a grid: slope, step, roughness, their flags, and the score.
#include "kernel.h"

// Columns summed together, so that their sums stay in the first-level cache.
enum { CHUNK = 64 };
// As in hazard.py.
enum { UNKNOWN = 0x3F, STEEP = 256, STEP = 512, DROP = 1024, ROUGH = 2048, UNCERTAIN = 8192 };
// Least score of a safe cell; only hazards and unknown cells have a score of 0.
#define LEAST_SAFE_SCORE 0.01
// Least determinant of the scatter matrix, relative to the product of its diagonal: known cells on a line determine no plane.
#define LEAST_DETERMINANT 1e-6

// Limits of slope [rad], rise, fall, roughness and sigma of a height [m]; number of sigmas added to each value but the last
// before it is tested.
typedef struct { double slope, step, drop, roughness, sigma, confidence; } Limits;

// Sums over the known cells of each disc: x and y are counted in cells from its centre, z is the height.
// beside: numbers of known cells on each of the four sides.
typedef struct {
    double n[CHUNK], x[CHUNK], y[CHUNK], xx[CHUNK], xy[CHUNK], yy[CHUNK], z[CHUNK], xz[CHUNK], yz[CHUNK], zz[CHUNK];
    double variance[CHUNK], lowest[CHUNK], highest[CHUNK], beside[5][CHUNK];
} Sums;

static double score(double value, double limit) { return MIN(fmax(1 - value / limit, 0), 1); }

// Planes of the rows that discs around one row of cells cover. An unknown cell adds 0 to each sum.
enum { KNOWN, HEIGHT, VARIANCE, LOW, HIGH, PLANES };

// Add the cell at offset (x, y) in the disc around each of n cells to the sums. planes: (PLANES, width), from the first such cell.
static void add(Sums *s, const double *restrict planes, int64_t width, int64_t n, double x, double y) {
    const double *one = planes, *height = one + HEIGHT * width, *variance = one + VARIANCE * width;
    const double *low = one + LOW * width, *high = one + HIGH * width, xx = x * x, xy = x * y, yy = y * y;
    double *beside_x = s->beside[x < 0 ? 0 : x > 0 ? 1 : 4], *beside_y = s->beside[y < 0 ? 2 : y > 0 ? 3 : 4];
    for (int64_t c = 0; c < n; c++) {
        const double k = one[c], z = height[c];
        s->n[c] += k, s->x[c] += x * k, s->y[c] += y * k, s->xx[c] += xx * k, s->xy[c] += xy * k, s->yy[c] += yy * k;
        s->z[c] += z, s->xz[c] += x * z, s->yz[c] += y * z, s->zz[c] += z * z, s->variance[c] += variance[c];
        s->lowest[c] = low[c] < s->lowest[c] ? low[c] : s->lowest[c];
        s->highest[c] = high[c] > s->highest[c] ? high[c] : s->highest[c];
    }
    for (int64_t c = 0; c < n; c++) beside_x[c] += one[c];
    for (int64_t c = 0; c < n; c++) beside_y[c] += one[c];
}

// Flags of a known cell by its disc. values: receives slope, step, roughness and score; slope and roughness are NaN if no plane
// can be fitted.
static uint16_t judge_cell(const Sums *s, int64_t c, const double *const *raster, int64_t at, double resolution,
    double least_known, const Limits *l, float *values[4]) {
    const double n = s->n[c], xx = s->xx[c] - s->x[c] * s->x[c] / n, xy = s->xy[c] - s->x[c] * s->y[c] / n;
    const double yy = s->yy[c] - s->y[c] * s->y[c] / n, determinant = xx * yy - xy * xy;
    double slope = NAN, roughness = NAN, slope_sigma = NAN, roughness_sigma = NAN;
    // With nothing known on one side, the plane would extrapolate.
    const int is_around = s->beside[0][c] > 0 && s->beside[1][c] > 0 && s->beside[2][c] > 0 && s->beside[3][c] > 0;
    if (is_around && n >= least_known && determinant > LEAST_DETERMINANT * xx * yy) {
        const double xz = s->xz[c] - s->x[c] * s->z[c] / n, yz = s->yz[c] - s->y[c] * s->z[c] / n;
        const double a = (yy * xz - xy * yz) / determinant, b = (xx * yz - xy * xz) / determinant;
        const double steepness = sqrt(a * a + b * b) / resolution, stretch = 1 + steepness * steepness;
        // Residuals along z, as distances from the plane.
        const double residual = MAX(s->zz[c] - s->z[c] * s->z[c] / n - a * xz - b * yz, 0) / stretch;
        const double freedom = MAX(n - 1, 1), mean_variance = s->variance[c] / n;
        slope = atan(steepness), roughness = sqrt(residual / freedom);
        slope_sigma = sqrt(mean_variance * (xx + yy) / (2 * determinant)) / resolution / stretch;
        roughness_sigma = sqrt(mean_variance / (2 * freedom));
    }
    const double sigma = sqrt(raster[1][at]), unsure = l->confidence * sqrt(2) * sigma;
    double rise = s->highest[c] - raster[2][at], fall = raster[3][at] - s->lowest[c];
    values[0][at] = (float)slope, values[1][at] = (float)MAX(rise, fall), values[2][at] = (float)roughness;
    slope += l->confidence * hypot(slope_sigma, raster[4][at]), roughness += l->confidence * roughness_sigma;
    rise += unsure, fall += unsure;
    values[3][at] = (float)MAX(
        score(slope, l->slope) * score(rise, l->step) * (score(fall, l->drop) * score(roughness, l->roughness)), LEAST_SAFE_SCORE);
    return (uint16_t)((slope > l->slope) * STEEP | (rise > l->step) * STEP | (fall > l->drop) * DROP
        | (roughness > l->roughness) * ROUGH | (sigma > l->sigma) * UNCERTAIN);
}

// Test the discs around the known cells in columns first ... end - 1 of a grid (rows, columns). raster: heights, variances, lowest
// and highest samples [m, m^2], heights NaN where unknown, and sigmas of the slope that all cells of a disc share [rad], (5, rows,
// columns). disc: (side, side) mask of the disc. least_known: least number of known cells for a plane. work: (side, PLANES,
// columns + side).
// layers: (4, rows, columns) receives slope, step, roughness and score. hazard: has a cause in each unknown cell, and
// receives the flags of the known ones.
void test_discs(const double *const *raster, int64_t rows, int64_t columns, int64_t first, int64_t end, const uint8_t *disc,
    int64_t side, double resolution, double least_known, const Limits *limits, double *work, float *layers, uint16_t *hazard) {
    const int64_t half = side / 2, size = rows * columns, width = columns + side;
    float *values[4] = {layers, layers + size, layers + 2 * size, layers + 3 * size};
    for (int64_t soon = -half; soon < rows + half; soon++) {
        double *planes = work + (soon + half) % side * PLANES * width;
        for (int64_t c = first - half; c < end + half; c++) {
            const int64_t at = soon * columns + c;
            const int is_known = soon >= 0 && soon < rows && c >= 0 && c < columns && isfinite(raster[0][at]);
            planes[c + half] = is_known;
            for (int k = HEIGHT; k < PLANES; k++)
                planes[k * width + c + half] = is_known ? raster[k - 1][at] : k == LOW ? INFINITY : k == HIGH ? -INFINITY : 0;
        }
        const int64_t r = soon - half;
        for (int64_t begin = first; r >= 0 && begin < end; begin += CHUNK) {
            const int64_t n = MIN(end - begin, CHUNK);
            int64_t known = 0;
            for (int64_t c = 0; c < n; c++) known += !(hazard[r * columns + begin + c] & UNKNOWN);
            Sums s;
            memset(&s, 0, sizeof s);
            for (int64_t c = 0; c < n; c++) s.lowest[c] = INFINITY, s.highest[c] = -INFINITY;
            for (int64_t y = 0; known && y < side; y++)
                for (int64_t x = 0; x < side; x++)
                    if (disc[y * side + x])
                        add(&s, work + (r + y) % side * PLANES * width + begin + x, width, n, (double)(x - half), (double)(y - half));
            for (int64_t c = 0, at = r * columns + begin; c < n; c++, at++)
                if (hazard[at] & UNKNOWN) values[0][at] = values[1][at] = values[2][at] = NAN, values[3][at] = 0;
                else {
                    hazard[at] |= judge_cell(&s, c, raster, at, resolution, least_known, limits, values);
                    if (hazard[at]) values[3][at] = 0;
                }
        }
    }
}

// Squared distances of the cells of a row to the nearest face of a cell (distance transform by lower envelopes: Felzenszwalb,
// Huttenlocher: Distance transforms of sampled functions, Theory of Computing 8, 2012). across: (n,) squared distances along the
// columns to such a face, 0 in the cells themselves, FAR if there is none. Results where across = 0 are not needed. The face
// between columns j - 1 and j is at j - 1/2. work: (3, n + 1).
#define FAR 1e18
static void nearest(const double *across, int64_t n, double *work, double *found) {
    // The parabola of face lowest[k] is the lowest from from[k] on; at[j] is its height at the face.
    double *from = work, *lowest = work + n + 1, *at = work + 2 * (n + 1);
    int64_t k = -1;
    for (int64_t j = 0; j <= n; j++) {
        double meet = -INFINITY;
        at[j] = MIN(j ? across[j - 1] : FAR, j < n ? across[j] : FAR);
        // Inside a run of zeros, no face is the nearest to a cell outside.
        if (at[j] >= FAR || (j && j < n && across[j - 1] == 0 && across[j] == 0)) continue;
        for (; k >= 0; k--) {
            const double other = lowest[k], apart = (double)j - other;
            meet = (at[j] - at[(int64_t)other]) / (2 * apart) + ((double)(j - 1) + other) / 2;
            if (meet > from[k]) break;
            meet = -INFINITY;
        }
        from[++k] = meet, lowest[k] = (double)j;
    }
    for (int64_t c = 0, j = 0; c < n; c++) {
        while (j < k && from[j + 1] < (double)c) j++;
        const double apart = k < 0 ? 0 : (double)c + 0.5 - lowest[j];
        found[c] = k < 0 ? FAR : MIN(apart * apart + at[(int64_t)lowest[j]], across[c]);
    }
}

#define IS_GOOD(R, C) ((hazard[(R) * columns + (C)] & flags) == 0)
// Signed clearance of every cell [m]: distance of its centre to the nearest cell with any of `flags` or to the border of the
// grid; in a cell with such a flag, minus the distance to the nearest cell without. work: 4 * (columns + 1), and (rows, columns).
void clearance(const uint16_t *hazard, int64_t rows, int64_t columns, int64_t flags, double resolution, double *work, float *out) {
    double *found = work + 3 * (columns + 1), *across = found + columns + 1;
    for (int is_bad = 0; is_bad < 2; is_bad++) { // First distances of good cells to bad ones, then the reverse.
        for (int64_t r = 0; r < rows; r++)
            for (int64_t c = 0; c < columns; c++)
                across[r * columns + c] = IS_GOOD(r, c) == is_bad ? 0 : r ? across[(r - 1) * columns + c] + 1 : FAR;
        for (int64_t r = rows - 2; r >= 0; r--)
            for (int64_t c = 0; c < columns; c++)
                across[r * columns + c] = MIN(across[r * columns + c], across[(r + 1) * columns + c] + 1);
        for (int64_t r = 0; r < rows; r++) {
            double *own = across + r * columns;
            for (int64_t c = 0; c < columns; c++) own[c] = own[c] < FAR ? (own[c] - 0.5) * (own[c] - 0.5) * (own[c] > 0) : FAR;
            nearest(own, columns, work, found);
            for (int64_t c = 0; c < columns; c++) {
                if (IS_GOOD(r, c) == is_bad) continue;
                const double border = (double)MIN(MIN(r, rows - 1 - r), MIN(c, columns - 1 - c)) + 0.5;
                const double other = found[c] < FAR ? sqrt(found[c]) : border;
                out[r * columns + c] = (float)((is_bad ? -other : MIN(other, border)) * resolution);
            }
        }
    }
}
