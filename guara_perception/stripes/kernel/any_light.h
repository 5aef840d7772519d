// The path of a stripe in any light, searched in a pair of colour pictures of 8 bits: what its files share.
#ifndef GUARA_ANY_LIGHT_H
#define GUARA_ANY_LIGHT_H
#include "kernel.h"

#define CHANNELS 3
// Largest pictures. Numbers of one row or column lie on the stack.
#define MOST_ROWS 1536
#define MOST_COLUMNS 1024
#define WIDTHS 3
#define NONE (-1)
// Grey level, of 255, from which a pixel may be clipped: JPEG and demosaicing keep it from reaching the end.
#define LEVEL_CLIPPED 245
// Columns of a strip: a row of one is in one or a few registers.
#define STRIP 16
enum { USED = 0, OTHER_EXPOSURE, OTHER_SCENE };
// Widths of ridges [px], the distance of their sides, and how far their weights reach, as in laser_colour.py.
static const double SIGMAS[WIDTHS] = {1.2, 2.4, 4.8};
static const int SIDES[WIDTHS] = {3, 6, 12}, REACHES[WIDTHS] = {3, 5, 10};

typedef struct {
    int32_t row[MOST_COLUMNS];
    uint8_t is_stripe[MOST_COLUMNS];
} Path;

// Path in one channel, from some columns.
typedef struct {
    int channel;
    Path path;
} First;

// What was found: row, and whether there is a stripe beyond doubt, may be one, and it is clipped.
typedef struct {
    Path path;
    uint8_t is_path[MOST_COLUMNS], is_core[MOST_COLUMNS];
    float sigma[MOST_COLUMNS], height[MOST_COLUMNS];
    int channel;
    double weights[CHANNELS];
} Found;

// Paths that are made on the way.
typedef struct {
    First firsts[CHANNELS];
    Found found[2];
    Path peaks[CHANNELS], paths[CHANNELS], second, own, kept;
    uint8_t twin[MOST_COLUMNS];
    float ends[2][3 * (MOST_COLUMNS / 2 + 1)];
} Paths;

// Work memory: planes of (rows, width) float32 and what is smaller.
typedef struct {
    float *laser, *best_laser, *heights[WIDTHS], *evidence, *samples; // (rows, width)
    float *paths;                                                     // (width + 4, rows)
    float *thin_light, *thin_detail, *some_detail; // (CHANNELS, rows, thin), (CHANNELS, rows, some)
    uint8_t *thin_frame;                           // (CHANNELS, rows, thin)
    uint8_t *core, *best_core;                     // (rows, width)
    float *line;                                   // MAX(32 * width, 80 * (rows + 24))
    Paths *of;
} Any;

// A pair of pictures (rows, width, CHANNELS) in one piece. `gain` times the laser-off picture and an offset are
// subtracted, channel by channel, of exposures unlike no more than `most`. shrunk: columns of the camera's pictures that became one.
typedef struct {
    const uint8_t *on, *off;
    int rows, width, shrunk;
    float gain[CHANNELS], offset[CHANNELS], most, across[3], down[9]; // the last two: weights of details
    int has_dark, remark;
    double remark_number;
} Scene;

// A picture in which paths are followed: the whole pair, or every fourth column of it.
typedef struct {
    const Scene *scene;
    int rows, width, first, step; // column c of it is column first + step * c of the pair
    const float *light;           // (CHANNELS, rows, width), or NULL: from the pair
    const uint8_t *frame;
    const float *detail; // (CHANNELS, rows, detail_width) of every detail_step-th column
    int detail_width, detail_step;
} View;

static inline const uint8_t *row_of(const Scene *s, const uint8_t *picture, int64_t r) { return picture + r * 3 * s->width; }
// What the laser-on picture shows without the laser, up to `most`: where that is clipped, light cannot be seen.
static inline float expected(float gain, uint8_t dark, float offset, float most) { return MIN(gain * (float)dark + offset, most); }
static inline float light_at(const Scene *s, int64_t r, int64_t c, int k) {
    const float on = row_of(s, s->on, r)[3 * c + k];
    return s->has_dark ? on - expected(s->gain[k], row_of(s, s->off, r)[3 * c + k], s->offset[k], s->most) : on;
}
static inline float view_light(const View *v, int64_t r, int64_t c, int k) {
    return v->light ? v->light[((int64_t)k * v->rows + r) * v->width + c] : light_at(v->scene, r, c, k);
}
static inline uint8_t view_frame(const View *v, int64_t r, int64_t c, int k) {
    return v->frame ? v->frame[((int64_t)k * v->rows + r) * v->width + c] : row_of(v->scene, v->scene->on, r)[3 * c + k];
}
static inline float median_f(float *v, int64_t n) { return (float)median(v, n); }
static inline void channel_rows(const Scene *s, const uint8_t *row, uint8_t *planes) {
    for (int k = 0; k < CHANNELS; k++) every_third(row + k, s->width, planes + k * s->width);
}
// Weights of a Gaussian.
static inline void gaussian(int size, double sigma, float *taps) {
    double sum = 0, t[64];
    for (int i = 0; i < size; i++) t[i] = exp(-0.5 * (i - size / 2) * (i - size / 2) / (sigma * sigma)), sum += t[i];
    for (int i = 0; i < size; i++) taps[i] = (float)(t[i] / sum);
}

void fit_exposure(Scene *s, int is_changed, Any *w);
void look(const Scene *s, Any *w, int thin, int some);
float detail_at(const Scene *s, int row, int column, int k);
void covariance(const View *v, const Path *near, int reach, double scene[CHANNELS][CHANNELS]);
void laser_weights(double scene[CHANNELS][CHANNELS], const double *colour, double *weights);
void rim_colour(const View *v, const Path *p, int channel, double added[CHANNELS]);
void relative_colour(const double *added, int channel, double *colour);
double purity(const View *v, const Path *p, int channel);
void in_laser_colour(const View *v, const double *weights, int channel, float *mixed, uint8_t *core, Any *w);
void noises_of_ridges(const float *laser, int rows, int width, const Path *away, int reach, double *noises, float *line,
    float *samples);
void strengths(const float *laser, const double *noises, int rows, int width, float *strength, float *evidence, float *line);
float ridge_at(const float *laser, int rows, int width, int row, int c, const double *noises, float taps[WIDTHS][32],
    float *sigma);
double follow_columns(const float *evidence, int columns, int rows, float *work, Paths *of, Path *found);
#endif
