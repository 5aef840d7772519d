// A second line beside a stripe or merged with it, from the pictures of a pair.
#include "kernel.h"

// Number of columns in which the surroundings of a stripe are examined, its upper bound after rounding, and the least number that
// must show the stripe.
enum { COLUMNS = 96, MOST_COLUMNS = 2 * COLUMNS, LEAST_COLUMNS = 12 };
// Largest distance of a second line, as a fraction of the image height: 16 px of 512, about three stripes.
#define REACH_OF_HEIGHT (1.0 / 32)
enum { LEAST_REACH = 4 };
// Two merged lines have a flat top. The ratio of the widths at 1/4 and 3/4 of the height is 2.2 for a Gaussian, at least
// 1.7 for single lines of simulated and rendered scenes, and 1.25 to 1.6 for two lines half a stripe width apart with a
// brightness ratio of 0.8 to 1.3. Closer lines shift the row by less than 5 mm of height.
#define LEAST_WIDTHS 1.62
// A line narrower than this at 1/4 of its height is a single one whose top is flat because of the pixel size. In images
// of 320 x 256 px, single lines are 1.7 to 2.5 px wide there, pairs that shift the row by 5 mm of height 2.2 px or more.
#define LEAST_WIDE_PX 2.0
// Two separate lines whose outer flanks are both above half the height: the ratio of the widths at 1/2 and 3/4 is 3; it
// is 1.55 for a Gaussian and 1.3 to 1.6 for single lines of simulated and rendered scenes.
#define MOST_WIDTHS 2.2
// Least distance from the top at which the two sides are compared [bins]: closer bins belong to the line itself.
enum { LEAST_BINS = 4 };
#define BIN_PX 0.5
// Largest fraction of clipped tops at which a flat top still indicates a second line.
#define MOST_CLIPPED 0.1
// Least height of a top above its surroundings [grey levels of 255].
#define LEAST_TOP 12.0

static int64_t reach_of(int64_t rows) { return MAX((int64_t)rint(REACH_OF_HEIGHT * (double)rows), LEAST_REACH); }

// Bytes of `memory` of `second_line`: light and bins, sums and counts.
int64_t second_line_size(int64_t rows) {
    const int64_t lines = 2 * reach_of(rows) + 1;
    return 4 * lines * (MOST_COLUMNS + 2) + 2 * 8 * (int64_t)((double)(lines + 2) / BIN_PX);
}

// Light (lines,) of a column, from a row on: brightest channel of the laser-on picture minus that of the laser-off picture.
static inline __attribute__((always_inline)) void light_below(const Picture *on, const Picture *off, int64_t row, int64_t column,
    int64_t lines, int64_t channels, int64_t size, float *out) {
    Picture first = *on, second = *off;
    first.size = second.size = size; // known to the compiler
    for (int64_t r = 0; r < lines; r++) {
        int32_t most = level(&first, row + r, column, 0), dark = level(&second, row + r, column, 0);
        for (int64_t k = 1; k < channels; k++)
            most = MAX(most, level(&first, row + r, column, k)), dark = MAX(dark, level(&second, row + r, column, k));
        out[r] = (float)(most - dark);
    }
}

// Distance between the outermost crossings of a level [bins]; infinite where one lies beyond the ends.
static double width_at(const double *section, int64_t n, double height) {
    int64_t first = 0, last = n - 1;
    while (first < n && section[first] < height) first++;
    while (last > first && section[last] < height) last--;
    if (first == 0 || last == n - 1 || first == n) return INFINITY;
    const double before = (section[first] - height) / MAX(section[first] - section[first - 1], 1e-6);
    return (double)(last - first) + before + (section[last] - height) / MAX(section[last] - section[last + 1], 1e-6);
}

// Brightness of a second line that most columns show, as a fraction of the stripe's; 1 if both merge. at_most: limit of the
// unsigned difference for stripes with clipped tops, whose ragged edges make it large. position: (columns,) row of the stripe,
// NaN where there is none.
double second_line(const Picture *on, const Picture *off, const float *position, double at_most, char *memory) {
    const int64_t reach = reach_of(on->rows), lines = 2 * reach + 1;
    int64_t known = 0, n = 0, number = 0, column[MOST_COLUMNS], top[MOST_COLUMNS];
    float *light = (float *)memory, *own = light + lines * MOST_COLUMNS, differences[MOST_COLUMNS], sizes[MOST_COLUMNS];
    for (int64_t c = 0; c < on->columns; c++) known += isfinite(position[c]) != 0;
    if (known < LEAST_COLUMNS) return 0;
    const int64_t apart = MAX(known / COLUMNS, 1);
    int64_t inside = 0, clipped = 0;
    for (int64_t c = 0; c < on->columns; c++) {
        if (!isfinite(position[c])) continue;
        const int is_one = number == 0;
        number = number + 1 < apart ? number + 1 : 0;
        if (!is_one) continue;
        const int64_t row = (int64_t)rintf(position[c]);
        if (row < reach || row >= on->rows - reach) continue;
        inside++;
        if (on->size == 1 && on->channels == 3) light_below(on, off, row - reach, c, lines, 3, 1, own);
        else light_below(on, off, row - reach, c, lines, on->channels, on->size, own);
        // The highest pixel may be beside the rounded row.
        const float highest = MAX(MAX(own[reach - 1], own[reach]), own[reach + 1]);
        if (!((double)highest * 255 / full_scale(on) > LEAST_TOP)) continue;
        for (int64_t r = 0; r < lines; r++) own[r] /= highest;
        for (int64_t r = 0; r < lines; r++) light[r * MOST_COLUMNS + n] = own[r];
        for (int64_t k = 0; k < on->channels; k++) clipped += level(on, row, c, k) >= clipped_from(on);
        column[n] = c, top[n++] = row;
    }
    if (inside < LEAST_COLUMNS || n < LEAST_COLUMNS) return 0;
    const int is_ragged = (double)clipped > MOST_CLIPPED * (double)(n * on->channels);
    double share = 0, odd = 0;
    for (int64_t far = 2; far <= reach; far++) {
        const float *below = light + (reach + far) * MOST_COLUMNS, *above = light + (reach - far) * MOST_COLUMNS;
        int64_t within_share = 0;
        // Unsigned, because the profile may follow one line in some columns and the other line elsewhere.
        for (int64_t i = 0; i < n; i++) {
            differences[i] = below[i] - above[i], sizes[i] = fabsf(differences[i]);
            within_share += (double)sizes[i] <= share;
        }
        // If more than half are at most `share`, so is the median.
        if (2 * within_share < n + 2) share = MAX(share, median(sizes, n));
        if (is_ragged) odd = MAX(odd, fabs(median(differences, n)));
    }
    if (is_ragged) return MAX(odd, MIN(share, at_most));
    // Mean cross-section in bins about the centre, as shares of its height.
    double nearest_end = 0;
    for (int64_t r = 0; r < lines; r += lines - 1) {
        double nearest = INFINITY;
        for (int64_t i = 0; i < n; i++)
            nearest = MIN(nearest, fabs((double)(r - reach) - ((double)position[column[i]] - (double)top[i])));
        nearest_end = MAX(nearest_end, nearest);
    }
    const int64_t half = (int64_t)(nearest_end / BIN_PX) - 1, bins = 2 * half + 1;
    double *section = (double *)(own + 2 * lines), *count = section + bins, most = 1e-6;
    memset(section, 0, 2 * (size_t)bins * sizeof *section);
    // Bin of the first row of each column. Columns with the same bin are summed together, so that the sum stays in a register.
    int64_t sorted[MOST_COLUMNS], first_bin[MOST_COLUMNS], m = 0, lowest = INT64_MAX, last = INT64_MIN;
    for (int64_t i = 0; i < n; i++) {
        const double far = (double)-reach - ((double)position[column[i]] - (double)top[i]);
        first_bin[i] = (int64_t)floor(far / BIN_PX + (double)half + 0.5);
        lowest = MIN(lowest, first_bin[i]), last = MAX(last, first_bin[i]);
    }
    for (int64_t from = last; from >= lowest; from--) {
        m = 0;
        for (int64_t i = 0; i < n; i++) sorted[m] = i, m += first_bin[i] == from;
        for (int64_t r = 0; r < lines; r++) {
            const int64_t bin = from + (int64_t)((double)r / BIN_PX);
            if (bin < 0 || bin >= bins) continue;
            double sum = section[bin];
            for (int64_t i = 0; i < m; i++) sum += (double)light[r * MOST_COLUMNS + sorted[i]];
            section[bin] = sum, count[bin] += (double)m;
        }
    }
    int64_t highest = 0;
    for (int64_t b = 0; b < bins; b++) section[b] /= MAX(count[b], 1), most = MAX(most, section[b]);
    for (int64_t b = bins - 1; b >= 0; b--) section[b] /= most, highest = section[b] >= section[highest] ? b : highest;
    const double wide = width_at(section, bins, 0.25), middle = width_at(section, bins, 0.5);
    const double narrow = width_at(section, bins, 0.75);
    if ((LEAST_WIDE_PX / BIN_PX < wide && wide < LEAST_WIDTHS * narrow) || (MOST_WIDTHS * narrow < middle && middle < INFINITY))
        return 1;
    // The measured row may lie between the two lines, so the sides of the highest bin are compared.
    for (int64_t far = LEAST_BINS; far <= MIN(highest, bins - 1 - highest); far++)
        share = MAX(share, fabs(section[highest + far] - section[highest - far]));
    return share;
}
