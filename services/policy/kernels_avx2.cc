#include "services/policy/kernels.h"

#define RG_VECTOR_BYTES 32
#define RG_TILE_VECTORS 4
#define RG_TILE_ROWS 3
#define RG_TABLE kAvx2Table
#define RG_NAME "avx2"
#include "services/policy/kernels_impl.inc"
