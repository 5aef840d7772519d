// Links between neighbouring stripes: the columns in which both lie on one surface.
#include "kernel.h"

// Ratio of two strengths below which the weaker return may be cut by an edge or a shadow, which displaces it; and the largest
// difference of height at which two such returns are joined [m].
#define WEAK_RATIO 0.4f
#define WEAK_JOIN_HEIGHT_M 0.0015

// Row of a stripe; columns in which it is linked to the stripe before and after: none, all, or those in which the returns agree;
// flags that its points and the lines to the next stripe are requested.
enum { NOWHERE, EVERYWHERE, WHERE_THEY_AGREE };
typedef struct { int64_t row, before, after, is_asked, is_pair_asked; } Stripe;

static void link(const float *height, const float *strength, int64_t n, int64_t how, double join, uint8_t *restrict is_linked) {
    const double weak_join = MIN(WEAK_JOIN_HEIGHT_M, join);
    if (how != WHERE_THEY_AGREE) memset(is_linked, how == EVERYWHERE, (size_t)n);
    else for (int64_t c = 0; c < n; c++) {
        const float one = strength[c], two = strength[n + c], weaker = one < two ? one : two, stronger = one < two ? two : one;
        const double apart = (double)fabsf(height[n + c] - height[c]);
        is_linked[c] = apart < (weaker < WEAK_RATIO * stronger ? weak_join : join);
    }
}

// Link some of the stripes (rows, n) to their neighbours. points: (3, rows, n), NaN where there is none. join: limit of the height
// difference on one surface [m]. low, high: range of y; points outside it, and lines wholly outside it, are omitted. masks: (5,
// count, n), receives: linked to the stripe before; linked to the one after; points that both confirm; lines to the next stripe;
// lines not wholly outside the range. numbers: (2, count) of such points and lines. longest: (count,) length of the longest line
// along the ground [m].
void link_stripes(const float *points, const float *strength, int64_t rows, int64_t n, const Stripe *stripes, int64_t count,
    double join, double low, double high, uint8_t *masks, int64_t *numbers, float *longest) {
    const float *x = points, *y = x + rows * n, *z = y + rows * n, least = (float)low, most = (float)high;
    for (int64_t s = 0; s < count; s++) {
        const int64_t at = stripes[s].row * n, above = MAX(at - n, 0);
        uint8_t *before = masks + s * n, *after = before + count * n;
        link(z + above, strength + above, n, stripes[s].before, join, before);
        link(z + at, strength + at, n, stripes[s].after, join, after);
    }
    for (int64_t s = 0; s < count; s++) {
        const int64_t at = stripes[s].row * n, is_asked = stripes[s].is_asked, is_pair = s + 1 < count && stripes[s].is_pair_asked;
        const int64_t next = is_pair ? at + n : at;
        const uint8_t *before = masks + s * n, *after = before + count * n;
        uint8_t *restrict is_confirmed = masks + (2 * count + s) * n, *restrict is_line = is_confirmed + count * n;
        uint8_t *restrict is_wanted = is_line + count * n;
        int64_t confirmed = 0, lines = 0;
        float square = 0;
        for (int64_t c = 0; c < n; c++) {
            const float own = y[at + c], other = y[next + c], along = x[next + c] - x[at + c], across = other - own;
            is_confirmed[c] = is_asked & before[c] & after[c] & !(own < least) & !(own > most) & (isfinite(z[at + c]) != 0);
            is_line[c] = is_pair & after[c];
            is_wanted[c] = !((own < least && other < least) || (own > most && other > most));
            confirmed += is_confirmed[c], lines += is_line[c] & is_wanted[c];
            const float length = along * along + across * across;
            // Over all linked columns, so that the number of samples does not depend on the wanted ones.
            square = is_line[c] && length > square ? length : square;
        }
        numbers[s] = confirmed, numbers[count + s] = lines, longest[s] = sqrtf(square);
    }
}
