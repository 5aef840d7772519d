// Extraction of a stripe in any light: from one picture or a pair to the profile in one call.
#include "any_light.h"

// Result in place of a number of doubtful columns, as in precise.py: repeat without averaging columns.
enum { EVERY_COLUMN = -1 };
#define WEAKEST 1e-3f
// The width of the ridge is the third quartile over its columns.
#define RIDGE_QUARTERS 3
enum { JUMP_ROWS = 4 };

typedef struct {
    Scene scene;
    Any any;
    char *line;
    int64_t *row;
    float *height, *responses, *window, *work, *doubtful;
    uint8_t *is_path, *is_stripe, *is_core, *is_clipped, *is_lost;
} Parts;

static int64_t carve(Parts *w, char *memory, int64_t rows, int64_t columns, int64_t channels, int64_t factor, int64_t has_off) {
    const int64_t width = columns / factor, n = channels * rows * width;
    int64_t at = 0;
    TAKE(doubtful, 4 * columns);
    TAKE(line, 4 * columns);
    TAKE(row, 8 * columns);
    TAKE(height, 4 * columns);
    TAKE(responses, 4 * SHIFTS * columns);
    TAKE(work, 4 * 3 * columns);
    TAKE(window, 4 * window_size(columns));
    TAKE(is_path, columns), TAKE(is_stripe, columns), TAKE(is_core, columns), TAKE(is_clipped, columns), TAKE(is_lost, columns);
    TAKE(scene.on, 2 * n);
    TAKE(scene.off, has_off ? 2 * n : 0);
    TAKE(scene.light, 4 * n);
    return at + carve_any(&w->any, memory + at, channels, rows, width);
}

// Bytes of `memory` of `extract_any_light`.
int64_t any_light_size(int64_t rows, int64_t columns, int64_t channels, int64_t factor, int64_t has_off) {
    static char nothing[1];
    Parts parts;
    return carve(&parts, nothing, rows, columns, channels, factor, has_off);
}

// Expand a stripe found in `count` columns to n: rows are interpolated, masks taken from the nearest column.
static void expand(const Found *f, int64_t count, int64_t n, Parts *w) {
    for (int64_t c = 0; c < n; c++) {
        const double at = ((double)c + 0.5) * (double)count / (double)n - 0.5;
        const int64_t left = within((int64_t)floor(at), count), right = MIN(left + 1, count - 1);
        const int64_t nearest = within((int64_t)rint(at), count), apart = f->path.row[right] - f->path.row[left];
        const double share = MIN(MAX(at - (double)left, 0.0), 1.0);
        const int is_joined = llabs(apart) <= JUMP_ROWS && f->is_path[left] && f->is_path[right];
        w->row[c] = is_joined ? (int64_t)rint((double)f->path.row[left] + share * (double)apart) : f->path.row[nearest];
        w->is_path[c] = f->is_path[nearest], w->is_stripe[c] = f->path.is_stripe[nearest], w->is_core[c] = f->is_core[nearest];
    }
}

// Extract a stripe from a picture, or from a pair. factor: number of columns averaged to search for the path. is_changed: 1 if
// the light changed so much that `off` is used only if it shows the same view. weak_row, is_weak: (n,) rows of weak peaks and
// mask of the columns that have one, or NULL; where no stripe is found, they are doubtful returns. memory: receives the rows
// (n,) of doubtful returns at its beginning. profile, status: (3, n) and (n,), position, its standard deviation, peak, and
// status. fault: receives the remark on `off` (OTHER_EXPOSURE, OTHER_SCENE) or USED, and the numbers of its message. Returns
// the number of doubtful columns, or EVERY_COLUMN.
int64_t extract_any_light(const Picture *on, const Picture *off, int64_t factor, int64_t is_changed, int64_t first_row,
    const int64_t *weak_row, const uint8_t *is_weak, char *memory, float *profile, uint8_t *status, double *fault) {
    Parts parts, *w = &parts;
    Scene *s = &w->scene;
    Found *found;
    const int64_t n = on->columns, count = n / factor;
    memset(s, 0, sizeof *s);
    carve(w, memory, on->rows, n, on->channels, factor, off != NULL);
    s->rows = on->rows, s->width = count, s->channels = on->channels, s->shrunk = factor, s->has_dark = off != NULL;
    planes(on, factor, w->line, s->on);
    if (off) planes(off, factor, w->line, s->off);
    fault[0] = (double)find_path(s, is_changed, &w->any, &found);
    for (int i = 0; i < 2; i++) fault[1 + i] = s->remark_numbers[i];
    if (s->remark == OTHER_SCENE && factor > 1) return EVERY_COLUMN;
    if (!s->has_dark) off = NULL;
    expand(found, count, n, w);
    double gains[CHANNELS], measured[2], ridge = 1;
    int64_t used = 0;
    for (int64_t c = 0; c < count; c++) if (found->path.is_stripe[c]) w->work[used++] = found->sigma[c];
    if (used) ridge = (double)select_value(w->work, used, RIDGE_QUARTERS * (used - 1) / 4);
    for (int k = 0; k < CHANNELS; k++) gains[k] = (double)s->gain[k];
    measure_window(on, off, found->weights, gains, w->is_path, w->is_stripe, w->is_core, factor, ridge, w->window, w->row,
        w->height, w->responses, measured);
    for (int64_t c = 0; c < n && weak_row; c++) if (!w->is_path[c]) w->row[c] = weak_row[c], w->is_path[c] = is_weak[c];
    clipped_columns(on, w->row, measured[0], found->channel, on->channels == CHANNELS, w->is_clipped, w->is_lost);
    for (int64_t c = 0; c < n; c++) {
        w->height[c] = w->is_path[c] ? MAX(w->height[c], WEAKEST) : 0, profile[2 * n + c] = w->height[c] / SCALE;
        w->is_clipped[c] &= w->is_path[c], w->is_lost[c] |= !w->is_stripe[c];
    }
    return measure(w->row, w->height, w->is_path, w->is_clipped, w->is_lost, w->responses, off, found->channel, n, on->rows,
        first_row, measured[0], measured[1], w->work, profile, profile + n, status, w->doubtful);
}
