// Order statistics of numbers without NaN, and statistics derived from them.
#include "kernel.h"

static float select_in_place(float *v, int64_t n, int64_t k) { // quickselect with a three-way partition
    int64_t low = 0, high = n;
    for (;;) {
        const float a = v[low], b = v[(low + high) / 2], c = v[high - 1];
        const float pivot = a < b ? (b < c ? b : MAX(a, c)) : (a < c ? a : MAX(b, c));
        int64_t end = low;
        for (int64_t i = low; i < high; i++) {
            const float x = v[i];
            v[i] = v[end], v[end] = x, end += x < pivot;
        }
        if (k < end) { high = end; continue; }
        low = end;
        for (int64_t i = low; i < high; i++) {
            const float x = v[i];
            v[i] = v[end], v[end] = x, end += x <= pivot;
        }
        if (k < end || end == low) return pivot; // the second condition holds only with NaN
        low = end;
    }
}

// The same for few values, faster: discard those that cannot be the result.
static float select_of_few(float *v, int64_t n, int64_t k) {
    for (;;) {
        const float a = v[0], b = v[n / 2], c = v[n - 1];
        const float pivot = a < b ? (b < c ? b : MAX(a, c)) : (a < c ? a : MAX(b, c));
        int32_t less = 0, equal = 0;
        for (int64_t i = 0; i < n; i++) less += v[i] < pivot, equal += v[i] == pivot;
        if (k >= less && (k < less + equal || !equal)) return pivot; // !equal holds only with NaN
        const int is_less = k < less;
        int64_t m = 0;
        for (int64_t i = 0; i < n; i++) {
            const float x = v[i];
            v[m] = x, m += is_less ? x < pivot : x > pivot;
        }
        if (!m) return pivot;
        k -= is_less ? 0 : less + equal, n = m;
    }
}

// SOME values are sampled, and the k-th smallest of all is expected between two of them, BESIDE places below and above its own.
// If counting confirms it, only the values between these bounds are searched, at most MOST_KEPT. Fewer than LEAST_COUNTED values
// are searched directly.
enum { SOME = 48, BESIDE = 4, MOST_KEPT = 4096, LEAST_COUNTED = 128 };

// The k-th smallest of n > k values, which may be reordered.
float select_value(float *v, int64_t n, int64_t k) {
    float some[SOME], kept[MOST_KEPT + 1];
    if (n < LEAST_COUNTED) return select_of_few(memcpy(kept, v, (size_t)n * sizeof *v), n, k);
    const int64_t at = k * SOME / n;
    for (int64_t i = 0; i < SOME; i++) some[i] = v[i * n / SOME];
    const float low = at > BESIDE ? select_of_few(memcpy(kept, some, sizeof some), SOME, at - BESIDE) : -INFINITY;
    const float high = at + BESIDE < SOME ? select_of_few(some, SOME, at + BESIDE) : INFINITY;
    int64_t below = 0, within_both = 0, m = 0;
    for (int64_t begin = 0; begin < n; begin += MOST_KEPT) {
        const int64_t end = MIN(begin + MOST_KEPT, n);
        int32_t less = 0, inside = 0;
        for (int64_t i = begin; i < end; i++) less += v[i] < low, inside += (v[i] >= low) & (v[i] <= high);
        below += less, within_both += inside;
    }
    if (k < below || k >= below + within_both || within_both > MOST_KEPT) return select_in_place(v, n, k);
    if (low == high) return low;
    for (int64_t i = 0; i < n; i++) kept[m] = v[i], m += (v[i] >= low) & (v[i] <= high);
    return select_of_few(kept, m, k - below);
}

float upper_median(float *v, int64_t n) { return select_value(v, n, n / 2); }

// Standard deviation of normally distributed values, estimated by their median absolute deviation. The values are overwritten.
double robust_sigma(float *v, int64_t n) {
    const float middle = upper_median(v, n);
    for (int64_t i = 0; i < n; i++) v[i] = fabsf(v[i] - middle);
    return SIGMA_PER_DEVIATION * (double)upper_median(v, n);
}

// Median as in NumPy: of an even number of values, the mean of the two in the middle. The values may be reordered.
double median(float *v, int64_t n) {
    const float upper = select_value(v, n, n / 2);
    if (n % 2) return (double)upper;
    // The lower middle value is the largest below the upper one, unless so few are below it that both are equal.
    float lanes[LANES], lower = -INFINITY;
    int64_t less = 0, i = 0;
    for (int64_t l = 0; l < LANES; l++) lanes[l] = -INFINITY;
    for (; i + LANES <= n; i += LANES) {
        int32_t own = 0;
        for (int64_t l = 0; l < LANES; l++) {
            const float x = v[i + l] < upper ? v[i + l] : -INFINITY;
            own += v[i + l] < upper, lanes[l] = MAX(lanes[l], x);
        }
        less += own;
    }
    for (; i < n; i++) less += v[i] < upper, lower = v[i] < upper ? MAX(lower, v[i]) : lower;
    for (int64_t l = 0; l < LANES; l++) lower = MAX(lower, lanes[l]);
    return less < n / 2 ? (double)upper : ((double)lower + (double)upper) / 2;
}
