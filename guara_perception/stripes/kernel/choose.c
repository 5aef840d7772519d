// Choice of the peaks that are the stripe of a band, and test for doubt.
#include "find.h"

// The highest peaks are trusted if their median height exceeds this many sigmas of the noise, at most MOST_JUMPS of them
// jump by more than JUMP_PX rows to the next column, and at most MOST_RIVALS of them have a rival. More of them may
// have weak rivals, such as a reflection along the whole stripe, if at most MOST_JUMPS_BESIDE_RIVALS of them jump and at most
// MOST_STRONG_RIVALS have a strong rival.
#define CLEAR_SIGMAS 15.0
#define JUMP_PX 4
#define MOST_JUMPS 0.05
#define MOST_JUMPS_BESIDE_RIVALS 0.02
#define MOST_RIVALS 0.2
#define MOST_STRONG_RIVALS 0.05
// Noise above this is not the sensor's: the two frames do not match, and may hide a stripe [grey levels of 8 bits]. The
// second limit holds for a laser-off picture of another exposure, where the difference is known to contain some of the scene.
#define MOST_NOISE 4.0
#define MOST_UNEVEN_NOISE 2.5
// Peaks in a smaller fraction of the columns are noise: the band contains no stripe, and there is no doubt.
#define LEAST_COLUMNS 0.05
// Height of a second peak, as a share of the highest, from which it is a rival.
#define RIVAL_OF_PEAK 0.35f
#define STRONG_RIVAL 0.65f
// Columns added on both sides of a run of columns with rivals, and length of the longest run that is taken for a jump.
#define CONTEXT_COLUMNS 6
#define EDGE_COLUMNS 4
// A choice is ambiguous if the cost of the next best exceeds its own by less than this.
#define LEAST_MARGIN 1.5
// Peaks of one column closer than this, in sigmas of the stripe and at least in pixels, are one peak.
#define APART_SIGMAS 3.0
#define APART_PX 5
// Factor of log(highest / own height) in the cost of a peak, with the highest candidate of its column.
#define WEAKNESS_COST 2.0f
// Row difference between neighbouring columns that costs 1; a jump (an edge) costs at most JUMP_COST.
#define ROWS_PER_COST 2.0
#define JUMP_COST 4.0
// Cost of choosing no peak in a column, and of entering or leaving that state.
#define DROPOUT_COST 3.0
#define GAP_COST 1.0

static double move(int64_t count, int64_t from, int64_t to, const int64_t *before, const int64_t *after) {
    if (from == count && to == count) return 0;
    if (from == count || to == count) return GAP_COST;
    const double rows = fabs((double)(before[from] - after[to])) / ROWS_PER_COST;
    return MIN(rows, JUMP_COST);
}

// Choose one of up to four peaks, or none, in each of n neighbouring columns: dynamic programming with explicit dropout.
// rows, heights: (n, count) of the candidates, height 0 where a column has fewer. choice: index of the chosen one, -1 for
// none. margin: cost of the cheapest path with another choice in this column, minus the cost of the best path.
void follow_candidates(const int64_t *rows, const float *heights, int64_t n, int64_t count, Costs *costs, int64_t *choice,
    double *margin) {
    for (int64_t i = 0; i < n; i++) {
        const float *height = heights + i * count;
        float strongest = 1e-6f;
        for (int64_t k = 0; k < count; k++) strongest = MAX(strongest, height[k]);
        for (int64_t k = 0; k < count; k++) {
            const float weakness = height[k] > 0 ? -(float)log((double)(height[k] / strongest)) : INFINITY;
            costs[i].own[k] = (double)(WEAKNESS_COST * weakness);
        }
        costs[i].own[count] = DROPOUT_COST;
        for (int64_t k = 0; k <= count; k++) {
            double best = i ? INFINITY : 0;
            for (int64_t j = 0; i && j <= count; j++) {
                const double cost = costs[i - 1].forward[j] + move(count, j, k, rows + (i - 1) * count, rows + i * count);
                best = MIN(best, cost);
            }
            costs[i].forward[k] = costs[i].own[k] + best;
        }
    }
    for (int64_t i = n - 1; i >= 0; i--) {
        double least = INFINITY, next = INFINITY;
        for (int64_t k = 0; k <= count; k++) {
            double best = i < n - 1 ? INFINITY : 0;
            for (int64_t j = 0; i < n - 1 && j <= count; j++) {
                const double cost = costs[i + 1].own[j] + costs[i + 1].backward[j];
                best = MIN(best, cost + move(count, k, j, rows + i * count, rows + (i + 1) * count));
            }
            costs[i].backward[k] = best;
            const double total = costs[i].forward[k] + best;
            if (total < least) next = least, least = total, choice[i] = k < count ? k : -1;
            else next = MIN(next, total);
        }
        margin[i] = isfinite(next) ? next - least : INFINITY;
    }
}

// Up to MOST_CANDIDATES local maxima of a column, highest first, further apart than `distance`; height 0 for none. Those
// below RIVAL_OF_PEAK of the highest are omitted. maxima: (rows,).
static void candidates(const void *searched, const Light *light, const void *blocks, int64_t column, float least,
    int64_t distance, int32_t *maxima, int64_t *rows, float *heights) {
    const int64_t last = light->rows - 1, n = light->columns;
    int64_t count = 0;
    for (int64_t r = 0; r <= last; r++) {
        if (r % BLOCK_ROWS == 0 && value(blocks, light->is_float, r / BLOCK_ROWS * n + column) < least) {
            r += BLOCK_ROWS - 1;
            continue;
        }
        const float here = value(searched, light->is_float, r * n + column);
        if (here >= least && (!r || here >= value(searched, light->is_float, (r - 1) * n + column)) &&
            (r == last || here >= value(searched, light->is_float, (r + 1) * n + column))) maxima[count++] = (int32_t)r;
    }
    for (int k = 0; k < MOST_CANDIDATES; k++) {
        rows[k] = 0, heights[k] = 0;
        for (int64_t i = 0; i < count; i++) {
            const float here = value(searched, light->is_float, maxima[i] * n + column);
            int is_free = here > heights[k];
            for (int j = 0; j < k && is_free; j++) is_free = llabs(maxima[i] - rows[j]) > distance;
            if (is_free) rows[k] = maxima[i], heights[k] = here;
        }
        if (heights[k] < RIVAL_OF_PEAK * heights[0]) heights[k] = 0;
    }
    if (light->step > 1) for (int k = 0; k < MOST_CANDIDATES; k++) rows[k] = row_of_bin(rows[k], light->on->rows);
}

// Test for doubt that the highest peaks of a band are its stripe.
int is_doubtful(const Light *light, const int64_t *top, const float *height, const float *second,
    double threshold, double noise, int is_uneven) {
    const float least = (float)threshold;
    int64_t count = 0, dim = 0, jumps = 0, rivals = 0, strong = 0;
    const float clear = (float)(CLEAR_SIGMAS / THRESHOLD_SIGMAS * threshold);
    for (int64_t c = 0; c < light->columns; c++) count += height[c] > least, dim += height[c] > least && height[c] < clear;
    const int is_few = (double)count < LEAST_COLUMNS * (double)light->columns;
    noise /= COLUMN_MEAN_PX * full_scale(light->on) / 255;
    if (is_uneven && (is_few || noise > MOST_UNEVEN_NOISE)) return 1;
    if (is_few) return noise > MOST_NOISE;
    if (dim > count / 2) return 1; // the upper median is dim
    for (int64_t c = 0; c < light->columns; c++) {
        if (!(height[c] > least)) continue;
        jumps += c > 0 && height[c - 1] > least && llabs(top[c] - top[c - 1]) > JUMP_PX;
        rivals += second[c] > least && second[c] > RIVAL_OF_PEAK * height[c];
        strong += second[c] > least && second[c] > STRONG_RIVAL * height[c];
    }
    const double all = (double)count;
    if ((double)rivals <= MOST_RIVALS * all) return (double)jumps > MOST_JUMPS * all;
    // Without colour, only a search of the whole band distinguishes the laser from other bright light.
    return is_uneven || light->on->channels < 3 || (double)jumps > MOST_JUMPS_BESIDE_RIVALS * all || (double)strong > MOST_STRONG_RIVALS * all;
}

// Choose the highest peak where it has no rival; elsewhere follow the stripe from column to column. is_unsure:
// receives 1 where another choice is almost as good.
void choose(const Light *light, Work *work, const void *searched, int64_t *top, float *height, const float *second,
    double threshold, double sigma, uint8_t *is_unsure) {
    const int64_t n = light->columns, distance = MAX((int64_t)ceil(APART_SIGMAS * sigma), APART_PX) / light->step;
    const float least = (float)threshold;
    double *margin = (double *)work->indices;
    uint8_t *is_rival = (uint8_t *)work->lines;
    for (int64_t c = 0; c < n; c++) {
        is_rival[c] = second[c] > RIVAL_OF_PEAK * height[c] && second[c] > least && height[c] > least;
        is_unsure[c] = 0;
    }
    for (int64_t begin = 0, end; begin < n; begin = end) {
        if (!is_rival[begin]) { end = begin + 1; continue; }
        // Runs whose contexts overlap are joined.
        int64_t last = begin;
        for (end = begin + 1; end < n && end - last <= 2 * CONTEXT_COLUMNS; end++) if (is_rival[end]) last = end;
        end = last + 1;
        if (end - begin <= EDGE_COLUMNS) {
            // At a jump the mean over columns mixes the light of both sides: neither peak is right.
            for (int64_t c = begin; c < end; c++) is_unsure[c] = is_rival[c];
            continue;
        }
        const int64_t first = MAX(begin - CONTEXT_COLUMNS, 0), count = MIN(end + CONTEXT_COLUMNS, n) - first;
        int64_t *rows = work->candidates, *choice = (int64_t *)work->ring;
        for (int64_t i = 0; i < count; i++)
            candidates(searched, light, work->blocks, first + i, MAX(least, RIVAL_OF_PEAK * height[first + i]), distance,
                (int32_t *)work->samples, rows + MOST_CANDIDATES * i, work->heights + MOST_CANDIDATES * i);
        follow_candidates(rows, work->heights, count, MOST_CANDIDATES, work->costs, choice, margin);
        for (int64_t i = 0; i < count; i++) {
            const float *heights = work->heights + MOST_CANDIDATES * i;
            if (choice[i] >= 0) top[first + i] = rows[MOST_CANDIDATES * i + choice[i]], height[first + i] = heights[choice[i]];
            is_unsure[first + i] |= heights[1] > 0 && (choice[i] < 0 || margin[i] < LEAST_MARGIN);
        }
    }
}
