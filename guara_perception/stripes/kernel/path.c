// Search for the path of a stripe in any light: first passes in some of the columns, last one in all.
#include "any_light.h"

// Spacing of the columns in the first passes, which find the laser's channel, and least width of a picture in which they
// omit columns.
#define FIRST_PASS_COLUMNS 4
#define FIRST_PASS_FROM 160
// A path with a purity of SURE_PURITY and an evidence of SURE_SCORE per column is the laser's: the other channels are not
// searched. With an evidence of CLEAR_SCORE in the first pass, there is no second pass. Channels whose score reaches HOPEFUL of
// the best are searched in all columns. LEAST_NOISE: of details [grey levels].
#define SURE_PURITY 0.99
#define SURE_SCORE 1.0
#define CLEAR_SCORE 3.0
#define HOPEFUL 0.4
#define LEAST_NOISE 0.15
// The stripe and its halo lie within this many rows of its path; the scene is what is further away.
#define NEAR_PEAK_PX 10
#define NEAR_PATH_PX 12
// Least height of a piece, relative to the strong pieces: the dimmest parts of a line have a tenth of the height of its
// brightest. Without a laser-off picture, and more so without colour, texture can be stronger than that.
#define LEAST_SHARE 0.1
#define LEAST_SHARE_ALONE 0.15
#define LEAST_SHARE_MONO 0.5

// Picture in the colour of the laser, and noise of its ridges. Outside `reach` rows of the path `away` there is only scene.
static void seek(const View *v, const Path *away, int reach, int is_texture_noise, const double *colour, int channel,
    double *weights, Noises *noises, Any *w) {
    double scene[CHANNELS][CHANNELS];
    covariance(v, away, reach, scene);
    laser_weights(v->scene->channels, scene, colour, weights);
    in_laser_colour(v, weights, channel, w->laser, w->core, w);
    noises_of_ridges(v, w->laser, is_texture_noise ? away : NULL, reach, noises, w);
}

// Sum over the columns of the highest details of a channel, relative to its noise. peaks: receives their rows. high: (width,).
static double stands_out(const View *thin, int k, Path *peaks, float *restrict high, float *samples) {
    const int64_t n = thin->width, rows = thin->rows;
    int32_t *restrict row = peaks->row;
    double sum = 0;
    int64_t count = 0;
    for (int64_t c = 0; c < n; c++) row[c] = 0, peaks->is_stripe[c] = 1, high[c] = -INFINITY;
    for (int64_t r = 0; r < rows; r++) {
        const float *restrict x = thin->detail + (k * rows + r) * n;
        for (int64_t c = 0; c < n; c++) row[c] = x[c] > high[c] ? (int32_t)r : row[c], high[c] = MAX(high[c], x[c]);
        if (r % 4 == 0) for (int64_t c = 0; c < n; c += 3) samples[count++] = x[c];
    }
    for (int64_t c = 0; c < n; c++) sum += (double)high[c];
    return sum / MAX(robust_sigma(samples, count), LEAST_NOISE);
}

// Path of a laser of one channel in some columns, and its score. is_sure: receives 1 if the laser certainly has this channel.
// The score is that of the second pass, in which texture counts as noise and the colour is the one that the first pass found.
static double first_pass(const View *thin, int k, const Path *peaks, Any *w, Path *path, int *is_sure) {
    const int64_t n = thin->width;
    double weights[CHANNELS], colour[CHANNELS], added[CHANNELS];
    Noises noises;
    for (int i = 0; i < CHANNELS; i++) colour[i] = i == k;
    seek(thin, peaks, NEAR_PEAK_PX, 0, colour, k, weights, &noises, w);
    strengths(thin, w->laser, &noises, NULL, w->evidence, w->line);
    const double first = follow_columns(w->evidence, n, thin->rows, w, path);
    *is_sure = 1;
    if (thin->scene->channels < CHANNELS) return 1;
    // The first pass in a pair is clear: a second one would change nothing.
    if (thin->scene->has_dark && first >= CLEAR_SCORE * (double)n && purity(thin, path, k) >= SURE_PURITY) return first;
    rim_colour(thin, path, k, added), relative_colour(added, k, colour);
    seek(thin, path, NEAR_PATH_PX, 1, colour, k, weights, &noises, w);
    strengths(thin, w->laser, &noises, NULL, w->evidence, w->line);
    const double score = follow_columns(w->evidence, n, thin->rows, w, &w->second), pure = purity(thin, &w->second, k);
    *is_sure = pure >= SURE_PURITY && score >= SURE_SCORE * (double)n;
    return score * pure;
}

static int first_passes(const View *thin, int64_t width, Any *w) {
    const int64_t n = thin->width;
    const int channels = (int)thin->scene->channels;
    double scores[CHANNELS], most = 0;
    int order[CHANNELS] = {0, 1, 2}, count = 0, is_sure = 0, found = 0;
    for (int k = 0; k < channels; k++) scores[k] = stands_out(thin, k, &w->peaks[k], w->line, w->samples);
    for (int k = 1; k < channels; k++) if (scores[k] > scores[order[0]]) order[0] = k;
    order[order[0]] = 0;
    while (count < channels && !is_sure) {
        const int k = order[count++];
        scores[k] = first_pass(thin, k, &w->peaks[k], w, &w->paths_of[k], &is_sure);
        most = MAX(most, scores[k]);
    }
    for (int i = 0; i < count; i++) {
        const int k = order[i];
        const Path *path = &w->paths_of[k];
        if (!(scores[k] >= HOPEFUL * most)) continue;
        First *f = &w->firsts[found++];
        f->channel = k;
        for (int64_t c = 0; c < width; c++) { // interpolate between the columns that were searched
            const int64_t here = MIN(MAX((c - thin->first) / thin->step, 0), n - 1), at = thin->first + thin->step * here;
            const double from = path->row[here], to = path->row[MIN(here + 1, n - 1)];
            f->path.row[c] = c <= at ? (int32_t)from : (int32_t)rint((to - from) / (double)thin->step * (double)(c - at) + from);
            f->path.is_stripe[c] = path->is_stripe[MIN(c / thin->step, n - 1)];
        }
    }
    return found;
}

// Stripe of a laser of one channel in all columns, and its score. Columns in which only the first pass found a stripe, before
// texture counted as noise, are doubtful.
static double path_of(const View *full, First *first, Any *w, Found *f) {
    const Scene *s = full->scene;
    const int64_t width = s->width, rows = s->rows;
    const int channel = first->channel, is_colour = s->channels == CHANNELS;
    Path *own = &w->own, *kept = &w->kept;
    double colour[CHANNELS] = {1}, added[CHANNELS], score = 0;
    Noises noises;
    if (is_colour) rim_colour(full, &first->path, channel, added), relative_colour(added, channel, colour);
    seek(full, &first->path, NEAR_PATH_PX, 1, colour, channel, f->weights, &noises, w);
    strengths(full, w->laser, &noises, w->samples, w->evidence, w->line);
    follow_columns(w->evidence, width, rows, w, own);
    float taps[WIDTHS][32];
    taps_of_ridges(taps);
    for (int64_t c = 0; c < width; c++) {
        f->height[c] = ridge_at(w->laser, rows, width, own->row[c], c, &noises, taps, &f->sigma[c]);
        f->is_core[c] = w->core[own->row[c] * width + c];
    }
    uint8_t *good = f->is_path;
    const double least = !is_colour ? LEAST_SHARE_MONO : s->has_dark ? LEAST_SHARE : LEAST_SHARE_ALONE;
    strong_pieces(f->height, own, f->is_core, width, s->shrunk, least, good, w->line);
    if (is_colour) of_laser_colour(s, own, colour, channel, good, kept);
    else of_laser_speckle(w->laser, rows, width, own, f->is_core, f->sigma, good, kept, w->line);
    has_twin(w->samples, w->core, own, rows, width, w->twin, w->line);
    for (int64_t c = 0; c < width; c++) {
        if (good[c]) score += (double)w->evidence[c * rows + own->row[c]];
        kept->row[c] = own->row[c], kept->is_stripe[c] = good[c];
        f->path.row[c] = own->is_stripe[c] ? own->row[c] : first->path.row[c];
        f->path.is_stripe[c] = good[c] & !w->twin[c];
        f->is_core[c] &= good[c];
        f->is_path[c] = own->is_stripe[c] | first->path.is_stripe[c];
    }
    f->channel = channel;
    return score * purity(full, kept, channel);
}

// ---- the path ----------------------------------------------------------------------------------------------------------
int64_t carve_any(Any *w, char *memory, int64_t channels, int64_t rows, int64_t width) {
    const int64_t n = rows * width, step = width >= FIRST_PASS_FROM ? FIRST_PASS_COLUMNS : 1, thin = rows * (width / step + 1);
    int64_t at = 0;
#define TAKE_PATH(PART) TAKE(PART.row, 4 * width), TAKE(PART.is_stripe, width)
    TAKE(laser, 4 * n);
    TAKE(closed, 4 * n);
    TAKE(evidence, 4 * n);
    TAKE(samples, 4 * n + 1024);
    TAKE(paths, 4 * (n + 4 * rows));
    TAKE(thin_light, 4 * channels * thin);
    TAKE(thin_detail, 4 * channels * thin);
    TAKE(thin_on, 2 * channels * thin);
    TAKE(core, n);
    TAKE(line, 4 * MAX(8 * width + 64, 80 * (rows + 24)));
    for (int i = 0; i < 2; i++) TAKE(ends[i], 4 * 3 * (width / 2 + 1));
    for (int k = 0; k < CHANNELS; k++) TAKE_PATH(firsts[k].path), TAKE_PATH(peaks[k]), TAKE_PATH(paths_of[k]);
    TAKE_PATH(second), TAKE_PATH(own), TAKE_PATH(kept);
    for (int i = 0; i < 2; i++) {
        TAKE_PATH(found[i].path), TAKE(found[i].is_path, width), TAKE(found[i].is_core, width);
        TAKE(found[i].sigma, 4 * width), TAKE(found[i].height, 4 * width);
    }
    TAKE(twin, width);
    TAKE(level, channels < CHANNELS ? n : 0);
    TAKE(thin_level, channels < CHANNELS ? thin : 0);
    return at;
}

// Find the path of the stripe in a scene. Returns the fault of its laser-off picture, or USED.
int64_t find_path(Scene *s, int64_t is_changed, Any *w, Found **found) {
    const int64_t step = s->width >= FIRST_PASS_FROM ? FIRST_PASS_COLUMNS : 1, first = step / 2, thin = (s->width - first + step - 1) / step;
    gaussian(3, 0.8, s->across), gaussian(9, 1.6, s->down);
    for (int k = 0; k < CHANNELS; k++) s->gain[k] = 1, s->offset[k] = 0;
    if (s->has_dark) fit_exposure(s, is_changed, w);
    if (s->remark == OTHER_SCENE && s->shrunk > 1) return s->remark; // The texture of the scene must be searched in every column.
    s->most = s->remark || is_changed ? 255 : INFINITY;
    subtract(s);
    if (s->channels == CHANNELS || !s->has_dark) w->level = w->thin_level = NULL;
    else brightness(s, (uint16_t *)w->closed, w->level);
    look(s, first, step, thin, w);
    const View narrow = {s, s->rows, thin, first, step, w->thin_light, w->thin_on, w->thin_level, w->thin_detail, thin, 0, 1};
    const View full = {s, s->rows, s->width, 0, 1, s->light, s->on, w->level, w->thin_detail, thin, first, step};
    const int count = first_passes(&narrow, s->width, w);
    double most = 0;
    Found *best = &w->found[0], *other = &w->found[1];
    for (int i = 0; i < count; i++) {
        const double score = path_of(&full, &w->firsts[i], w, other);
        if (i && !(score > most)) continue;
        most = score;
        Found *t = best;
        best = other, other = t;
    }
    if (s->has_dark) without_moved_edges(s, best, w->twin);
    *found = best;
    return s->remark;
}
