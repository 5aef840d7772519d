// Colour of the laser from the picture itself (Fisher's linear discriminant), as in laser_colour.py.
#include "any_light.h"

// ---- laser_colour: covariance, weights, colours --------------------------------------------------------------------------
static inline int is_near(const Path *p, int r, int c, int reach) { return p->is_stripe[c] && abs(r - p->row[c]) <= reach; }

void covariance(const View *v, const Path *near, int reach, double scene[CHANNELS][CHANNELS]) {
    // Of every second row and fifth column; v->detail has the columns wanted, or is of every column of a thinned view.
    const int apart = v->detail_step == 1 ? 5 : 1;
    double sum[CHANNELS][CHANNELS] = {{0}}, trace = 0;
    int64_t used = 0;
    for (int r = 0; r < v->rows; r += 2) {
        const float *x[CHANNELS];
        float part[6] = {0};
        for (int k = 0; k < CHANNELS; k++) x[k] = v->detail + ((int64_t)k * v->rows + r) * v->detail_width;
        for (int c = 0; c < v->detail_width; c += apart) {
            if (is_near(near, r, c * v->detail_step, reach)) continue;
            const float a = x[0][c], b = x[1][c], d = x[2][c];
            part[0] += a * a, part[1] += a * b, part[2] += a * d, part[3] += b * b, part[4] += b * d, part[5] += d * d;
            used++;
        }
        sum[0][0] += part[0], sum[0][1] += part[1], sum[0][2] += part[2];
        sum[1][1] += part[3], sum[1][2] += part[4], sum[2][2] += part[5];
    }
    sum[1][0] = sum[0][1], sum[2][0] = sum[0][2], sum[2][1] = sum[1][2];
    for (int i = 0; i < CHANNELS; i++) for (int j = 0; j < CHANNELS; j++) scene[i][j] = sum[i][j] / (double)MAX(used, 1);
    for (int i = 0; i < CHANNELS; i++) trace += scene[i][i];
    for (int i = 0; i < CHANNELS; i++) scene[i][i] += 0.15 * 0.15 + 1e-3 * trace;
}

void laser_weights(double scene[CHANNELS][CHANNELS], const double *colour, double *weights) {
    double a[CHANNELS][CHANNELS + 1];
    for (int i = 0; i < CHANNELS; i++) { memcpy(a[i], scene[i], sizeof scene[i]); a[i][CHANNELS] = colour[i]; }
    for (int i = 0; i < CHANNELS; i++) {
        int pivot = i;
        for (int j = i + 1; j < CHANNELS; j++) if (fabs(a[j][i]) > fabs(a[pivot][i])) pivot = j;
        for (int k = 0; k <= CHANNELS; k++) { const double t = a[i][k]; a[i][k] = a[pivot][k], a[pivot][k] = t; }
        for (int j = i + 1; j < CHANNELS; j++) {
            const double f = a[j][i] / a[i][i];
            for (int k = i; k <= CHANNELS; k++) a[j][k] -= f * a[i][k];
        }
    }
    for (int i = CHANNELS - 1; i >= 0; i--) {
        double v = a[i][CHANNELS];
        for (int k = i + 1; k < CHANNELS; k++) v -= a[i][k] * weights[k];
        weights[i] = v / a[i][i];
    }
    const double along = colour[0] * weights[0] + colour[1] * weights[1] + colour[2] * weights[2];
    for (int i = 0; i < CHANNELS; i++) weights[i] /= MAX(along, 1e-9);
}

static int some_columns(const View *v, const Path *p, int *columns) { // 200 or fewer of those with a stripe
    int n = 0, m = 0;
    for (int c = 0; c < v->width; c++) n += p->is_stripe[c];
    const int apart = MAX((n + 199) / 200, 1);
    for (int c = 0, i = 0; c < v->width; c++) if (p->is_stripe[c] && i++ % apart == 0) columns[m++] = c;
    return m;
}

void rim_colour(const View *v, const Path *p, int channel, double added[CHANNELS]) {
    int columns[200 + 1];
    const int n = some_columns(v, p, columns), last = v->rows - 1;
    float sum[CHANNELS][201], kept[CHANNELS][201], own[201];
    added[0] = added[1] = added[2] = 0;
    if (!n) return;
    for (int i = 0; i < n; i++) {
        const int c = columns[i], row = p->row[c];
        float beside_it[CHANNELS];
        for (int k = 0; k < CHANNELS; k++) {
            beside_it[k] = 0.5f * (view_light(v, MAX(row - 12, 0), c, k) + view_light(v, MIN(row + 12, last), c, k));
            sum[k][i] = 0;
        }
        for (int t = -6; t <= 6; t++) {
            const int r = within(row + t, v->rows);
            int is_clear = 1;
            for (int k = 0; k < CHANNELS; k++) is_clear &= view_frame(v, r, c, k) < LEVEL_CLIPPED;
            for (int k = 0; k < CHANNELS; k++) sum[k][i] += is_clear ? view_light(v, r, c, k) - beside_it[k] : 0;
        }
    }
    memcpy(own, sum[channel], sizeof own);
    const float least = upper_median(own, n);
    int m = 0;
    for (int i = 0; i < n; i++) if (sum[channel][i] >= least) {
        for (int k = 0; k < CHANNELS; k++) kept[k][m] = sum[k][i];
        m++;
    }
    for (int k = 0; k < CHANNELS; k++) added[k] = (double)upper_median(kept[k], m);
}

static float view_detail(const View *v, int r, int c, int k) {
    return v->detail_step == 1 ? v->detail[((int64_t)k * v->rows + r) * v->width + c] : detail_at(v->scene, r, c, k);
}

static void core_colour(const View *v, const Path *p, int channel, double added[CHANNELS]) {
    int columns[200 + 1], m = 0;
    const int n = some_columns(v, p, columns);
    float kept[CHANNELS][201];
    added[0] = added[1] = added[2] = 0;
    for (int i = 0; i < n; i++) {
        const int c = columns[i], r = p->row[c];
        int is_clear = 1;
        for (int k = 0; k < CHANNELS; k++) is_clear &= k == channel || view_frame(v, r, c, k) < LEVEL_CLIPPED;
        if (!is_clear) continue;
        for (int k = 0; k < CHANNELS; k++) kept[k][m] = view_detail(v, r, c, k);
        m++;
    }
    for (int k = 0; m && k < CHANNELS; k++) added[k] = (double)upper_median(kept[k], m);
}

void relative_colour(const double *added, int channel, double *colour) {
    for (int k = 0; k < CHANNELS; k++) colour[k] = MIN(MAX(added[k] / MAX(added[channel], 1e-6), 0.0), 0.8);
    colour[channel] = 1;
}

static double purity_of(const double *added, int channel) {
    if (added[channel] <= 0) return 0;
    double other = -INFINITY;
    for (int k = 0; k < CHANNELS; k++) if (k != channel) other = MAX(other, added[k]);
    return MIN(MAX((1.05 - other / added[channel]) / 0.6, 0.0), 1.0);
}

double purity(const View *v, const Path *p, int channel) {
    double rim[CHANNELS], core[CHANNELS];
    rim_colour(v, p, channel, rim), core_colour(v, p, channel, core);
    const double a = purity_of(rim, channel), b = purity_of(core, channel);
    return MAX(a, b);
}

