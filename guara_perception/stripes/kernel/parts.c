// Parts of stripes, which the drift check compares with straight lines.
#include "kernel.h"

// The k-th smallest of n > k values, which are reordered (Hoare: Algorithm 65, Find, Comm. ACM 4, 1961).
static double select_double(double *v, int64_t n, int64_t k) {
    for (int64_t low = 0, high = n - 1; low < high;) {
        const double pivot = v[(low + high) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (v[i] < pivot) i++;
            while (v[j] > pivot) j--;
            if (i > j) break;
            const double other = v[i];
            v[i++] = v[j], v[j--] = other;
        }
        if (k <= j) high = j;
        else if (k >= i) low = i;
        else break;
    }
    return v[k];
}

// Mean x, mean y and upper median of z (3, stripes, parts) of parts of stripes, which divide the range of y of all points (3, n)
// evenly; NaN where there are fewer than `least` points. ends: (stripes,) end of the points of each stripe, which are in order. A
// point whose z is not finite is ignored. work: 2 (n + parts) numbers of 8 bytes.
void parts_of_stripes(const double *points, int64_t n, const int64_t *ends, int64_t stripes, int64_t parts, int64_t least,
    double *work, double *found) {
    const double *x = points, *y = x + n, *z = y + n;
    double low = INFINITY, high = -INFINITY, *sorted = work;
    int64_t *part = (int64_t *)(work + n), *count = part + n, *place = count + parts;
    for (int64_t i = 0; i < n; i++) if (isfinite(z[i])) low = MIN(low, y[i]), high = MAX(high, y[i]);
    const double scale = (double)parts / MAX(high - low, 1e-9);
    for (int64_t s = 0, first = 0; s < stripes; first = ends[s++]) {
        double *sum_x = found + s * parts, *sum_y = sum_x + stripes * parts, *middle = sum_y + stripes * parts;
        for (int64_t p = 0; p < parts; p++) count[p] = 0, sum_x[p] = sum_y[p] = 0;
        for (int64_t i = first; i < ends[s]; i++) {
            const double at = (y[i] - low) * scale;
            part[i] = !isfinite(z[i]) ? -1 : at < (double)(parts - 1) ? (int64_t)at : parts - 1;
            if (part[i] >= 0) count[part[i]]++, sum_x[part[i]] += x[i], sum_y[part[i]] += y[i];
        }
        for (int64_t p = 0, at = first; p < parts; at += count[p++]) place[p] = at;
        for (int64_t i = first; i < ends[s]; i++) if (part[i] >= 0) sorted[place[part[i]]++] = z[i];
        for (int64_t p = 0; p < parts; p++) {
            const int is_few = count[p] < MAX(least, 1);
            sum_x[p] = is_few ? (double)NAN : sum_x[p] / (double)count[p];
            sum_y[p] = is_few ? (double)NAN : sum_y[p] / (double)count[p];
            middle[p] = is_few ? (double)NAN : select_double(sorted + place[p] - count[p], count[p], count[p] / 2);
        }
    }
}
