// Order statistics of numbers without NaN, and what is made of them.
#include "kernel.h"

static uint32_t key_of(float x) { // orders as the numbers do
    uint32_t k;
    memcpy(&k, &x, 4);
    return k & 0x80000000u ? ~k : k | 0x80000000u;
}

static float select_of_few(float *v, int64_t n, int64_t k) { // quickselect in three parts
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
        if (k < end || end == low) return pivot; // The second with NaN alone.
        low = end;
    }
}

// The k-th smallest of n > k values, which are reordered.
float select_value(float *v, int64_t n, int64_t k) {
    if (n < 512) return select_of_few(v, n, k);
    int32_t counts[2048] = {0};
    for (int64_t i = 0; i < n; i++) counts[key_of(v[i]) >> 21]++;
    int64_t rest = k, m = 0;
    uint32_t at = 0;
    while (rest >= counts[at]) rest -= counts[at++];
    for (int64_t i = 0; i < n; i++) { // no branch to guess
        const float x = v[i];
        const int64_t in = key_of(x) >> 21 == at;
        v[i] = v[m], v[m] = x, m += in;
    }
    return select_of_few(v, m, rest);
}

float upper_median(float *v, int64_t n) { return select_value(v, n, n / 2); }

// Standard deviation by the median absolute deviation from the median, as if the values were normal. They are changed.
double robust_sigma(float *v, int64_t n) {
    const float middle = upper_median(v, n);
    for (int64_t i = 0; i < n; i++) v[i] = fabsf(v[i] - middle);
    return SIGMA_PER_DEVIATION * (double)upper_median(v, n);
}

// Median as numpy has it: of an even number of values the mean of the two in the middle. They are reordered.
double median(float *v, int64_t n) {
    const float upper = select_value(v, n, n / 2);
    if (n % 2) return (double)upper;
    // The lower one is the largest that is less, unless so few are less that both are equal.
    float lower = -INFINITY;
    int64_t less = 0;
    for (int64_t i = 0; i < n; i++) {
        const float x = v[i] < upper ? v[i] : -INFINITY;
        less += v[i] < upper, lower = MAX(lower, x);
    }
    return less < n / 2 ? (double)upper : ((double)lower + (double)upper) / 2;
}
