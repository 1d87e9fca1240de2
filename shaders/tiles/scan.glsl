// Scans over a workgroup of THREADS invocations, a constant that the including file defines.

const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

#include "../thread_index.glsl"
#include "../workgroup_sum.glsl"
