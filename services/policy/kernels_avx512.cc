#include "services/policy/kernels.h"

#define RG_VECTOR_BYTES 64
#define RG_TILE_VECTORS 2
#define RG_TILE_ROWS 8
#define RG_TABLE kAvx512Table
#define RG_NAME "avx512"
#include "services/policy/kernels_impl.inc"
