// Runs of returns along a stripe, whose ends cannot be used; relief and samples of the surface between stripes.
#include "kernel.h"

// Height difference between neighbouring columns above which they belong to different surfaces [m].
#define JUMP_M 0.004
// Number of unusable columns on each side of a jump or a gap: they mix light from both sides, or contain light spread by
// the lens and by the mean over columns.
enum { END_COLUMNS = 2 };
// A run of fewer than SHORT_RUN_COLUMNS columns, all weaker than this fraction of the stripe's median strength, is the
// remnant of a stripe cut by an edge.
enum { SHORT_RUN_COLUMNS = 12 };
#define WEAK_OF_STRIPE 0.5
// A run that fades towards its end is cut by the edge of a shadow, and the rest of the stripe there is displaced. A
// column is faded if it is weaker than this fraction of the mean of the next LEVEL_COLUMNS columns. Two consecutive bright
// columns end a fade; speckle makes single columns bright within a shadow.
#define FADED_OF_LEVEL 0.6
enum { LEVEL_COLUMNS = 12 };
// The edge of a shadow along a stripe cuts it lengthwise: several columns are displaced by more than DISPLACED_M [m], and
// the first DIM_COLUMNS are weaker than DIM_OF_LEVEL of the strength further in.
#define DISPLACED_M 0.00075
enum { DIM_COLUMNS = 3 };
#define DIM_OF_LEVEL 0.85
// Half-width of the window over which the relief is averaged, in units of half the stripe spacing.
enum { AVERAGED = 4 };
// Spacing of the columns from which medians of distances are computed.
enum { SPARSE = 4 };

// Columns of a stripe counted from either end: column i from that end is i or n - 1 - i.
typedef struct { const double *height, *strength; const uint8_t *is_trusted; int64_t n, is_reversed; } Row;
static int64_t at(const Row *row, int64_t i) { return row->is_reversed ? row->n - 1 - i : i; }

static int is_sound(const Row *row, const double *total, int64_t i, int64_t last) {
    const int64_t here = MIN(i, last), after = MIN(here + LEVEL_COLUMNS, last), own = at(row, here);
    const double level = (total[after + 1] - total[here + 1]) / (double)MAX(after - here, 1);
    return row->strength[own] >= FADED_OF_LEVEL * level;
}

// Number of columns at the start of a run before two successive ones reach FADED_OF_LEVEL of those that follow. total: (n + 1,)
// cumulative strength from that end.
static int64_t fade_length(const Row *row, const double *total, int64_t first, int64_t last) {
    for (int64_t i = first; i <= last; i++) if (is_sound(row, total, i, last) && is_sound(row, total, i + 1, last)) return i - first;
    return last - first + 1;
}

static double median_of_level(const Row *row, int64_t first) {
    double sorted[LEVEL_COLUMNS];
    for (int64_t i = 0; i < LEVEL_COLUMNS; i++) {
        const double own = row->height[at(row, first + i)];
        int64_t k = i;
        for (; k > 0 && sorted[k - 1] > own; k--) sorted[k] = sorted[k - 1];
        sorted[k] = own;
    }
    return (sorted[LEVEL_COLUMNS / 2 - 1] + sorted[LEVEL_COLUMNS / 2]) / 2;
}

// Mark the first columns of runs of trusted returns if they are dim and displaced in height relative to the run further in. If
// the first LEVEL_COLUMNS all differ, the run is a slope and is kept.
static void displaced(const Row *row, uint8_t *is_end) {
    for (int64_t c = 1; c + 2 * LEVEL_COLUMNS <= row->n; c++) {
        if (row->is_trusted[at(row, c - 1)]) continue;
        int64_t length = 0, taken = 0;
        while (length < 2 * LEVEL_COLUMNS && row->is_trusted[at(row, c + length)]) length++;
        if (length < 2 * LEVEL_COLUMNS) continue;
        double light = 0, level = 0;
        for (int64_t i = 0; i < DIM_COLUMNS; i++) light += row->strength[at(row, c + i)];
        for (int64_t i = LEVEL_COLUMNS; i < 2 * LEVEL_COLUMNS; i++) level += row->strength[at(row, c + i)];
        if (!(light / DIM_COLUMNS < DIM_OF_LEVEL * (level / LEVEL_COLUMNS))) continue;
        const double usual = median_of_level(row, c + LEVEL_COLUMNS);
        while (taken < LEVEL_COLUMNS && fabs(row->height[at(row, c + taken)] - usual) > DISPLACED_M) taken++;
        if (taken == LEVEL_COLUMNS) continue;
        for (int64_t i = 0; i < taken; i++) is_end[at(row, c + i)] = 1;
    }
}

// Returns (n,) of a stripe that cannot be used because a run of returns ends there: near a gap or a jump, in the faded end of
// a run, in a run that is short and weak, in an end that is dim and displaced. The borders of the picture end no run.
// height: [m], NaN where there is no return. strength: [grey levels]. work: 4 (n + 1) numbers of 8 bytes.
void run_ends(const double *height, const double *strength, int64_t n, double *work, uint8_t *is_end) {
    double *light = work, *from_left = light + n + 1, *from_right = from_left + n + 1;
    uint8_t *is_break = (uint8_t *)(from_right + n + 1), *is_trusted = is_break + n, is_any = 0;
    float *some = (float *)from_left, usual = NAN;
    int64_t returns = 0;
    memset(is_end, 0, (size_t)n);
    for (int64_t c = 0; c + 1 < n; c++) is_any |= is_break[c] = !(fabs(height[c + 1] - height[c]) <= JUMP_M);
    if (!is_any) return;
    is_break[n - 1] = 1;
    for (int64_t c = 0; c < n; c++) {
        light[c] = isfinite(height[c]) ? strength[c] : 0;
        if (isfinite(height[c])) some[returns++] = (float)strength[c];
    }
    if (returns) usual = (float)median(some, returns);
    from_left[0] = from_right[0] = 0;
    for (int64_t c = 0; c < n; c++) from_left[c + 1] = from_left[c] + light[c], from_right[c + 1] = from_right[c] + light[n - 1 - c];
    const Row forward = {height, light, is_trusted, n, 0}, back = {height, light, is_trusted, n, 1};
    for (int64_t first = 0, last; first < n; first = last + 1) {
        double strongest = light[first];
        for (last = first; !is_break[last]; last++) strongest = MAX(strongest, light[last + 1]);
        if (!isfinite(height[first])) continue;
        const int begins = first > 0, ends = last < n - 1;
        if (begins && ends && last - first < SHORT_RUN_COLUMNS - 1 && strongest < WEAK_OF_STRIPE * (double)usual) {
            memset(is_end + first, 1, (size_t)(last - first + 1));
            continue;
        }
        if (begins) memset(is_end + first, 1, (size_t)fade_length(&forward, from_left, first, last));
        if (!ends) continue;
        const int64_t faded = fade_length(&back, from_right, n - 1 - last, n - 1 - first);
        memset(is_end + last + 1 - faded, 1, (size_t)faded);
    }
    for (int64_t c = 0; c + 1 < n; c++)
        for (int64_t i = MAX(c + 1 - END_COLUMNS, 0); is_break[c] && i <= MIN(c + END_COLUMNS, n - 1); i++) is_end[i] = 1;
    for (int64_t c = 0; c < n; c++) is_end[c] &= isfinite(height[c]) != 0, is_trusted[c] = isfinite(height[c]) && !is_end[c];
    const Row left = {height, strength, is_trusted, n, 0}, right = {height, strength, is_trusted, n, 1};
    displaced(&left, is_end), displaced(&right, is_end);
}

// Variance (n,) of the ground halfway between two stripes about the straight line between them [m^2]. The ground is taken
// to be as rough across the stripes as along them: there, its heights are compared with the mean of those half the distance
// of the stripes to either side. x, y, z: (2, n) points of both, NaN where there is none. variance: (2, n) of the heights
// [m^2], whose contribution is subtracted. work: 3 (n + 1) numbers of 8 bytes.
void pair_relief(const float *x, const float *y, const float *z, const float *variance, int64_t n, double *work, double *relief) {
    double *square = work, *number = square + n + 1;
    float *some = (float *)(number + n + 1);
    for (int64_t c = 0; c < n; c++) relief[c] = 0;
    // Some columns are enough for the medians, unless they contain no points.
    double apart = NAN, beside = NAN;
    for (int64_t step = SPARSE; step && isnan(apart + beside); step /= SPARSE) {
        int64_t many = 0;
        for (int64_t c = 0; c < n; c += step)
            if (isfinite(z[c]) && isfinite(z[n + c])) {
                const double along = (double)x[n + c] - (double)x[c], across = (double)y[n + c] - (double)y[c];
                some[many++] = (float)sqrt(along * along + across * across);
            }
        apart = many ? median(some, many) : NAN, many = 0;
        for (int64_t k = 0; k < 2; k++)
            for (int64_t c = k * n; c + 1 < (k + 1) * n; c += step)
                if (isfinite(z[c]) && isfinite(z[c + 1])) some[many++] = fabsf(y[c + 1] - y[c]);
        beside = many ? median(some, many) : NAN;
    }
    if (isnan(apart + beside)) return;
    const int64_t lag = MAX((int64_t)rint(0.5 * apart / MAX(beside, 1e-6)), 1), half = AVERAGED * lag;
    if (n <= 2 * lag) return;
    // Cumulative sums over the columns before each one.
    for (int64_t c = 0; c <= n; c++) square[c] = number[c] = 0;
    for (int64_t k = 0; k < 2; k++) {
        int64_t gap = -1; // last column without a point; there must be none between the three
        for (int64_t c = 0; c < n; c++) {
            const float *height = z + k * n, *own = variance + k * n;
            if (!isfinite(height[c])) gap = c;
            const int64_t middle = c - lag, first = middle - lag;
            if (first < 0 || gap >= first) continue;
            const double off = (double)height[middle] - 0.5 * ((double)height[first] + (double)height[c]);
            square[middle + 1] += off * off - (double)(own[middle] + 0.25f * (own[first] + own[c])), number[middle + 1]++;
        }
    }
    for (int64_t c = 0; c < n; c++) square[c + 1] += square[c], number[c + 1] += number[c];
    for (int64_t c = 0; c < n; c++) {
        const int64_t first = MAX(c - half, 0), end = MIN(c + half + 1, n);
        relief[c] = MAX((square[end] - square[first]) / MAX(number[end] - number[first], 1), 0);
    }
}

// Samples of the surface of several stripes (stripes, n): confirmed points, and lines between each stripe and the next. points:
// (3, stripes, n), NaN where there is none. variance: (stripes, n) of the heights. is_confirmed: (stripes, n). before_first,
// is_line, after_second, is_wanted: (stripes - 1, n) columns in which the surface continues before the first stripe of a pair,
// in which both are joined, in which it continues after the second, and whose lines are requested. number: (stripes - 1,) of
// samples on each line, 0 if none are requested. open_end: length by which a line is shortened where the surface ends [m]; the
// heights of the samples cut off are NaN. work: 15 (n + 1) numbers of 8 bytes. samples, variances: (3, all) and (all,), receive the
// samples and the variances of their heights; of a pair, the first samples of all lines, then the second ones.
void sample_surface(const float *points, const float *variance, int64_t stripes, int64_t n, const uint8_t *is_confirmed,
    const uint8_t *before_first, const uint8_t *is_line, const uint8_t *after_second, const uint8_t *is_wanted,
    const int64_t *number, double open_end, int64_t all, double *work, double *restrict samples, double *restrict variances) {
    double *relief = work, *hidden = relief + n + 1, *first = hidden + n + 1, *change = first + 3 * n, *before = change + 3 * n;
    double *after = before + n, *start = after + n, *end = start + n, *rest = end + n;
    int64_t at = 0;
    for (int64_t i = 0; i < stripes * n; i++) {
        if (!is_confirmed[i]) continue;
        for (int64_t k = 0; k < 3; k++) samples[k * all + at] = (double)points[k * stripes * n + i];
        variances[at++] = (double)variance[i];
    }
    for (int64_t k = 0; k + 1 < stripes; k++) {
        if (!number[k]) continue;
        const float *own[3] = {points + k * n, points + (stripes + k) * n, points + (2 * stripes + k) * n};
        int64_t lines = 0, cuts = 0, *cut = (int64_t *)rest; // The lines that are cut, of which there are few.
        pair_relief(own[0], own[1], own[2], variance + k * n, n, rest, relief);
        for (int64_t c = 0; c < n; c++) {
            if (!(is_line[k * n + c] & is_wanted[k * n + c])) continue;
            for (int64_t i = 0; i < 3; i++)
                first[i * n + lines] = (double)own[i][c], change[i * n + lines] = (double)(own[i][n + c] - own[i][c]);
            hidden[lines] = relief[c], before[lines] = (double)variance[k * n + c], after[lines] = (double)variance[(k + 1) * n + c];
            const int is_open = !before_first[k * n + c], is_closed = !after_second[k * n + c];
            if (is_open | is_closed) {
                const double length = MIN(open_end / MAX(hypot(change[lines], change[n + lines]), 1e-9), 0.5);
                start[cuts] = is_open ? length : 0, end[cuts] = is_closed ? 1 - length : 1, cut[cuts++] = lines;
            }
            lines++;
        }
        for (int64_t s = 0; s < number[k]; s++, at += lines) {
            const double share = ((double)s + 0.5) / (double)number[k], bend = 4 * share * (1 - share);
            for (int64_t i = 0; i < 3; i++)
                for (int64_t l = 0; l < lines; l++) samples[i * all + at + l] = share * change[i * n + l] + first[i * n + l];
            for (int64_t l = 0; l < lines; l++)
                variances[at + l] = (1 - share) * before[l] + share * after[l] + bend * hidden[l];
            for (int64_t i = 0; i < cuts; i++) if ((share < start[i]) | (share > end[i])) samples[2 * all + at + cut[i]] = NAN;
        }
    }
}
