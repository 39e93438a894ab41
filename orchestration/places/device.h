/* What the C layer of FMUs needs of C's headers, and how functions become kernels: of a GPU, compiled by NVRTC, which has
 * no headers, or of this processor, where they are loops. */

#ifdef __CUDACC_RTC__
typedef int int32_t;
typedef unsigned uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
#define INT_MAX 2147483647
#define INT_MIN (-INT_MAX - 1)
#define DBL_EPSILON 2.2204460492503131e-16
#define DBL_MAX 1.7976931348623157e308
#define INFINITY __longlong_as_double(0x7ff0000000000000)
#define NAN __longlong_as_double(0x7ff8000000000000)
#define KERNEL(name)                                                                                      \
    extern "C" __global__ void name##_all(Batch *batch, int64_t count, int64_t first, int64_t last) {     \
        const int64_t i = blockIdx.x * (int64_t)blockDim.x + threadIdx.x;                                 \
        if (i < count) name(batch, i, first, last);                                                       \
    }
#else
#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#define KERNEL(name)                                                                                       \
    extern "C" __attribute__((visibility("default"))) void name##_all(Batch *batch, int64_t count, int64_t first, \
                                                                      int64_t last) {                      \
        for (int64_t i = 0; i < count; i++) name(batch, i, first, last);                                   \
    }
#endif
