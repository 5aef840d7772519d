// The path of a stripe in any light: passes in some and in all columns, pieces that are the laser's.
#include "any_light.h"

// A path in one channel of this purity and evidence per column is the laser's: the other channels are not searched.
#define SURE_PURITY 0.99
#define SURE_SCORE 1.0
#define LEAST_NOISE 0.15

static float percentile_75(float *v, int n) {
    const float at = (float)(n - 1) * 0.75f;
    const int lo = (int)at, hi = MIN(lo + 1, n - 1);
    const float t = at - (float)lo, b = select_value(v, n, hi), a = select_value(v, n, lo), d = b - a;
    return t < 0.5f ? a + d * t : b - d * (1 - t);
}

// ---- stripe_path: passes ---------------------------------------------------------------------------------------------------
// The picture of a laser of this colour, and the noise of its ridges; beside the path `away` there is only scene.
static void seek(const View *v, const Path *away, int reach, int is_texture_noise, const double *colour, int channel,
    double *weights, double *noises, float *laser, uint8_t *core, Any *w) {
    double scene[CHANNELS][CHANNELS];
    covariance(v, away, reach, scene);
    laser_weights(scene, colour, weights);
    in_laser_colour(v, weights, channel, laser, core, w);
    noises_of_ridges(laser, v->rows, v->width, is_texture_noise ? away : NULL, reach, noises, w->line, w->samples);
}

// How much the highest details of the columns stand out in a channel; `peaks` are their rows.
static double stands_out(const View *thin, int k, Path *peaks, float *samples) {
    const int n = thin->width, rows = thin->rows;
    float high[MOST_COLUMNS];
    double sum = 0;
    int count = 0;
    for (int c = 0; c < n; c++) peaks->row[c] = 0, peaks->is_stripe[c] = 1, high[c] = -INFINITY;
    for (int r = 0; r < rows; r++) {
        const float *x = thin->detail + ((int64_t)k * rows + r) * n;
        for (int c = 0; c < n; c++) peaks->row[c] = x[c] > high[c] ? r : peaks->row[c], high[c] = MAX(high[c], x[c]);
        if (r % 4 == 0) for (int c = 0; c < n; c += 3) samples[count++] = x[c];
    }
    for (int c = 0; c < n; c++) sum += (double)high[c];
    return sum / MAX(robust_sigma(samples, count), LEAST_NOISE);
}

// The path of a laser of one channel in some columns, its score, and whether it leaves no doubt of that channel.
static double first_pass(const View *thin, int k, const Path *peaks, Any *w, Path *path, int *is_sure) {
    const int n = thin->width;
    Path *second = &w->of->second;
    double weights[CHANNELS], noises[WIDTHS], colour[CHANNELS], added[CHANNELS];
    for (int i = 0; i < CHANNELS; i++) colour[i] = i == k;
    seek(thin, peaks, 10, 0, colour, k, weights, noises, w->laser, w->core, w);
    strengths(w->laser, noises, thin->rows, n, NULL, w->evidence, w->line);
    follow_columns(w->evidence, n, thin->rows, w->paths, w->of, path);
    rim_colour(thin, path, k, added), relative_colour(added, k, colour);
    seek(thin, path, 12, 1, colour, k, weights, noises, w->laser, w->core, w);
    strengths(w->laser, noises, thin->rows, n, NULL, w->evidence, w->line);
    const double score = follow_columns(w->evidence, n, thin->rows, w->paths, w->of, second), pure = purity(thin, second, k);
    *is_sure = pure >= SURE_PURITY && score >= SURE_SCORE * n;
    return score * pure;
}

static int first_passes(const View *thin, int width, Any *w, First *firsts) {
    const int n = thin->width;
    Path *peaks = w->of->peaks, *paths = w->of->paths;
    double scores[CHANNELS], most = 0;
    int order[CHANNELS] = {0, 1, 2}, count = 0, is_sure = 0, found = 0;
    for (int k = 0; k < CHANNELS; k++) scores[k] = stands_out(thin, k, &peaks[k], w->samples);
    for (int k = 1; k < CHANNELS; k++) if (scores[k] > scores[order[0]]) order[0] = k;
    order[order[0]] = 0;
    while (count < CHANNELS && !is_sure) {
        const int k = order[count++];
        scores[k] = first_pass(thin, k, &peaks[k], w, &paths[k], &is_sure);
        most = MAX(most, scores[k]);
    }
    for (int i = 0; i < count; i++) {
        const int k = order[i];
        if (!(scores[k] >= 0.4 * most)) continue;
        First *f = &firsts[found++];
        f->channel = k;
        for (int c = 0; c < width; c++) { // between the columns that were searched
            const int at_column = MIN(MAX((c - thin->first) / thin->step, 0), n - 1), at = thin->first + thin->step * at_column;
            const double from = paths[k].row[at_column], to = paths[k].row[MIN(at_column + 1, n - 1)];
            f->path.row[c] = c <= at ? (int)from : (int)rint((to - from) / thin->step * (c - at) + from);
            f->path.is_stripe[c] = paths[k].is_stripe[MIN(c / thin->step, n - 1)];
        }
    }
    return found;
}

// ---- pieces.py: the unbroken pieces of a path ------------------------------------------------------------------------------
static int end_of_piece(const int32_t *row, const uint8_t *is_stripe, int begin, int width) {
    int end = begin + 1;
    while (end < width && is_stripe[end] == is_stripe[begin] && (!is_stripe[begin] || abs(row[end] - row[end - 1]) <= 4)) end++;
    return end;
}

static void strong_pieces(const float *height, const Path *p, const uint8_t *is_core, int width, int shrunk, double least, uint8_t *good, float *work) {
    int n = 0;
    for (int c = 0; c < width; c++) good[c] = 0;
    for (int c = 0; c < width; c++) if (p->is_stripe[c]) work[n++] = height[c];
    if (!n) return;
    const float strong = percentile_75(work, n);
    for (int begin = 0, end; begin < width; begin = end) {
        end = end_of_piece(p->row, p->is_stripe, begin, width);
        if (!p->is_stripe[begin]) continue;
        for (int c = begin; c < end; c++) work[c - begin] = is_core[c] ? MAX(height[c], strong) : height[c];
        const double strength = (double)(median_f(work, end - begin) / strong);
        const int length = shrunk * (end - begin);
        if (length >= 12 && length * strength >= 6 && strength > least) memset(good + begin, 1, (size_t)(end - begin));
    }
}

static void of_laser_colour(const Scene *s, const Path *p, const double *colour, int channel, uint8_t *good) {
    const int width = s->width;
    Path kept;
    memcpy(kept.row, p->row, sizeof *kept.row * (size_t)width), memcpy(kept.is_stripe, good, (size_t)width);
    for (int begin = 0, end; begin < width; begin = end) {
        end = end_of_piece(kept.row, kept.is_stripe, begin, width);
        if (!kept.is_stripe[begin]) continue;
        float sum[CHANNELS] = {0};
        int clear = 0;
        for (int c = begin; c < end; c += 2) {
            const uint8_t *pixel = row_of(s, s->on, p->row[c]) + 3 * c;
            if (pixel[0] >= LEVEL_CLIPPED || pixel[1] >= LEVEL_CLIPPED || pixel[2] >= LEVEL_CLIPPED) continue;
            for (int k = 0; k < CHANNELS; k++) sum[k] += detail_at(s, p->row[c], c, k);
            clear++;
        }
        if (clear < MAX(6 / s->shrunk, 0.5 * (end - begin)) / 2) continue;
        double deviation = 0, mean[CHANNELS];
        for (int k = 0; k < CHANNELS; k++) mean[k] = (double)(sum[k] / (float)clear);
        for (int k = 0; k < CHANNELS; k++) {
            const double d = fabs(mean[k] / MAX(mean[channel], 1e-6) - colour[k]);
            deviation = MAX(deviation, d);
        }
        memset(good + begin, mean[channel] > 0 && deviation < 0.9, (size_t)(end - begin));
    }
}

static void has_twin(const float *strength, const uint8_t *core, const Path *p, int rows, int width, uint8_t *twin) {
    // Columns in which a clipped ridge elsewhere is as strong or nearly so.
    float high[MOST_COLUMNS];
    memset(high, 0, sizeof *high * (size_t)width);
    for (int r = 0; r < rows; r++) {
        const float *restrict s = strength + (int64_t)r * width;
        const uint8_t *restrict full = core + (int64_t)r * width;
        for (int c = 0; c < width; c++) {
            const float v = full[c] && abs(r - p->row[c]) > 12 ? s[c] : 0;
            high[c] = MAX(high[c], v);
        }
    }
    for (int c = 0; c < width; c++) twin[c] = high[c] > 0.5f * strength[(int64_t)p->row[c] * width + c];
}

static double path_of(const Scene *s, const View *full, First *first, Any *w, float *laser, uint8_t *core, Found *f) {
    const int width = s->width, rows = s->rows, channel = first->channel;
    Path *own = &w->of->own, *kept = &w->of->kept;
    uint8_t *twin = w->of->twin;
    double colour[CHANNELS], added[CHANNELS], noises[WIDTHS];
    rim_colour(full, &first->path, channel, added), relative_colour(added, channel, colour);
    seek(full, &first->path, 12, 1, colour, channel, f->weights, noises, laser, core, w);
    strengths(laser, noises, rows, width, w->samples, w->evidence, w->line);
    follow_columns(w->evidence, width, rows, w->paths, w->of, own);
    float taps[WIDTHS][32];
    for (int k = 0; k < WIDTHS; k++) gaussian(2 * REACHES[k] + 1, SIGMAS[k], taps[k]);
    for (int c = 0; c < width; c++) {
        f->height[c] = ridge_at(laser, rows, width, own->row[c], c, noises, taps, &f->sigma[c]);
        f->is_core[c] = core[(int64_t)own->row[c] * width + c];
    }
    uint8_t *good = kept->is_stripe;
    strong_pieces(f->height, own, f->is_core, width, s->shrunk, s->has_dark ? 0.1 : 0.15, good, w->line);
    of_laser_colour(s, own, colour, channel, good);
    has_twin(w->samples, core, own, rows, width, twin);
    double score = 0;
    for (int c = 0; c < width; c++) {
        if (good[c]) score += (double)w->evidence[(int64_t)c * rows + own->row[c]];
        kept->row[c] = own->row[c];
        f->path.row[c] = own->is_stripe[c] ? own->row[c] : first->path.row[c];
        f->is_path[c] = own->is_stripe[c] | first->path.is_stripe[c];
        f->path.is_stripe[c] = good[c] & !twin[c];
        f->is_core[c] &= good[c];
    }
    f->channel = channel;
    return score * purity(full, kept, channel);
}

static void without_moved_edges(const Scene *s, Found *f) { // only pieces that are ridges of the laser-on picture too
    const int width = s->width, rows = s->rows;
    const float third = (float)(1.0 / 3), m[CHANNELS] = {(float)f->weights[0], (float)f->weights[1], (float)f->weights[2]};
    float taps[WIDTHS][32];
    uint8_t is_ridge[MOST_COLUMNS];
    for (int k = 0; k < WIDTHS; k++) gaussian(2 * REACHES[k] + 1, SIGMAS[k], taps[k]);
    enum { FAR = 22 };
    for (int c = 0; c < width; c++) {
        is_ridge[c] = f->is_core[c];
        if (is_ridge[c] || !f->path.is_stripe[c]) continue;
        float mean[2 * FAR + 1], highest = -INFINITY;
        const int left = 3 * MAX(c - 1, 0), right = 3 * MIN(c + 1, width - 1), row = f->path.row[c];
        for (int t = -FAR; t <= FAR; t++) {
            const uint8_t *p = row_of(s, s->on, within(row + t, rows));
            float v[3];
            const int at[3] = {left, 3 * c, right};
            for (int i = 0; i < 3; i++) v[i] = m[0] * p[at[i]] + m[1] * p[at[i] + 1] + m[2] * p[at[i] + 2];
            mean[FAR + t] = third * v[1] + third * (v[0] + v[2]);
        }
        for (int k = 0; k < WIDTHS; k++) {
            float smooth[3];
            for (int i = 0; i < 3; i++) { // at the row, above and below; rows beyond the band are those at its edge
                const int centre = within(row + (i - 1) * SIDES[k], rows) - row + FAR;
                float sum = taps[k][REACHES[k]] * mean[centre];
                for (int t = 1; t <= REACHES[k]; t++) {
                    const int u = MAX(centre - t, within(0, rows) - row + FAR), d = MIN(centre + t, rows - 1 - row + FAR);
                    sum += taps[k][REACHES[k] + t] * (mean[u] + mean[d]);
                }
                smooth[i] = sum;
            }
            const float h = smooth[1] - MAX(smooth[0], smooth[2]);
            highest = MAX(highest, h);
        }
        is_ridge[c] = highest > 0.4f * f->height[c];
    }
    uint8_t good[MOST_COLUMNS];
    memcpy(good, f->path.is_stripe, (size_t)width);
    for (int begin = 0, end; begin < width; begin = end) {
        end = end_of_piece(f->path.row, f->path.is_stripe, begin, width);
        if (!f->path.is_stripe[begin]) continue;
        int ridges = 0;
        for (int c = begin; c < end; c++) ridges += is_ridge[c];
        memset(good + begin, (double)ridges / (end - begin) > 0.25, (size_t)(end - begin));
    }
    memcpy(f->path.is_stripe, good, (size_t)width);
    for (int c = 0; c < width; c++) f->is_core[c] &= good[c];
}


// ---- the path ----------------------------------------------------------------------------------------------------------
static int64_t carve(Any *w, char *memory, int64_t rows, int64_t width) {
    const int64_t n = rows * width, thin = rows * (width / 4 + 1), some = rows * (width / 5 + 1);
    int64_t at = 0;
#define TAKE(NAME, SIZE) w->NAME = (void *)(memory + at), at += ((SIZE) + 63) / 64 * 64
    TAKE(laser, 4 * n);
    TAKE(best_laser, 4 * n);
    for (int k = 0; k < WIDTHS; k++) TAKE(heights[k], 4 * n);
    TAKE(evidence, 4 * n);
    TAKE(samples, 4 * n);
    TAKE(paths, 4 * (n + 4 * rows));
    TAKE(thin_light, 12 * thin);
    TAKE(thin_detail, 12 * thin);
    TAKE(some_detail, 12 * some);
    TAKE(thin_frame, 3 * thin);
    TAKE(core, n);
    TAKE(best_core, n);
    TAKE(line, 4 * MAX(32 * width, 80 * (rows + 24)));
    TAKE(of, sizeof(Paths));
    return at;
}

// Bytes of `memory` of `find_path`; 0 where a pair is too small or too large for it.
int64_t path_size(int64_t rows, int64_t width) {
    static char nothing[1];
    Any w;
    return rows < 32 || width < 160 || rows > MOST_ROWS || width > MOST_COLUMNS ? 0 : carve(&w, nothing, rows, width);
}

// Find the path of the stripe in a pair of pictures (rows, width, 3) of 8 bits, in one piece, off may be NULL.
// row, masks, sigma: (width,), (3, width), (width,) of the path: whether there may be a stripe, is one, it is clipped, and
// the width of its ridge. told: channel, weights and gains of the channels, the ratio of exposures, and whether the
// laser-off picture was used. Returns what is wrong with it, or USED.
int64_t find_path(const uint8_t *on, const uint8_t *off, int64_t rows, int64_t width, int64_t shrunk, int64_t is_changed,
    char *memory, int64_t *row, uint8_t *masks, float *sigma, double *told) {
    Any work, *w = &work;
    carve(w, memory, rows, width);
    Scene s = {.on = on, .off = off, .rows = (int)rows, .width = (int)width, .shrunk = (int)shrunk, .has_dark = off != NULL};
    gaussian(3, 0.8, s.across), gaussian(9, 1.6, s.down);
    if (s.has_dark) fit_exposure(&s, is_changed != 0, w);
    s.most = s.remark || is_changed ? 255 : INFINITY;
    if (s.remark == OTHER_SCENE) return s.remark;
    const int thin = (s.width - 2 + 3) / 4, some = (s.width + 4) / 5;
    look(&s, w, thin, some);
    const View narrow = {&s, s.rows, thin, 2, 4, w->thin_light, w->thin_frame, w->thin_detail, thin, 1};
    const View full = {&s, s.rows, s.width, 0, 1, NULL, NULL, w->some_detail, some, 5};
    First *firsts = w->of->firsts;
    const int count = first_passes(&narrow, s.width, w, firsts);
    double most = 0;
    Found *best = &w->of->found[0], *other = &w->of->found[1];
    for (int i = 0; i < count; i++) {
        const double score = path_of(&s, &full, &firsts[i], w, w->laser, w->core, other);
        if (i && !(score > most)) continue;
        most = score;
        Found *t = best;
        best = other, other = t;
    }
    if (s.has_dark) without_moved_edges(&s, best);
    for (int64_t c = 0; c < width; c++) {
        row[c] = best->path.row[c], sigma[c] = best->sigma[c];
        masks[c] = best->is_path[c], masks[width + c] = best->path.is_stripe[c], masks[2 * width + c] = best->is_core[c];
    }
    told[0] = best->channel, told[7] = s.remark_number, told[8] = s.has_dark;
    for (int k = 0; k < CHANNELS; k++) told[1 + k] = best->weights[k], told[4 + k] = s.has_dark ? (double)s.gain[k] : 1;
    return s.remark;
}
