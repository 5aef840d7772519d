// Plain C11 without Python.h, allocation or state: every function may run in any thread, in memory of its caller.
// Compiled with -ffp-contract=off: a fused multiply-add would round otherwise on one machine than on another.
#ifndef GUARA_KERNEL_H
#define GUARA_KERNEL_H
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX(A, B) ((A) > (B) ? (A) : (B))
#define MIN(A, B) ((A) < (B) ? (A) : (B))
// Numbers that are handled side by side, so that compilers use vector instructions.
#define LANES 16

float select_value(float *v, int64_t n, int64_t k);
double median(float *v, int64_t n);
#endif
