#include "services/policy/kernels.h"

#define RG_VECTOR_BYTES 16
#define RG_TILE_VECTORS 2
#define RG_TILE_ROWS 4
#define RG_TABLE kBaselineTable
#define RG_NAME "x86-64"
#include "services/policy/kernels_impl.inc"
