// What the measured surface hides from a camera or a laser.
#include "kernel.h"

// The cell of a coordinate, from 0 to `most`.
static int64_t cell_at(float share, float change, float begin, int64_t most) {
    const float at = share * change + begin;
    return at >= (float)most ? most : at > 0 ? (int64_t)at : 0;
}

// Targets (n, 3) whose line to any of some sensors (number, 3) passes below a surface (rows, columns), which has a border of
// unknown cells. top: its highest cell. offset: of the frame in columns and rows. margin: by which the surface must be higher
// [m]. Steps of half a cell from the target on, up to the height of `top`. Single precision is accurate to 1e-5 of a cell.
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
