// The types of simd/simd.h are in metal_stdlib here.
#include <metal_stdlib>
