// Extraction of a stripe by the highest peaks of its band: from a pair of pictures to the profile in one call.
#include "kernel.h"

// Results in place of a number of doubtful columns, as in precise.py.
enum { IN_DOUBT = -1, SWAPPED = -2, CHANGED = -3 };

// Stripe in every column (n,): row and light of the peak, row of a doubtful return, masks of the columns with a peak, with a
// clipped core and with an uncertain peak. figures: judgement (5 numbers), sigma of the stripe, noise of a response.
typedef struct { double *figures; int64_t *top; float *height, *doubtful; uint8_t *is_peak, *is_clipped, *is_unsure; } Columns;

// Work memory of the judgement and the search, smoothed light, filters and their responses.
typedef struct { char *judge, *find, *smooth; float *filters, *responses, *work, *window; } Memory;

static int64_t carve(Memory *parts, char *memory, int64_t rows, int64_t columns, int64_t channels) {
    int64_t at = 0;
#define PART(NAME, SIZE) parts->NAME = (void *)(memory + at), at += ((SIZE) + 63) / 64 * 64
    PART(judge, 4 * judge_size(rows, columns, channels));
    PART(find, find_size(rows, columns));
    PART(filters, 4 * SHIFTS * MOST_TAPS);
    PART(responses, 4 * SHIFTS * columns);
    PART(work, 4 * 3 * columns);
    PART(smooth, 4 * rows * columns);
    PART(window, 4 * window_size(columns));
    return at;
}

static int64_t carve_columns(Columns *found, char *memory, int64_t n) {
    found->figures = (double *)memory, found->top = (int64_t *)(memory + 64);
    found->height = (float *)(found->top + n), found->doubtful = found->height + n;
    found->is_peak = (uint8_t *)(found->doubtful + n);
    found->is_clipped = found->is_peak + n, found->is_unsure = found->is_clipped + n;
    return (64 + 19 * n + 63) / 64 * 64;
}

// Bytes of `memory` of `extract_clean`.
int64_t clean_size(int64_t rows, int64_t columns, int64_t channels) {
    static char nothing[1];
    Memory parts;
    Columns found;
    return carve_columns(&found, nothing, columns) + carve(&parts, nothing, rows, columns, channels);
}

// Extract a stripe from a pair of pictures. most_change: largest change of brightness beside the stripe [grey levels]. memory:
// receives `Columns` at its beginning, which precise.py reads. profile, status: (3, n) and (n,), position, its standard
// deviation, peak, and status. Returns the number of doubtful columns; IN_DOUBT, SWAPPED or CHANGED without a profile.
int64_t extract_clean(const Picture *on, const Picture *off, int64_t first_row, double most_change, char *memory,
    float *profile, uint8_t *status) {
    Memory parts;
    Columns f;
    Judgement seen;
    const int64_t n = on->columns, rows = on->rows;
    carve(&parts, memory + carve_columns(&f, memory, n), rows, n, on->channels);
    judge(on, off, (float *)parts.judge, &seen);
    memcpy(f.figures, &seen, sizeof seen);
    if (seen.is_swapped != 0) return SWAPPED;
    if (fabs(seen.change) > most_change) return CHANGED;
    const int64_t is_fused = seen.is_core_clipped != 0 && on->channels == 3, is_float = is_fused || on->size == 2;
    const int64_t channel = (int64_t)seen.channel;
    double found[2], mix[3] = {0}, *gain = (double[]){1, 1, 1};
    if (find_stripe(on, off, &seen, is_fused, parts.find, parts.smooth, f.top, f.height, f.is_peak, f.is_clipped, f.is_unsure,
            mix, found)) return IN_DOUBT;
    if (found[0] > WIDE_SIGMA_PX) {
        uint8_t *is_path = (uint8_t *)parts.find, *is_stripe = is_path + n;
        for (int64_t c = 0; c < n; c++) is_path[c] = f.is_peak[c], is_stripe[c] = f.is_peak[c] & !f.is_unsure[c];
        measure_window(on, off, mix, gain, is_path, is_stripe, f.is_clipped, 1, found[0], parts.window, f.top, f.height,
            parts.responses, found);
    } else {
        const int64_t taps = derivative_filters(found[0], parts.filters);
        found[1] *= noise_gain(parts.filters, taps, ROW_MEAN_PX);
        responses(parts.smooth, is_float, rows, n, f.top, parts.filters, taps, parts.responses);
    }
    const double noise = found[1];
    f.figures[5] = found[0], f.figures[6] = noise;
    for (int64_t c = 0; c < n; c++) profile[2 * n + c] = f.height[c] / SCALE;
    return measure(f.top, f.height, f.is_peak, f.is_clipped, f.is_unsure, parts.responses, off, channel, n, rows, first_row,
        found[0], noise, parts.work, profile, profile + n, status, f.doubtful);
}
