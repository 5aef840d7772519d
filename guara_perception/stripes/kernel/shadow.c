// Occlusion by the measured surface, as seen from a camera or a laser.
#include "kernel.h"

// Cell index, from 0 to `most`, of a point on a line at a fraction of its length.
static int64_t cell_at(float share, float change, float begin, int64_t most) {
    const float at = share * change + begin;
    return at >= (float)most ? most : at > 0 ? (int64_t)at : 0;
}

// Targets (n, 3) whose line to any of the sensors (number, 3) passes below a surface (rows, columns), which has a border of
// unknown cells. top: height of its highest cell. offset: column and row of the origin of the frame. margin: height by which the
// surface must exceed the line [m]. The line is followed in steps of half a cell from the target to the height of `top`. Single
// precision is accurate to 1e-5 of a cell.
void behind_surface(const float *surface, int64_t rows, int64_t columns, const double *targets, int64_t n, const double *sensors,
    int64_t number, double top, double resolution, const double *offset, double margin, uint8_t *is_hidden) {
    memset(is_hidden, 0, (size_t)n);
    for (const double *sensor = sensors; sensor < sensors + 3 * number; sensor += 3) {
        double begin[3];
        for (int k = 0; k < 3; k++) begin[k] = k < 2 ? sensor[k] / resolution + offset[k] : sensor[2] + margin;
        for (int64_t i = 0; i < n; i++) {
            const double *target = targets + 3 * i, x = sensor[0] - target[0], y = sensor[1] - target[1];
            const double end = 1 - (top - target[2]) / MAX(sensor[2] - target[2], 1e-6), from = MIN(MAX(end, 0), 1);
            const double step = resolution / 2 / MAX(hypot(x, y), resolution);
            float change[3];
            for (int k = 0; k < 3; k++)
                change[k] = (float)((k < 2 ? target[k] / resolution + offset[k] : target[2] + margin) - begin[k]);
            const int64_t steps = (int64_t)ceil((1 - from) / step) + 1;
            for (int64_t s = 0; s < steps && !is_hidden[i]; s++) {
                const float share = MAX(1 - ((float)s + 0.5f) * (float)step, (float)from);
                const int64_t column = cell_at(share, change[0], (float)begin[0], columns - 1);
                const int64_t row = cell_at(share, change[1], (float)begin[1], rows - 1);
                is_hidden[i] = surface[row * columns + column] > share * change[2] + (float)begin[2];
            }
        }
    }
}

// Cells of a grid (rows, columns) outside the sweep: before the first or after the last known cell of their row, if an outermost
// stripe meets that cell, and the corresponding cell of all rows that light to `deepest` crosses. elevation: NaN where unknown.
// planes: (2, 4) of the outermost stripes. x, y: centres of columns and rows. tolerance: largest distance of a stripe that meets
// a cell [m]. deepest: lowest height that light may reach [m]. laser: (3,) position. work: 2 rows + 1.
void unmet_cells(const double *elevation, int64_t rows, int64_t columns, const double *planes, const double *x, const double *y,
    double resolution, double tolerance, double deepest, const double *laser, int64_t *work, uint8_t *is_unmet) {
    int64_t *end = work, *others = work + rows; // others[r]: number of rows before r whose end is not met
    memset(is_unmet, 0, (size_t)(rows * columns));
    for (int sign = 1; sign >= -1; sign -= 2) {
        double top = deepest;
        others[0] = 0;
        for (int64_t r = 0; r < rows; r++) {
            const double *own = elevation + r * columns;
            int is_met = 0;
            end[r] = sign > 0 ? 0 : columns - 1;
            while (end[r] >= 0 && end[r] < columns && !isfinite(own[end[r]])) end[r] += sign;
            if (end[r] >= 0 && end[r] < columns) {
                const double height = own[end[r]];
                double crossing = INFINITY;
                for (const double *p = planes; p < planes + 8; p += 4)
                    crossing = MIN(crossing, sign * -(p[1] * y[r] + p[2] * height + p[3]) / p[0]);
                is_met = sign * (x[end[r]] - sign * crossing) <= tolerance;
                top = is_met ? MAX(top, height) : top;
            }
            others[r + 1] = others[r] + !is_met;
        }
        const double share = MIN(MAX((laser[2] - top) / (laser[2] - deepest), 0), 1);
        for (int64_t r = 0; r < rows; r++) {
            const double passed = (laser[1] + (y[r] - laser[1]) * share - y[0]) / resolution;
            const int64_t other = (int64_t)MIN(MAX(rint(passed), 0), (double)(rows - 1));
            if (others[MAX(r, other) + 1] != others[MIN(r, other)]) continue;
            for (int64_t c = end[r] - sign; c >= 0 && c < columns; c -= sign) is_unmet[r * columns + c] = 1;
        }
    }
}

// Lowest known height (rows, columns) of a surface within `near` rows and columns of each cell; INFINITY where none is known.
// elevation: NaN where unknown. work: columns + 2 near.
void lowest_nearby(const double *elevation, int64_t rows, int64_t columns, int64_t near, double *work, double *lowest) {
    for (int64_t c = 0; c < columns + 2 * near; c++) work[c] = INFINITY;
    double *restrict across = work + near;
    for (int64_t r = 0; r < rows; r++) {
        double *restrict out = lowest + r * columns;
        for (int64_t c = 0; c < columns; c++) across[c] = out[c] = INFINITY;
        for (int64_t other = MAX(r - near, 0); other <= MIN(r + near, rows - 1); other++) {
            const double *restrict own = elevation + other * columns;
            for (int64_t c = 0; c < columns; c++) across[c] = own[c] < across[c] ? own[c] : across[c];
        }
        for (int64_t beside = -near; beside <= near; beside++)
            for (int64_t c = 0; c < columns; c++) out[c] = across[c + beside] < out[c] ? across[c + beside] : out[c];
    }
}
