// Declarations shared by the files that search for the path of a stripe in any light, in a pair of pictures or in one.
#ifndef GUARA_ANY_LIGHT_H
#define GUARA_ANY_LIGHT_H
#include "kernel.h"

#define CHANNELS 3
#define WIDTHS 3
#define NONE (-1)
// Units of a plane per grey level; full scale is 255 grey levels.
#define LEVEL 256
// Level from which a pixel may be clipped, 245 of 255: JPEG and demosaicing make clipped pixels slightly darker.
#define LEVEL_CLIPPED (245 * LEVEL)
// Columns of a strip: one of its rows fits into a few vector registers.
#define STRIP 16
enum { USED = 0, OTHER_EXPOSURE, OTHER_SCENE };
// Ridge filters: sigma [px], distance from the centre to the sides, and half-width of the taps [rows].
static const double SIGMAS[WIDTHS] = {1.2, 2.4, 4.8};
static const int SIDES[WIDTHS] = {3, 6, 12}, REACHES[WIDTHS] = {3, 5, 10};

// Path (width,): row of the stripe, and mask of the columns that have one.
typedef struct {
    int32_t *row;
    uint8_t *is_stripe;
} Path;

// Path of a laser of one channel, from the search in some of the columns.
typedef struct {
    int channel;
    Path path;
} First;

// Stripe of a laser of one channel: its path with the columns that are certain; masks of the columns that may have a stripe
// and of those that are clipped; sigma and height of its ridge; weights of the channels.
typedef struct {
    Path path;
    uint8_t *is_path, *is_core;
    float *sigma, *height;
    int channel;
    double weights[CHANNELS];
} Found;

// Pair of pictures as planes (channels, rows, width). In each channel, light = on - min(gain * off + offset, most). shrunk:
// columns of the camera's pictures per column. remark: fault of the laser-off picture, or USED; its numbers.
typedef struct {
    uint16_t *on, *off;
    float *light;
    int64_t rows, width, channels, shrunk;
    float gain[CHANNELS], offset[CHANNELS], most, across[3], down[9]; // across, down: taps of details
    int64_t has_dark, remark;
    double remark_numbers[2];
} Scene;

// Columns of a scene in which a path is searched for: all, or some.
typedef struct {
    const Scene *scene;
    int64_t rows, width, first, step; // column c is column first + step * c of the scene
    const float *light;               // (channels, rows, width)
    const uint16_t *on;
    const uint8_t *level; // (rows, width) brightness of the scene; NULL without a laser-off picture, and in colour
    const float *detail;  // (channels, rows, detail_width) of all columns, or of some
    int64_t detail_width, detail_first, detail_step;
} View;

// Work memory: planes (rows, width) and smaller arrays.
typedef struct {
    float *laser, *closed, *evidence, *samples; // (rows, width)
    float *paths;                               // (width + 4, rows)
    float *thin_light, *thin_detail;            // (channels, rows, thin)
    uint16_t *thin_on;
    uint8_t *core, *level, *thin_level; // (rows, width)
    float *line;                        // 80 * (rows + 24), or 8 * width
    float *ends[2];                     // (3, width / 2 + 1)
    First firsts[CHANNELS];
    Found found[2];
    Path peaks[CHANNELS], paths_of[CHANNELS], second, own, kept;
    uint8_t *twin;
} Any;

#define TAKE(PART, SIZE) w->PART = (void *)(memory + at), at += ((SIZE) + 63) / 64 * 64

static inline int64_t at_row(const Scene *s, int64_t k, int64_t r) { return (k * s->rows + r) * s->width; }
static inline int64_t at_pixel(const View *v, int64_t k, int64_t r, int64_t c) { return (k * v->rows + r) * v->width + c; }
static inline float median_f(float *v, int64_t n) { return (float)median(v, n); }
// Weights of a Gaussian.
static inline void gaussian(int size, double sigma, float *taps) {
    double sum = 0, t[64];
    for (int i = 0; i < size; i++) t[i] = exp(-0.5 * (i - size / 2) * (i - size / 2) / (sigma * sigma)), sum += t[i];
    for (int i = 0; i < size; i++) taps[i] = (float)(t[i] / sum);
}
static inline void taps_of_ridges(float taps[WIDTHS][32]) {
    for (int k = 0; k < WIDTHS; k++) gaussian(2 * REACHES[k] + 1, SIGMAS[k], taps[k]);
}

// planes.c
void planes(const Picture *p, int64_t factor, char *line, uint16_t *out);
void fit_exposure(Scene *s, int64_t is_changed, Any *w);
void subtract(Scene *s);
void look(const Scene *s, int64_t first, int64_t step, int64_t thin, Any *w);
float detail_at(const Scene *s, int64_t row, int64_t column, int64_t k);
void brightness(const Scene *s, uint16_t *sums, uint8_t *level);
// colour.c
void covariance(const View *v, const Path *near, int reach, double scene[CHANNELS][CHANNELS]);
void laser_weights(int64_t channels, double scene[CHANNELS][CHANNELS], const double *colour, double *weights);
void rim_colour(const View *v, const Path *p, int channel, double added[CHANNELS]);
void relative_colour(const double *added, int channel, double *colour);
double purity(const View *v, const Path *p, int channel);
void in_laser_colour(const View *v, const double *weights, int channel, float *mixed, uint8_t *core, Any *w);
// ridges.c
// Rows above and below a pixel that its ridge filters read.
enum { FAR_PX = 22 };
typedef struct { double noises[WIDTHS]; float quiet[256]; } Noises; // noise of each ridge filter; factor of a ridge by the scene's level, at most 1
void noises_of_ridges(const View *v, const float *laser, const Path *away, int reach, Noises *found, Any *w);
void strengths(const View *v, const float *laser, const Noises *noises, float *strength, float *evidence, float *line);
float ridge_at(const float *laser, int64_t rows, int64_t width, int64_t row, int64_t c, const Noises *noises,
    float taps[WIDTHS][32], float *sigma);
float ridge_of_column(const float *mean, int64_t row, int64_t rows, int k, const float *taps);
// follow.c
double follow_columns(const float *evidence, int64_t columns, int64_t rows, Any *w, Path *found);
// pieces.c
int64_t end_of_piece(const Path *p, int64_t begin, int64_t width);
void strong_pieces(const float *height, const Path *p, const uint8_t *is_core, int64_t width, int64_t shrunk, double least,
    uint8_t *good, float *work);
void of_laser_colour(const Scene *s, const Path *p, const double *colour, int channel, uint8_t *good, Path *kept);
void of_laser_speckle(const float *light, int64_t rows, int64_t width, const Path *p, const uint8_t *is_core,
    const float *sigma, uint8_t *good, Path *kept, float *work);
void has_twin(const float *strength, const uint8_t *core, const Path *p, int64_t rows, int64_t width, uint8_t *twin,
    float *high);
void without_moved_edges(const Scene *s, Found *f, uint8_t *work);
// path.c
int64_t carve_any(Any *w, char *memory, int64_t channels, int64_t rows, int64_t width);
int64_t find_path(Scene *s, int64_t is_changed, Any *w, Found **found);
#endif
