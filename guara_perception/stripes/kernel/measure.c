// Measurement of a detected stripe: sub-pixel centre and standard deviation in every column, or the reason for none.
#include "kernel.h"

// Statuses, as in band.py.
enum { OK = 0, DROPOUT = 1, AMBIGUOUS = 2, SATURATED = 3, OUT_OF_BAND = 5 };
// Distance of the shifts from the top at which the filters are evaluated, and largest shift to either side [px].
#define GRID_PX 0.5f
#define SEARCH_PX 1.5f
// Half-width of the filter, where its Gaussian has fallen to 4 %. Its sigma is CORE_SHARE of the stripe's, because the core of a
// wide stripe (clipped or in a halo) is the most accurate part, and SPECKLE_PX in quadrature, because of speckle.
#define FILTER_SIGMAS 2.5
#define SPECKLE_PX 1.3
#define CORE_SHARE 0.85
// A peak in the first or last rows of the band may be the flank of a stripe outside of it.
#define EDGE_ROWS 2
// Standard deviation of the centre due to speckle, as a share of the stripe's sigma; independent of the light.
#define SPECKLE_OF_SIGMA 0.06f
// Uncertainty due to a brightness gradient across the stripe, as a share of the first-order shift of its centre.
#define ALBEDO_SHARE 0.5f
// Distance above and below the stripe at which the brightness is sampled, in sigmas and at least in pixels.
#define BESIDE_SIGMAS 1.5
#define LEAST_BESIDE_PX 2
// Columns averaged on each side, in symmetric pairs, so that a straight line is not changed.
#define REACH_COLUMNS 3
// Steepest slope of a line; a steeper one is a jump, which is not smoothed.
#define STEEPEST_PX_PER_COLUMN 0.5f

// Derivatives (SHIFTS, taps) of a Gaussian about each shift, for a stripe of this sigma [px] in light summed over three rows.
// Returns the number of taps.
int64_t derivative_filters(double sigma, float *filters) {
    const double core = CORE_SHARE * sigma;
    const double width = rint(10 * sqrt(core * core + SPECKLE_PX * SPECKLE_PX - ROW_SMOOTHING_VARIANCE)) / 10;
    const int64_t reach = (int64_t)ceil(FILTER_SIGMAS * width + (double)SEARCH_PX), taps = 2 * reach + 1;
    for (int s = 0; s < SHIFTS; s++) {
        double weights[MOST_TAPS], sum = 0;
        for (int64_t t = 0; t < taps; t++) {
            const double far = (double)(t - reach) - ((double)(GRID_PX * (float)s) - (double)SEARCH_PX), x = far / width;
            weights[t] = fabs(far) > FILTER_SIGMAS * width + 0.5 ? 0 : far * exp(-0.5 * x * x);
            sum += weights[t];
        }
        // A background that is constant must not move the crossing, wherever the window is cut.
        for (int64_t t = 0; t < taps; t++) filters[s * taps + t] = (float)(weights[t] - sum / (double)taps);
    }
    return taps;
}

// Standard deviation of the centre [px] times the slope of its response, for noise of one grey level per pixel in light summed
// over `smoothed_rows` rows.
double noise_gain(const float *filters, int64_t taps, int64_t smoothed_rows) {
    const float *middle = filters + SHIFTS / 2 * taps;
    double squares = 0;
    for (int64_t i = 0; i < taps + smoothed_rows - 1; i++) {
        double sum = 0;
        for (int64_t t = MAX(i - smoothed_rows + 1, 0); t <= MIN(i, taps - 1); t++) sum += (double)middle[t];
        squares += sum * sum;
    }
    return sqrt(squares) * (double)GRID_PX;
}

// Sub-pixel centres (n,), relative to the top [px]: zero crossings of the falling responses (SHIFTS, n), of several the one
// nearest to the top, NaN if there is none. slope: (n,) receives the fall of the response from one shift to the next.
void centres(const float *responses, int64_t n, float *row, float *slope) {
    static const int NEAREST_FIRST[SHIFTS - 1] = {3, 2, 4, 1, 5, 0};
    for (int64_t c = 0; c < n; c++) {
        int interval = 0, is_falling = 0;
        for (int i = 0; i < SHIFTS - 1 && !is_falling; i++) {
            interval = NEAREST_FIRST[i];
            is_falling = responses[interval * n + c] > 0 && !(responses[(interval + 1) * n + c] > 0);
        }
        const float before = responses[interval * n + c], after = responses[(interval + 1) * n + c];
        slope[c] = MAX(before - after, 1e-9f);
        const float crossing = (float)((double)interval + (double)(before / slope[c]));
        row[c] = is_falling ? crossing * GRID_PX - SEARCH_PX : NAN;
    }
}

// Smooth the positions of a stripe (n,), NaN where there is none, along its columns: speckle is independent between
// columns, the surface is not. Neighbours count in pairs, one from each side with the same weight, so a straight line is
// not changed. Nothing is averaged across a gap or a jump. shrink: receives the factors by which
// independent noise is reduced.
void smooth_line(const float *position, const float *weight, int64_t n, float *smooth, float *shrink) {
    for (int64_t c = 0; c < n; c++) {
        smooth[c] = NAN, shrink[c] = 0;
        if (!isfinite(position[c])) continue;
        const float here = position[c], own = weight[c];
        float weights = 0, squares = 0, total = 0;
        for (int64_t far = 1; far <= REACH_COLUMNS && c >= far && c + far < n && own > 0; far++) {
            const float left = position[c - far], right = position[c + far];
            if (!isfinite(left) || !isfinite(right)) break;
            const float pair = MIN(weight[c - far], weight[c + far]);
            const float farthest = MAX(fabsf(left - here), fabsf(right - here));
            if (!(farthest < STEEPEST_PX_PER_COLUMN * (float)far && pair > 0)) break;
            weights += pair, squares += pair * pair, total += pair * (left + right);
        }
        const float sum = own + 2 * weights, divisor = sum > 0 ? sum : 1;
        smooth[c] = (own * here + total) / divisor;
        shrink[c] = sqrtf(own * own + 2 * squares) / divisor;
    }
}

// Positions (n,) and standard deviations (n,) of a stripe whose peaks are known, as rows of the whole picture, NaN where they
// cannot be used; and statuses (n,). Returns the number of doubtful columns, whose peaks must not be used; doubtful: (n,) their
// rows. top, height: (n,) row within the band and light of the peak. is_peak, is_clipped, is_unsure: (n,) masks. background:
// laser-off band, whose brightness beside the stripe is read in `channel`, or NULL. work: (3, n).
int64_t measure(const int64_t *top, const float *height, const uint8_t *is_peak, const uint8_t *is_clipped,
    const uint8_t *is_unsure, const float *responses, const Picture *background, int64_t channel, int64_t n, int64_t rows,
    int64_t first_row, double sigma, double noise, float *work, float *position, float *deviation, uint8_t *status,
    float *doubtful) {
    const int64_t beside = MAX((int64_t)rint(BESIDE_SIGMAS * sigma), LEAST_BESIDE_PX);
    float *row = work, *slope = work + n, *shrink = slope + n, *smooth = position;
    const float width = (float)sigma, noisy = (float)noise;
    const float speckle = SPECKLE_OF_SIGMA * width, pull = ALBEDO_SHARE * (width * width) / (float)beside;
    int64_t doubts = 0;
    centres(responses, n, row, slope);
    for (int64_t c = 0; c < n; c++) row[c] = is_peak[c] ? (float)top[c] + row[c] : NAN;
    smooth_line(row, height, n, smooth, shrink);
    for (int64_t c = 0; c < n; c++) {
        const int is_found = isfinite(row[c]) != 0;
        status[c] = !is_found ? DROPOUT : is_clipped[c] ? SATURATED : OK;
        if (is_peak[c] && (!is_found || is_unsure[c])) status[c] = AMBIGUOUS;
        if (is_peak[c] && (top[c] < EDGE_ROWS || top[c] >= rows - EDGE_ROWS)) status[c] = OUT_OF_BAND;
        const int is_usable = status[c] == OK || status[c] == SATURATED;
        // Reflectance that changes by a factor exp(g) per row shifts a Gaussian stripe by g sigma^2 rows. The laser-off
        // picture shows the reflectance under ambient light, noise included, so only a share of it counts.
        const int32_t above = background ? level(background, within(top[c] - beside, rows), c, channel) : 0;
        const int32_t below = background ? level(background, within(top[c] + beside, rows), c, channel) : 0;
        const float shift = pull * (float)(below - above) / (float)MAX(above + below, 1);
        const float random = noisy * shrink[c] / slope[c];
        const float variance = random * random + speckle * speckle * shrink[c] + shift * shift;
        const float found = smooth[c] + (float)first_row;
        // A doubtful return without a centre is located by the row of its peak.
        const int is_doubtful = is_peak[c] && !is_usable;
        doubtful[c] = !is_doubtful ? NAN : is_found ? found : (float)(top[c] + first_row);
        position[c] = is_usable ? found : NAN;
        deviation[c] = is_usable ? sqrtf(variance) : NAN;
        doubts += is_doubtful;
    }
    return doubts;
}
